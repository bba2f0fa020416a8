"""Read, validate and write the files of machines and recordings."""

from .cleaning import (
    GAP_PERIODS,
    bridge_blanks,
    comparison_window,
    fill_gaps,
    only_measurements,
    outlier_mask,
    peak_to_peak,
    repetitions,
    without_outliers,
    without_repetitions,
)
from .examples import copy_examples, examples_folder
from .logs import ImportSettings, MappingOptions, import_logs, parse_factor, read_mapping_file
from .machine_file import load_machine, machine_to_dict, save_machine
from .machine_schema import TABLES, Table, field_descriptions, field_units, machine_json_schema, table_summary
from .machine_template import TEMPLATES, MachineOptions, new_machine, write_machine_template
from .quantization import exact_quantum, quantum_of
from .recording import Recording, load_recording, load_recordings, run_name, write_recording, write_trajectory
from .table_file import read_path, recording_files
from .wrapping import Wrap, find_wrap, known_moduli, unwrapped, without_wraps, wraps_of

__all__ = [
    "GAP_PERIODS",
    "TABLES",
    "TEMPLATES",
    "ImportSettings",
    "MachineOptions",
    "MappingOptions",
    "Recording",
    "Table",
    "Wrap",
    "bridge_blanks",
    "comparison_window",
    "copy_examples",
    "exact_quantum",
    "examples_folder",
    "field_descriptions",
    "field_units",
    "fill_gaps",
    "find_wrap",
    "import_logs",
    "known_moduli",
    "load_machine",
    "load_recording",
    "load_recordings",
    "machine_json_schema",
    "machine_to_dict",
    "new_machine",
    "only_measurements",
    "outlier_mask",
    "parse_factor",
    "peak_to_peak",
    "quantum_of",
    "read_mapping_file",
    "read_path",
    "recording_files",
    "repetitions",
    "run_name",
    "save_machine",
    "table_summary",
    "unwrapped",
    "without_outliers",
    "without_repetitions",
    "without_wraps",
    "wraps_of",
    "write_machine_template",
    "write_recording",
    "write_trajectory",
]
