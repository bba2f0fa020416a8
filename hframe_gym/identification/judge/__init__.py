"""Decisions of the identification: thresholds, and pure functions from evidence to a verdict."""
