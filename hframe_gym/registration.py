"""Registration of the environments with Gymnasium.

It only names the environment classes, so that `import hframe_gym` does not load the simulator.
"""

from __future__ import annotations

import gymnasium as gym

EPISODE_STEPS = 150  # 1.5 s at the default period: the longest move takes half of it, a lap of the circle a third
# Environment and vector environment by id.
ENVIRONMENTS = {
    "HFrame-v0": ("hframe_gym.envs:HFrameEnv", "hframe_gym.envs:HFrameVectorEnv"),
    "HFrameTrack-v0": ("hframe_gym.envs:HFrameTrackEnv", "hframe_gym.envs:HFrameTrackVectorEnv"),
}


def register_environments() -> None:
    """Register the environments with Gymnasium; an id that is registered already is left unchanged."""
    for name, (entry_point, vector_entry_point) in ENVIRONMENTS.items():
        if name not in gym.registry:
            gym.register(
                name,
                entry_point=entry_point,
                vector_entry_point=vector_entry_point,
                max_episode_steps=EPISODE_STEPS,
            )
