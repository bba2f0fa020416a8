"""Randomization: distributions and rules, the parameters that are sampled from them, and the random numbers."""
