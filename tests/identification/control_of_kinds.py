"""Control and training of machines with any kinds of drives and sensors."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym import make_controller


def largest_error_of_pid(env: gym.Env, steps: int) -> float:
    """Return the largest distance from the goal, m, of three episodes of a number of control periods."""
    controller = make_controller("pid", env)
    errors = []
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        controller.reset()
        for _ in range(steps):
            observation, *_ = env.step(controller.act(observation))
        errors.append(float(np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"])))
    return max(errors)


def action_of_a_trained_agent(env: gym.Env) -> np.ndarray:
    """Return the first action of an agent of PPO that was trained for 256 steps."""
    ppo = pytest.importorskip("stable_baselines3").PPO
    model = ppo("MultiInputPolicy", env, n_steps=128, batch_size=64, n_epochs=1, seed=0, device="cpu")
    observation, _ = env.reset(seed=0)
    return model.learn(256).predict(observation, deterministic=True)[0]
