"""Machines with one axis: the same ids, with goals and positions of one entry."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3.common.env_checker as sb3
from gymnasium.utils import env_checker

from hframe_gym.envs import HFrameEnv, HFrameTrackEnv, HFrameVectorEnv, Track
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Belt, Coordinate, Drive, Machine, Sensor

AXIS = BUILTIN_MACHINES["axis"]()
# A carriage on a belt loop with a motor; no name is that of the preset.
BELT_AXIS = Machine(
    name="belt-axis",
    coordinates=(
        Coordinate("carriage", mass=2.0, viscous=8.0, coulomb=3.0, range=(0.0, 0.4)),
        Coordinate("pulley", mass=2e-4, viscous=1e-3, coulomb=0.01, kind="rotary", radius=0.012),
    ),
    belts=(
        Belt("short", 2e4, 0.3, {"carriage": 1.0, "pulley": -1.0}, length={"carriage": 1.0}),
        Belt("long", 2e4, 1.0, {"carriage": -1.0, "pulley": 1.0}, length={"carriage": -1.0}),
    ),
    drives=(
        Drive("motor", "u_V", "pulley", Kt=0.08, Ke=0.08, resistance=1.0, gear_ratio=2.0, rated_voltage=24.0),
    ),
    sensors=(Sensor("encoder_rad", {"pulley": 1.0}, resolution=1e-3, kind="encoder"),),
)
OPTIONS = [
    {"machine": AXIS},
    {"machine": AXIS, "normalize": True, "randomize": "default", "privileged": True},
    {"machine": BELT_AXIS, "ends": "terminate", "reward": "sparse"},
    {"machine": BELT_AXIS, "sensors": "machine", "randomize": "wide", "normalize": True},
]
ids = pytest.mark.parametrize(
    "options", OPTIONS, ids=lambda o: "-".join(str(getattr(v, "name", v)) for v in o.values())
)


@ids
def test_the_checkers_pass(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sb3.check_env(HFrameEnv(**options), warn=True, skip_render_check=True)
        env_checker.check_env(gym.make("HFrame-v0", **options).unwrapped, skip_render_check=True)


@ids
def test_a_vector_of_environments_has_the_bits_of_single_ones(options):
    envs, singles = HFrameVectorEnv(3, **options), [HFrameEnv(**options) for _ in range(3)]
    observation, _ = envs.reset(seed=4)
    first = [env.reset(seed=4 + i)[0] for i, env in enumerate(singles)]
    assert observation["desired_goal"].shape == (3, 1)
    rng = np.random.default_rng(0)
    for _ in range(40):
        for i, expected in enumerate(first):
            for key, values in expected.items():
                np.testing.assert_array_equal(observation[key][i], values)
        actions = rng.uniform(-1, 1, (3, 1)).astype(np.float32)
        observation, reward, *_ = envs.step(actions)
        results = [env.step(action) for env, action in zip(singles, actions, strict=True)]
        first = [result[0] for result in results]
        np.testing.assert_array_equal(reward, [result[1] for result in results])
        goals = observation["achieved_goal"], observation["desired_goal"]
        np.testing.assert_array_equal(envs.compute_reward(*goals, [result[4] for result in results]), reward)


def test_positions_distances_and_the_encoder_belong_together():
    env = HFrameEnv(machine=BELT_AXIS, sensors="machine")
    observation, info = env.reset(seed=0, options={"start": (0.1,), "target": (0.35,)})
    assert [entry.name for entry in env.entries] == ["pulley", "pulley velocity"]
    np.testing.assert_allclose(observation["achieved_goal"], [0.1], atol=1e-5)  # one count is 12 um
    np.testing.assert_allclose(observation["observation"][0], 0.1 / 0.012, atol=1e-3)
    assert info["distance_m"] == pytest.approx(0.25)
    for _ in range(10):
        _, _, _, _, info = env.step([1.0])
    assert info["distance_m"] < 0.24


def test_pictures_show_the_axis():
    env = HFrameEnv(machine=AXIS, render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    for _ in range(10):
        env.step([1.0])
    assert before is not None
    assert (env.render() != before).any(axis=2).sum() > 500


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"machine": AXIS, "task": Track(size=0.6)}, "a path 0.6 across with a margin of 0.02 does not fit"),
        (
            {"machine": AXIS, "sensors": "rig"},
            "encoder and laser would both measure x; choose sensors='machine'",
        ),
        (
            {"machine": AXIS.replace(coordinates=(Coordinate("x", 1.0, 5.0, 1.0),))},
            "'x' has no range.*Add \"range\"",
        ),
        (
            {"machine": AXIS.replace(drives=())},
            "has 0 drives; to move its tool along x the environment needs 1",
        ),
    ],
)
def test_what_cannot_work_is_refused_with_a_remedy(options, message):
    with pytest.raises(InputError, match=message):
        HFrameEnv(**options)


def test_positions_of_reset_must_be_in_the_range():
    with pytest.raises(InputError, match=r"must be \(x,\) with x in \[-0.25, 0.25\], in m"):
        HFrameEnv(machine=AXIS).reset(options={"target": (0.3,)})
    with pytest.raises(InputError, match="needs a task with a path"):
        HFrameTrackEnv(machine="hframe", task="reach")
