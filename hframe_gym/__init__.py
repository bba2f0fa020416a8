"""H-frame belt stages for motion control by learning, and for finding what a stage's model lacks.

Importing registers `HFrame-v0` with gymnasium.
"""

from .env import register
from .files import InputError, load_machine, save_machine
from .machine import Machine, Trajectory

register()

__all__ = ["InputError", "Machine", "Trajectory", "load_machine", "save_machine"]
