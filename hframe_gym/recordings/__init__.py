"""Files from and to the outside: machines and recordings, checked on the way in, written whole."""

from ..atomic_files import whole_file, write_text
from ..errors import InputError
from .gaps import fill_gaps
from .machine_file import load_machine, machine_to_dict, save_machine
from .recording import Recording, load_recording, load_recordings, run_name, write_trajectory

__all__ = [
    "InputError",
    "Recording",
    "fill_gaps",
    "load_machine",
    "load_recording",
    "load_recordings",
    "machine_to_dict",
    "run_name",
    "save_machine",
    "whole_file",
    "write_text",
    "write_trajectory",
]
