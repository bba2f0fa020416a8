"""Protocols: benchmarks in which everything is fixed, their entries, and the files with the scores."""

from .entries import Entry, make_entry, run_protocol
from .protocol import FIXED_OPTIONS, PROTOCOLS, Protocol, get_protocol
from .repetition import Comparison, compare_draws
from .result_file import ResultFile, checksum, read_result, result_content, write_result
from .scores import fill_unsettled, paired_ratio, part_scores, protocol_bounds

__all__ = [
    "FIXED_OPTIONS",
    "PROTOCOLS",
    "Comparison",
    "Entry",
    "Protocol",
    "ResultFile",
    "checksum",
    "compare_draws",
    "fill_unsettled",
    "get_protocol",
    "make_entry",
    "paired_ratio",
    "part_scores",
    "protocol_bounds",
    "read_result",
    "result_content",
    "run_protocol",
    "write_result",
]
