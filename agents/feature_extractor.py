"""The features of `features` as a stable-baselines3 feature extractor. Needs the extra `agents`."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from .features import OBSERVATION_KEYS, feature_matrix


class LogScaleFeatures(BaseFeaturesExtractor):
    """First layer of a policy: convert a dict observation to logarithmically scaled features (see features.py).

    Args:
        observation_space: Space with `observation` and `desired_goal`; `preview` and the keys that `ResidualAction`
            adds are used where present.
        radii: Belt travel per radian of each motor coordinate, m/rad, length drives.
        rest: Belt travel of each motor coordinate per meter of x and y with unstretched belts, shape (drives, 2).
    """

    matrix: torch.Tensor  # (entries, features)
    gain: torch.Tensor  # (features,)

    def __init__(self, observation_space: spaces.Dict, radii: list[float], rest: list[list[float]]) -> None:
        sizes = {
            key: int(np.prod(observation_space[key].shape or ()))
            for key in OBSERVATION_KEYS
            if key in observation_space.spaces
        }
        matrix, gain = feature_matrix(sizes, np.array(radii), np.array(rest))
        super().__init__(observation_space, features_dim=len(gain))
        self.keys = tuple(sizes)
        # Not persistent: they follow from agent.json, so the file of weights does not repeat them.
        self.register_buffer("matrix", torch.as_tensor(matrix.astype(np.float32)), persistent=False)
        self.register_buffer("gain", torch.as_tensor(gain.astype(np.float32)), persistent=False)

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        """Compute the features g * sign(z M) * log(1 + |z M|) of a batch of observations z.

        Args:
            observation: Arrays by key, in m, rad, m/s and rad/s, each of shape (batch, entries of the key).

        Returns:
            Features, dimensionless, about -1 to 1, shape (batch, features).
        """
        entries = torch.cat([observation[key] for key in self.keys], dim=1)
        scaled = entries @ self.matrix
        return torch.sign(scaled) * torch.log1p(scaled.abs()) * self.gain
