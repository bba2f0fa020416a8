"""Estimates of the state and of the parameters from what a controller observes."""
