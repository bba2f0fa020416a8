"""Tests; `reference_simulator` is the independent oracle, `rigs` the synthetic data sets."""
