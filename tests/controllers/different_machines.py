"""Parameters of machines that differ from the declared one, as randomization draws them."""

import numpy as np

from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.machine import Machine

COUNT = 64


def different_machines(machine: Machine) -> np.ndarray:
    """Return the parameters of machines that differ from the declared one, shape (COUNT, parameters)."""
    envs = HFrameVectorEnv(COUNT, randomize="default", machine=machine)
    envs.reset(seed=300_000)
    return envs.parameters.copy()
