"""Read, validate and write the files of machines and recordings."""

from .machine_file import load_machine, machine_to_dict, save_machine
from .recording import GAP_PERIODS, Recording, fill_gaps, load_recording, load_recordings, run_name, write_trajectory
from .table_file import read_path

__all__ = [
    "GAP_PERIODS",
    "Recording",
    "fill_gaps",
    "load_machine",
    "load_recording",
    "load_recordings",
    "machine_to_dict",
    "read_path",
    "run_name",
    "save_machine",
    "write_trajectory",
]
