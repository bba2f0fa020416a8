"""`HFrame-v0`: the stage as a Gymnasium environment, single and native vector, its tasks, randomisation and pictures.

The stable-baselines3 adapter is `hframe_gym.envs.sb3_vec_env.HFrameVecEnv`; it is imported on its own because it needs an extra.
"""

from .actuator_presets import Actuators
from .config import EnvConfig
from .distributions import LogUniform, Normal, Uniform
from .domain_randomization import RandomizeIdentified, RandomizeParameter
from .hframe_env import HFrameEnv
from .registration import register
from .rewards import Reward
from .sensors import Encoders, Lasers, Sensors
from .tasks.base import Task
from .tasks.reach import Reach
from .tasks.track import Track
from .vector_env import HFrameVectorEnv

__all__ = [
    "Actuators",
    "Encoders",
    "EnvConfig",
    "HFrameEnv",
    "HFrameVectorEnv",
    "Lasers",
    "LogUniform",
    "Normal",
    "RandomizeIdentified",
    "RandomizeParameter",
    "Reach",
    "Reward",
    "Sensors",
    "Task",
    "Track",
    "Uniform",
    "register",
]
