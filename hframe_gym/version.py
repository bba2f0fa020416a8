"""The version of this package."""

__version__ = "0.4.0"  # the only place of the version; pyproject.toml reads it
SOFTWARE = f"hframe_gym {__version__}"  # the program that wrote a file, as the file states it
