"""Read, validate and write the files of machines and recordings."""

from .cleaning import GAP_PERIODS, bridge_blanks, fill_gaps, outlier_mask, without_outliers
from .machine_file import load_machine, machine_to_dict, save_machine
from .recording import Recording, load_recording, load_recordings, run_name, write_trajectory
from .table_file import read_path

__all__ = [
    "GAP_PERIODS",
    "Recording",
    "bridge_blanks",
    "fill_gaps",
    "load_machine",
    "load_recording",
    "load_recordings",
    "machine_to_dict",
    "outlier_mask",
    "read_path",
    "run_name",
    "save_machine",
    "without_outliers",
    "write_trajectory",
]
