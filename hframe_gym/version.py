"""The version of this package."""

__version__ = "0.4.0"  # the only place of the version; pyproject.toml reads it
