"""Predict runs with a machine: residuals, their linearization over parameters, and the uncertain start of a run."""
