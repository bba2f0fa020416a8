"""What a policy sees of an observation: errors and speeds at every scale from metres to micrometres.

A network fed with metres cannot tell 0.1 mm from nothing.  Each quantity v enters as sign(v) log(1 + |v| / scale) for
several scales, linear well within a scale and logarithmic beyond.  Errors come both as the tool's, in x and y, and as
each motor's, in belt travel; each as it is and as it will be if the motion goes on for another period.

Every v is linear in the numbers of the observation, so the features are one matrix product and one logarithm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

Array = NDArray[np.float64]

ERROR_SCALES = (1e-1, 1e-2, 1e-3, 1e-4)  # m
SPEED_SCALES = (0.3, 0.02)  # m/s
STRETCH_SCALES = (1e-3, 1e-4)  # m
ACTION_SCALES = (1.0, 0.03)  # of the rated voltage: all of it, and about what friction takes
EXPECTED_SCALES = (0.03, 0.003)  # of the rated voltage
LEARNT_SCALE, LARGEST_LEARNT = 0.2, 1.0
PLACE_SCALE = 0.2  # m
AHEAD = 0.01  # s
# What gives a feature of 1: about the largest that comes up.
LARGEST_ERROR = 0.5  # m
LARGEST_SPEED = 1.5  # m/s
LARGEST_STRETCH = 0.01  # m

# Keys of an observation in the order in which they are read, as far as they are there.
KEYS = (
    "observation",
    "desired_goal",
    "preview",
    "last_observation",
    "last_action",
    "base_action",
    "expected",
    "learnt",
)


class StageFeatures(BaseFeaturesExtractor):
    """Features (B, n) of a dict observation: `observation`, `desired_goal`, and as far as they are there `preview` and
    what `ResidualAction` adds.

    radii: travel of belt per unit of each driven coordinate, (d,) m.  rest: that travel at rest per metre of x and y,
    (d, 2).
    """

    def __init__(self, observation_space: spaces.Dict, radii: list[float], rest: list[list[float]]) -> None:
        sizes = {key: int(np.prod(observation_space[key].shape)) for key in KEYS if key in observation_space.spaces}
        matrix, gain = feature_map(sizes, np.array(radii), np.array(rest))
        super().__init__(observation_space, features_dim=len(gain))
        self.keys = tuple(sizes)
        # Not persistent: made from the agent's card, so the weights file does not repeat them.
        self.register_buffer("matrix", torch.as_tensor(matrix.astype(np.float32)), persistent=False)
        self.register_buffer("gain", torch.as_tensor(gain.astype(np.float32)), persistent=False)

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        numbers = torch.cat([observation[key] for key in self.keys], dim=1)
        scaled = numbers @ self.matrix
        return torch.sign(scaled) * torch.log1p(scaled.abs()) * self.gain


def feature_map(sizes: dict[str, int], radii: Array, rest: Array) -> tuple[Array, Array]:
    """M (numbers, n) and g (n,) of the features g sign(z M) log(1 + |z M|) of an observation's numbers z.

    sizes: how many numbers each key has, in the order of z.  radii, rest: as for `StageFeatures`.
    """
    edges = np.cumsum([0, *sizes.values()])
    # A column picks a number out of z; sums of columns are sums of numbers.
    own = {
        key: np.eye(edges[-1])[:, a:b] for key, a, b in zip(sizes, edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    }
    drives = len(radii)

    def motion(state: Array) -> tuple[Array, Array, Array, Array]:
        """Tool and motors, then their speeds, in travel."""
        tool, motors, speed, motor_speed = np.split(state, np.cumsum([2, drives, 2]), axis=1)
        return tool, motors * radii, speed, motor_speed * radii

    tool, motors, speed, motor_speed = motion(own["observation"])
    goal = own["desired_goal"]
    speeds = np.hstack([speed, motor_speed])
    error = np.hstack([goal - tool, goal @ rest.T - motors])
    parts = [
        _scaled(tool, (PLACE_SCALE,), PLACE_SCALE),
        _scaled(np.hstack([error, error - AHEAD * speeds]), ERROR_SCALES, LARGEST_ERROR),
        _scaled(speeds, SPEED_SCALES, LARGEST_SPEED),
        _scaled(motors - tool @ rest.T, STRETCH_SCALES, LARGEST_STRETCH),
        _scaled(motor_speed - speed @ rest.T, SPEED_SCALES[1:], LARGEST_SPEED),
    ]
    if "preview" in own:
        ahead = [own["preview"][:, i : i + 2] - goal for i in range(0, sizes["preview"], 2)]
        parts.append(_scaled(np.hstack(ahead), ERROR_SCALES[1:3], LARGEST_ERROR))
    if "last_observation" in own:
        parts.append(_scaled(speeds - np.hstack(motion(own["last_observation"])[2:]), SPEED_SCALES, LARGEST_SPEED))
    for key in ("last_action", "base_action"):
        if key in own:
            parts.append(_scaled(own[key], ACTION_SCALES, 1.0))
    if "expected" in own:
        now, lately = own["expected"][:, :-drives], own["expected"][:, -drives:]
        news = now - np.tile(lately, now.shape[1] // drives)  # what a controller that goes by the past does not know
        parts.append(_scaled(np.hstack([now[:, :drives], news]), EXPECTED_SCALES, EXPECTED_SCALES[0]))
    if "learnt" in own:
        parts.append(_scaled(own["learnt"], (LEARNT_SCALE,), LARGEST_LEARNT))
    return np.hstack([matrix for matrix, _ in parts]), np.concatenate([gain for _, gain in parts])


def _scaled(columns: Array, scales: Sequence[float], largest: float) -> tuple[Array, Array]:
    """Columns of M over each of the scales, and the gains with which `largest` gives 1."""
    gains = [np.full(columns.shape[1], 1.0 / np.log1p(largest / scale)) for scale in scales]
    return np.hstack([columns / scale for scale in scales]), np.concatenate(gains)


def features_for(machine: Any) -> dict[str, Any]:
    """Keywords of `StageFeatures` for a machine, plain numbers that JSON can hold."""
    from ..machine import rest_state

    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    index = [machine.coordinate_names.index(d.coordinate) for d in machine.drives]
    unit = [rest_state(machine, [float(c == axis) for c in linear]) for axis in ("x", "y")]
    return {
        "radii": [float(machine.radii[i]) for i in index],
        "rest": [[float(u[i] * machine.radii[i]) for u in unit] for i in index],
    }
