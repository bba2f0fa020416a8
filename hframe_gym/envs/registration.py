"""Makes `gym.make("HFrame-v0")`, `gym.make("HFrameTrack-v0")` and `gym.make_vec` of both work."""

from __future__ import annotations

import gymnasium as gym

EPISODE_STEPS = 150  # 1.5 s at the default period: the longest move takes half of it, a lap of the circle a third
IDS = {"HFrame-v0": "reach", "HFrameTrack-v0": "track"}  # and the task each begins with


def register() -> None:
    """Register the environments with gymnasium; does nothing when they are there already."""
    for name, task in IDS.items():
        if name not in gym.registry:
            gym.register(
                name,
                entry_point="hframe_gym.envs:HFrameEnv",
                vector_entry_point="hframe_gym.envs:HFrameVectorEnv",
                max_episode_steps=EPISODE_STEPS,
                kwargs={"task": task},
            )
