"""Moved to `hframe_gym.data_validation`."""

# Aliases until all packages use the new names.
from .findings import print_findings as show
from .findings import write_findings as write_json

__all__ = ["show", "write_json"]
