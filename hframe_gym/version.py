"""The version of this package, and how logs and written files state it."""

__version__ = "0.8.0"  # the only place where it is set; pyproject.toml reads it from here
NAME_AND_VERSION = f"hframe_gym {__version__}"
