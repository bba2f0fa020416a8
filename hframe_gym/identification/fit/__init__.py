"""Fit a machine's parameters to recordings: starts of the runs, covariances, error and missing force of the model."""
