"""What a policy sees of an observation: the error at every scale from metres to micrometres.

A network fed with metres cannot tell 0.1 mm from nothing.  The error enters as itself and as asinh(e / scale) for
several scales, which is linear within a scale and logarithmic beyond; the belts' stretch enters in millimetres, as the
way by which each motor is ahead of the tool.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

SCALES = (1e-2, 1e-3, 1e-4)  # m
SPEED = 1.0  # m/s
STRETCH = 1e-3  # m


class ReachFeatures(BaseFeaturesExtractor):
    """Features (B, n) of a dict observation.

    radii: travel of belt per unit of each driven coordinate, (d,) m.  rest: that travel at rest per metre of x and y,
    (d, 2).
    """

    def __init__(self, observation_space: spaces.Dict, radii: list[float], rest: list[list[float]]) -> None:
        drives = len(radii)
        super().__init__(observation_space, features_dim=2 + 2 * len(SCALES) + 2 + 2 + drives + drives)
        goal: Any = observation_space["desired_goal"]
        # Not persistent: the agent's card says them, the weights file does not repeat them.
        self.register_buffer("half_range", torch.as_tensor((goal.high - goal.low) / 2), persistent=False)
        self.register_buffer("radii", torch.as_tensor(np.array(radii, np.float32)), persistent=False)
        self.register_buffer("rest", torch.as_tensor(np.array(rest, np.float32)), persistent=False)
        self.register_buffer("scales", torch.tensor(SCALES), persistent=False)

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        state, goal = observation["observation"], observation["desired_goal"]
        drives = self.radii.shape[0]
        tool, motors = state[:, :2], state[:, 2 : 2 + drives]
        tool_speed, motor_speed = state[:, 2 + drives : 4 + drives], state[:, 4 + drives : 4 + 2 * drives]
        error = goal - tool
        fine = torch.asinh(error[:, :, None] / self.scales) / torch.asinh(0.5 / self.scales)
        stretch = motors * self.radii - tool @ self.rest.T
        slip = motor_speed * self.radii - tool_speed @ self.rest.T
        return torch.cat(
            [
                error / self.half_range,
                fine.flatten(1),
                tool / self.half_range,
                tool_speed / SPEED,
                torch.asinh(stretch / STRETCH),
                slip / SPEED,
            ],
            dim=1,
        )


def features_for(machine: Any) -> dict[str, Any]:
    """Keywords of `ReachFeatures` for a machine, plain numbers that JSON can hold."""
    from hframe_gym.machine import rest_state

    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    index = [machine.coordinate_names.index(d.coordinate) for d in machine.drives]
    unit = [rest_state(machine, [float(c == axis) for c in linear]) for axis in ("x", "y")]
    return {
        "radii": [float(machine.radii[i]) for i in index],
        "rest": [[float(u[i] * machine.radii[i]) for u in unit] for i in index],
    }
