"""Both libraries' environment checkers, with every warning an error, for every preset of options."""

import warnings

import gymnasium as gym
import pytest
import stable_baselines3.common.env_checker as sb3
from gymnasium.utils import env_checker

from hframe_gym.env import HFrameEnv, register

register()

PRESETS = [
    {},
    {"randomize": "default"},
    {"randomize": "wide", "reward": "sparse"},
    {"ends": "terminate", "period": 0.002},
    {"machine": "hframe-order20"},
    {"machine": "hframe-literal"},
]


@pytest.mark.parametrize("options", PRESETS, ids=str)
def test_gymnasium_has_nothing_to_say(options):
    env = gym.make("HFrame-v0", **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env_checker.check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("options", PRESETS, ids=str)
def test_stable_baselines3_has_nothing_to_say(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sb3.check_env(HFrameEnv(**options), warn=True, skip_render_check=True)


def test_gymnasium_can_render_it():
    env = gym.make("HFrame-v0", render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env_checker.check_env(env.unwrapped)
