"""Synthetic data sets: rigs with hidden effects, recorded on the independent simulator.

`cases` lists the rigs, `hidden_effects` the effects in them, `excitation` plays identification runs on the
simulator, and `recording_sessions` writes the runs to disk as a user would record them.
"""
