"""Import the logs of controllers and data loggers, and convert them to recordings of a machine."""

from .log import Log, LogColumn
from .log_files import find_logs, log_name, open_logs
from .log_import import (
    ImportSettings,
    Interval,
    import_logs,
    parse_factor,
    parse_interval,
    read_mapping_file,
)
from .log_mapping import ChannelSource, MappingOptions, ProposedColumns, map_columns, propose_columns
from .measurement_units import TIME, accepted_units

__all__ = [
    "TIME",
    "ChannelSource",
    "ImportSettings",
    "Interval",
    "Log",
    "LogColumn",
    "MappingOptions",
    "ProposedColumns",
    "accepted_units",
    "find_logs",
    "import_logs",
    "log_name",
    "map_columns",
    "open_logs",
    "parse_factor",
    "parse_interval",
    "propose_columns",
    "read_mapping_file",
]
