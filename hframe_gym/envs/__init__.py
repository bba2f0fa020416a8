"""Gymnasium environments of belt-driven stages: single and vector, tasks, rewards, sensors, randomization.

The adapter for stable-baselines3 is `hframe_gym.envs.sb3_vec_env.HFrameVecEnv`; it is imported separately
because it needs an extra.
"""

from .actuation.actuators import ACTUATOR_PRESETS, Actuators, ActuatorsLike, action_space
from .config import EnvConfig, EnvOptions, MachineLike, as_machine
from .hframe_env import HFrameEnv, HFrameTrackEnv
from .observation.sensors import (
    SENSOR_PRESETS,
    DeclaredSensors,
    Encoders,
    Lasers,
    Sensors,
    SensorsLike,
    as_sensors,
    observed_machine,
)
from .observation.spaces import SignalSpec, observation_space
from .randomization.domain_randomization import (
    DISTRIBUTIONS,
    RANDOMIZATION_PRESETS,
    Distribution,
    LogUniform,
    Normal,
    RandomizationLike,
    RandomizeIdentified,
    RandomizeParameter,
    Uniform,
)
from .rewards import REWARDS, Reward, RewardLike
from .tasks import TASKS, Reach, Task, TaskLike, Track, as_task
from .vector_env import HFrameTrackVectorEnv, HFrameVectorEnv
from .wrappers import (
    DISTURBANCES,
    QUANTITIES,
    CostWrapper,
    Disturbance,
    DisturbanceWrapper,
    ObserveQuantities,
    PenaltyWrapper,
    Quantity,
    StepRecord,
    VectorCostWrapper,
    VectorDisturbanceWrapper,
    VectorObserveQuantities,
    VectorPenaltyWrapper,
    machine_for_disturbances,
    quantity,
)

__all__ = [
    "ACTUATOR_PRESETS",
    "DISTRIBUTIONS",
    "DISTURBANCES",
    "QUANTITIES",
    "RANDOMIZATION_PRESETS",
    "REWARDS",
    "SENSOR_PRESETS",
    "TASKS",
    "Actuators",
    "ActuatorsLike",
    "CostWrapper",
    "DeclaredSensors",
    "Distribution",
    "Disturbance",
    "DisturbanceWrapper",
    "Encoders",
    "EnvConfig",
    "EnvOptions",
    "HFrameEnv",
    "HFrameTrackEnv",
    "HFrameTrackVectorEnv",
    "HFrameVectorEnv",
    "Lasers",
    "LogUniform",
    "MachineLike",
    "Normal",
    "ObserveQuantities",
    "PenaltyWrapper",
    "Quantity",
    "RandomizationLike",
    "RandomizeIdentified",
    "RandomizeParameter",
    "Reach",
    "Reward",
    "RewardLike",
    "Sensors",
    "SensorsLike",
    "SignalSpec",
    "StepRecord",
    "Task",
    "TaskLike",
    "Track",
    "Uniform",
    "VectorCostWrapper",
    "VectorDisturbanceWrapper",
    "VectorObserveQuantities",
    "VectorPenaltyWrapper",
    "action_space",
    "as_machine",
    "as_sensors",
    "as_task",
    "machine_for_disturbances",
    "observation_space",
    "observed_machine",
    "quantity",
]
