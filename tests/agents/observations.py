"""Observations that several tests of the agents use."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hframe_gym.machine import Machine, rest_state


def rest_observation(
    machine: Machine, position: tuple[float, float], goal: tuple[float, float]
) -> dict[str, NDArray[Any]]:
    """Return the observation of a machine at rest with unstretched belts.

    Args:
        machine: Machine to observe.
        position: x and y of the tool, m.
        goal: x and y of the goal, m.

    Returns:
        `observation`, `achieved_goal` and `desired_goal`, each with a batch of one.
    """
    coordinates = rest_state(machine, [*position])
    order = [machine.coordinate_names.index(c) for c in ("x", "y", *(d.coordinate for d in machine.drives))]
    state = np.concatenate([coordinates[order], np.zeros(len(order))])
    return {
        "observation": state[None].astype(np.float32),
        "achieved_goal": np.array([position], np.float32),
        "desired_goal": np.array([goal], np.float32),
    }
