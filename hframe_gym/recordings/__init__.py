"""Read, validate and write the files of machines and recordings."""

from .cleaning import (
    GAP_PERIODS,
    bridge_blanks,
    comparison_window,
    fill_gaps,
    missing_rows,
    peak_to_peak,
    repetitions,
    usual_step,
    without_repetitions,
    without_silences,
)
from .examples import copy_examples, examples_folder
from .logs.log import Log, LogColumn
from .logs.log_files import find_logs, open_logs, run_of
from .logs.log_import import (
    ImportSettings,
    Interval,
    import_logs,
    parse_factor,
    parse_interval,
    read_mapping_file,
)
from .logs.log_mapping import (
    NOT_MEASURED,
    ChannelSource,
    MappingOptions,
    ProposedColumns,
    map_columns,
    propose_columns,
)
from .logs.measurement_units import TIME, accepted_units
from .machine_file.machine_json import load_machine, machine_to_dict, save_machine
from .machine_file.plausibility import implausible_values
from .machine_file.schema import (
    TABLES,
    Table,
    field_descriptions,
    field_units,
    fields,
    machine_json_schema,
)
from .outliers import outlier_mask, without_outliers
from .quantities import split_unit
from .quantization import exact_quantum, quantum_of
from .recording import (
    Recording,
    load_recording,
    load_recordings,
    recorded_commands,
    run_name,
    write_recording,
    write_trajectory,
)
from .tables.table_file import read_path, recording_files
from .templates.commented_file import write_machine_template
from .templates.new_machine import new_machine
from .templates.options import MachineOptions
from .templates.questions import TemplateQuestion, template_questions
from .templates.texts import TEMPLATES
from .wrapping import (
    Wrap,
    find_wrap,
    jumps_between_ends,
    known_moduli,
    shared_wraps,
    unwrapped,
    without_shared_wraps,
    without_wraps,
    wraps_of,
)

__all__ = [
    "GAP_PERIODS",
    "NOT_MEASURED",
    "TABLES",
    "TEMPLATES",
    "TIME",
    "ChannelSource",
    "ImportSettings",
    "Interval",
    "Log",
    "LogColumn",
    "MachineOptions",
    "MappingOptions",
    "ProposedColumns",
    "Recording",
    "Table",
    "TemplateQuestion",
    "Wrap",
    "accepted_units",
    "bridge_blanks",
    "comparison_window",
    "copy_examples",
    "exact_quantum",
    "examples_folder",
    "field_descriptions",
    "field_units",
    "fields",
    "fill_gaps",
    "find_logs",
    "find_wrap",
    "implausible_values",
    "import_logs",
    "jumps_between_ends",
    "known_moduli",
    "load_machine",
    "load_recording",
    "load_recordings",
    "machine_json_schema",
    "machine_to_dict",
    "map_columns",
    "missing_rows",
    "new_machine",
    "open_logs",
    "outlier_mask",
    "parse_factor",
    "parse_interval",
    "peak_to_peak",
    "propose_columns",
    "quantum_of",
    "read_mapping_file",
    "read_path",
    "recorded_commands",
    "recording_files",
    "repetitions",
    "run_name",
    "run_of",
    "save_machine",
    "shared_wraps",
    "split_unit",
    "template_questions",
    "unwrapped",
    "usual_step",
    "without_outliers",
    "without_repetitions",
    "without_shared_wraps",
    "without_silences",
    "without_wraps",
    "wraps_of",
    "write_machine_template",
    "write_recording",
    "write_trajectory",
]
