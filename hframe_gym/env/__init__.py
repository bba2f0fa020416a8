"""`HFrame-v0`: the stage as a Gymnasium environment, single and native vector, its tasks, randomisation and pictures.

The stable-baselines3 adapter is `hframe_gym.env.sb3.HFrameVecEnv`; it is imported on its own because it needs an extra.
"""

from .batch import Settings
from .randomisation import Identified, LogUniform, Normal, Uniform, Vary
from .registration import register
from .rewards import Reward
from .single import HFrameEnv
from .tasks import Reach, Task
from .vector import HFrameVectorEnv

__all__ = [
    "HFrameEnv",
    "HFrameVectorEnv",
    "Identified",
    "LogUniform",
    "Normal",
    "Reach",
    "Reward",
    "Settings",
    "Task",
    "Uniform",
    "Vary",
    "register",
]
