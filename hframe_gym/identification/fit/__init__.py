"""Fit a machine to recordings: its parameters, the starts of the runs, covariances, and the error that is left."""
