"""Moved to `hframe_gym.recordings`."""

# Aliases until all packages use the new names.
from .table_file import read_path as read_path
