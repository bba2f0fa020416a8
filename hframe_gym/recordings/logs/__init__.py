"""Import the logs of controllers and data loggers, and convert them to recordings of a machine."""

from .log_import import ImportSettings, import_logs, parse_factor, read_mapping_file
from .log_mapping import MappingOptions

__all__ = ["ImportSettings", "MappingOptions", "import_logs", "parse_factor", "read_mapping_file"]
