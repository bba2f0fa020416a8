"""H-frame belt stages for motion control by learning, and for finding what a stage's model lacks.

Importing registers `HFrame-v0` with gymnasium.
"""

from .dynamics.simulation import Trajectory
from .envs.registration import register
from .errors import InputError
from .machine.machine import Machine
from .recordings.machine_file import load_machine, save_machine

register()

__all__ = ["InputError", "Machine", "Trajectory", "load_machine", "save_machine"]
