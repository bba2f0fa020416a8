"""Recordings prepared for a fit: gaps, initial states, and the sensors' zeros, noise, quantum, clock and range."""
