"""Predict runs with a machine: residuals, their derivatives by parameters, and a run's uncertain start."""
