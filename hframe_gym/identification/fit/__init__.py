"""Fit a machine's parameters to recordings, with the error of the model, the runs' starts and covariances."""
