"""Makes `gym.make("HFrame-v0")` and `gym.make_vec("HFrame-v0", num_envs=...)` work."""

from __future__ import annotations

import gymnasium as gym

ID = "HFrame-v0"
EPISODE_STEPS = 150  # 1.5 s at the default period: the longest move takes half of it


def register() -> None:
    """Register the environments with gymnasium; does nothing when they are there already."""
    if ID not in gym.registry:
        gym.register(
            ID,
            entry_point="hframe_gym.env:HFrameEnv",
            vector_entry_point="hframe_gym.env:HFrameVectorEnv",
            max_episode_steps=EPISODE_STEPS,
        )
