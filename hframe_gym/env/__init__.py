"""`HFrame-v0`: the stage as a Gymnasium environment, single and native vector, its tasks, randomisation and pictures.

The stable-baselines3 adapter is `hframe_gym.env.sb3.HFrameVecEnv`; it is imported on its own because it needs an extra.
"""

from .distributions import LogUniform, Normal, Uniform
from .drives import Drives
from .randomisation import Identified, Vary
from .registration import register
from .rewards import Reward
from .sensors import Encoders, Lasers, Sensors
from .settings import Settings
from .single import HFrameEnv
from .tasks import Reach, Task, Track
from .vector import HFrameVectorEnv

__all__ = [
    "Drives",
    "Encoders",
    "HFrameEnv",
    "HFrameVectorEnv",
    "Identified",
    "Lasers",
    "LogUniform",
    "Normal",
    "Reach",
    "Reward",
    "Sensors",
    "Settings",
    "Task",
    "Track",
    "Uniform",
    "Vary",
    "register",
]
