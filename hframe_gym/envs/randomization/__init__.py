"""Randomization: distributions and rules, the parameters sampled from them, and random numbers."""
