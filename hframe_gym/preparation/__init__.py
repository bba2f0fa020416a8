"""Recordings prepared for a fit: gaps, initial states, sensors' zeros, noise, quantum, clock, range."""
