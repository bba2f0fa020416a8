"""Validation of a search's result by the held-out runs, and by comparison with simpler machines."""
