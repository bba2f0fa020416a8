"""Import the logs of controllers and data loggers, and convert them to recordings of a machine.

A file format is one class in `formats`, which registers itself in `LOG_FORMATS`. The names here are those
that a format outside this package needs.
"""

from .formats import LOG_FORMATS, LogFormat
from .log import Log, log_columns

__all__ = ["LOG_FORMATS", "Log", "LogFormat", "log_columns"]
