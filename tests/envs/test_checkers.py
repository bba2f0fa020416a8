"""The environment checkers of Gymnasium and stable-baselines3 for every preset; every warning is an error."""

import itertools
import warnings

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3.common.env_checker as sb3
from gymnasium.utils import env_checker

import hframe_gym  # noqa: F401  (registers the environments)
from hframe_gym.envs import HFrameEnv

CHOICES = {
    "sensors": ["state", "rig", "machine"],
    "drives": ["ideal", "rig", "machine"],
    "ends": ["stops", "terminate"],
    "randomize": ["none", "default", "wide"],
    "reward": ["dense", "sparse"],
    "task": ["reach", "track"],
}
PRESETS = [dict(zip(CHOICES, values, strict=True)) for values in itertools.product(*CHOICES.values())]
SOME = [
    {},
    {"randomize": "default", "sensors": "rig"},
    {"randomize": "wide", "reward": "sparse", "privileged": True},
    {"randomize": "wide", "task": "track", "sensors": "rig", "drives": "rig", "privileged": True},
    {"ends": "terminate", "period": 0.002, "drives": "rig"},
    {"machine": "hframe-order20", "privileged": True},
    {"machine": "hframe-literal"},
    {"normalize": True},
    {
        "normalize": True,
        "flat": True,
        "task": "track",
        "randomize": "wide",
        "sensors": "rig",
        "privileged": True,
    },
]


@pytest.mark.parametrize("options", SOME, ids=str)
def test_gymnasium_s_checker_passes(options):
    env = gym.make("HFrame-v0", **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env_checker.check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("options", SOME, ids=str)
def test_stable_baselines3_s_checker_passes(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sb3.check_env(HFrameEnv(**options), warn=True, skip_render_check=True)


def test_gymnasium_s_checker_passes_with_rendering():
    env = gym.make("HFrame-v0", render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env_checker.check_env(env.unwrapped)


@pytest.mark.parametrize("options", SOME, ids=str)
def test_results_of_the_vector_environment_are_in_its_spaces(options):
    envs = gym.make_vec("HFrame-v0", num_envs=3, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        observation, info = envs.reset(seed=0)
        assert envs.observation_space.contains(observation)
        envs.action_space.seed(0)
        for _ in range(5):
            observation, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
            assert envs.observation_space.contains(observation)
        for array, dtype in ((reward, np.float64), (terminated, np.bool_), (truncated, np.bool_)):
            assert array.shape == (3,)
            assert array.dtype == dtype
        keys = {"distance_m", "is_success", "clipped_actions"}
        keys |= {"contour_m"} if options.get("task") == "track" else set()
        keys |= {"parameters"} if options.get("randomize", "none") != "none" else set()
        if options.get("normalize"):  # its reward compares two steps
            keys |= {"previous_achieved_goal"}
            keys |= {"previous_desired_goal"} if options.get("task") == "track" else set()
        assert info.keys() == keys | {f"_{key}" for key in keys}
        for key in keys - {"parameters"}:
            assert info[key].shape[:1] == info[f"_{key}"].shape == (3,)
        for values in info.get("parameters", {}).values():
            assert values.shape == (3,)


@pytest.mark.slow
@pytest.mark.parametrize("options", PRESETS, ids=lambda options: "-".join(options.values()))
def test_every_combination_of_presets_passes_every_check(options):
    test_gymnasium_s_checker_passes(options)
    test_stable_baselines3_s_checker_passes(options)
    test_results_of_the_vector_environment_are_in_its_spaces(options)
