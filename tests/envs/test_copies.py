"""Copies of environments in mid-episode: they take new actions and continue bit-equal to the original."""

import copy
import itertools
import pickle

import gymnasium as gym
import numpy as np
import pytest

import hframe_gym  # noqa: F401  (registers the environments)
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Actuators
from hframe_gym.machine import BUILTIN_MACHINES

IDS = ("HFrame-v0", "HFrameTrack-v0")
CHOICES = {
    "sensors": ("state", "rig"),
    "drives": ("ideal", "rig", Actuators(bits=12, current_limit=5.0, delay=0.004)),
    "ends": ("stops", "terminate"),
    "privileged": (False, True),
}
PRESETS = [dict(zip(CHOICES, values, strict=True)) for values in itertools.product(*CHOICES.values())]


def through_pickle(env):
    """Copy an environment by pickling it."""
    return pickle.loads(pickle.dumps(env))


def changing_actions(steps, shape, seed):
    """Return random actions, shape (steps, *shape), different in every step."""
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (steps, *shape)).astype(np.float32)


def assert_equal(first, second):
    """Compare two results of `step` or `reset` bit by bit, through dictionaries, tuples and object arrays."""
    assert type(first) is type(second)
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for key in first:
            assert_equal(first[key], second[key])
    elif isinstance(first, tuple) or (isinstance(first, np.ndarray) and first.dtype == object):
        for a, b in zip(first, second, strict=True):
            assert_equal(a, b)
    else:
        first, second = np.asarray(first), np.asarray(second)
        assert first.dtype == second.dtype
        # Takes a tenth of the next line's time.
        if first.shape != second.shape or first.tobytes() != second.tobytes():
            np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, through_pickle], ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("options", PRESETS, ids=lambda o: "-".join(map(str, o.values())))
@pytest.mark.parametrize("name", IDS)
def test_copy_of_a_single_environment_continues_bit_equal(name, options, duplicate):
    env = gym.make(name, randomize="default", **options).unwrapped
    env.reset(seed=3)
    for action in changing_actions(5, (2,), seed=0):
        env.step(action)
    twin = duplicate(env)
    for action in changing_actions(8, (2,), seed=1):
        assert_equal(env.step(action), twin.step(action))
    assert_equal(env.reset(), twin.reset())
    for action in changing_actions(4, (2,), seed=2):
        assert_equal(env.step(action), twin.step(action))


@pytest.mark.parametrize("duplicate", [copy.deepcopy, through_pickle], ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("options", PRESETS, ids=lambda o: "-".join(map(str, o.values())))
@pytest.mark.parametrize("name", IDS)
def test_copy_of_a_vector_environment_continues_bit_equal(name, options, duplicate):
    count = 9
    envs = gym.make_vec(name, num_envs=count, randomize="default", **options).unwrapped
    envs.reset(seed=3)
    for action in changing_actions(5, (count, 2), seed=0):
        envs.step(action)
    twin = duplicate(envs)
    for action in changing_actions(8, (count, 2), seed=1):
        assert_equal(envs.step(action), twin.step(action))
    assert_equal(envs.reset(), twin.reset())
    for action in changing_actions(4, (count, 2), seed=2):
        assert_equal(envs.step(action), twin.step(action))


@pytest.mark.parametrize(
    "machine",
    [
        name
        for name, machine in BUILTIN_MACHINES.items()
        if name != "hframe" and len(machine().tool_axes) == 2
    ],
)
def test_copies_on_the_other_machines_continue_bit_equal(machine):
    # With an encoder on a motor that moves an axis directly, there is no place for a laser.
    sensors = "rig" if BUILTIN_MACHINES[machine]().belts else "machine"
    options = {"machine": machine, "randomize": "wide", "sensors": sensors, "drives": "rig"}
    env = gym.make("HFrame-v0", **options).unwrapped
    envs = gym.make_vec("HFrame-v0", num_envs=9, **options).unwrapped
    for original, shape in ((env, (2,)), (envs, (9, 2))):
        original.reset(seed=3)
        for action in changing_actions(5, shape, seed=0):
            original.step(action)
        twin = copy.deepcopy(original)
        for action in changing_actions(8, shape, seed=1):
            assert_equal(original.step(action), twin.step(action))
        assert_equal(original.reset(), twin.reset())


@pytest.mark.parametrize("name", IDS)
def test_copy_responds_to_its_actions(name):
    env = gym.make(name).unwrapped
    env.reset(seed=3)
    env.step(np.zeros(2, np.float32))
    ends = []
    for action in changing_actions(5, (2,), seed=0):
        twin = copy.deepcopy(env)
        for _ in range(5):
            observation, *_ = twin.step(action)
        ends.append(observation["achieved_goal"])
    assert np.ptp(ends, axis=0).min() > 1e-3


@pytest.mark.parametrize("name", IDS)
def test_original_and_copy_do_not_share_memory(name):
    env = gym.make(name, sensors="rig", drives="rig", privileged=True, randomize="default").unwrapped
    env.reset(seed=3)
    twin = copy.deepcopy(env)
    before, _, _, _, _ = copy.deepcopy(env).step(np.zeros(2, np.float32))
    for action in changing_actions(5, (2,), seed=0):
        twin.step(action)
    assert_equal(env.step(np.zeros(2, np.float32))[0], before)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, through_pickle], ids=["deepcopy", "pickle"])
def test_copy_with_delayed_sensors_and_drives_continues_bit_equal(duplicate, hframe):
    effects = [EFFECTS["sensor_delay"].at("x_m", d=0.013), EFFECTS["input_delay"].at("drives", d=0.007)]
    machine = hframe.with_effects(*effects)
    envs = gym.make_vec(
        "HFrame-v0", num_envs=9, machine=machine, sensors="machine", drives="machine"
    ).unwrapped
    envs.reset(seed=3)
    for action in changing_actions(5, (9, 2), seed=0):
        envs.step(action)
    twin = duplicate(envs)
    for action in changing_actions(8, (9, 2), seed=1):
        assert_equal(envs.step(action), twin.step(action))
