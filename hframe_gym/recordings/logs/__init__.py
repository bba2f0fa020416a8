"""Import the logs of controllers and data loggers, and convert them to recordings of a machine.

A file format is one class in `formats`, which registers itself in `LOG_FORMATS`.
"""

from .formats import LOG_FORMATS, LogFormat
from .log import Log, LogColumn, log_columns
from .log_files import find_logs, log_name, open_logs, run_of
from .log_import import ImportSettings, Interval, import_logs, parse_factor, parse_interval, read_mapping_file
from .log_mapping import (
    NOT_MEASURED,
    ChannelSource,
    MappingOptions,
    ProposedColumns,
    map_columns,
    propose_columns,
)
from .measurement_units import TIME, accepted_units

__all__ = [
    "LOG_FORMATS",
    "NOT_MEASURED",
    "TIME",
    "ChannelSource",
    "ImportSettings",
    "Interval",
    "Log",
    "LogColumn",
    "LogFormat",
    "MappingOptions",
    "ProposedColumns",
    "accepted_units",
    "find_logs",
    "import_logs",
    "log_columns",
    "log_name",
    "map_columns",
    "open_logs",
    "parse_factor",
    "parse_interval",
    "propose_columns",
    "read_mapping_file",
    "run_of",
]
