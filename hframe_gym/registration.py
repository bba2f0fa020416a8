"""Registration of the environments with Gymnasium.

It only names the environment classes, so that `import hframe_gym` does not load the simulator.
"""

from __future__ import annotations

import gymnasium as gym

EPISODE_STEPS = 150  # 1.5 s at the default period: the longest move takes half of it, a lap of the circle a third
ENVIRONMENT_TASKS = {"HFrame-v0": "reach", "HFrameTrack-v0": "track"}  # default task by environment id


def register_environments() -> None:
    """Register the environments with Gymnasium; an id that is registered already is left unchanged."""
    for name, task in ENVIRONMENT_TASKS.items():
        if name not in gym.registry:
            gym.register(
                name,
                entry_point="hframe_gym.envs:HFrameEnv",
                vector_entry_point="hframe_gym.envs:HFrameVectorEnv",
                max_episode_steps=EPISODE_STEPS,
                kwargs={"task": task},
            )
