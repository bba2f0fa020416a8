"""Saved states continue to the bit, and resets with given parameters and states."""

from __future__ import annotations

import itertools
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import hframe_gym  # noqa: F401  (registers the environments)
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Actuators, HFrameVectorEnv
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, rest_state
from tests.envs.test_copies import assert_equal, changing_actions

STEPS = 50
IDS = ("HFrame-v0", "HFrameTrack-v0")
CHOICES: dict[str, tuple[Any, ...]] = {
    "sensors": ("state", "rig"),
    "drives": ("ideal", "rig", Actuators(bits=12, current_limit=5.0, delay=0.004)),
    "form": (
        {},
        {"normalize": True},
        {"ends": "terminate", "privileged": True},
        {"flat": True, "reward": "sparse"},
    ),
}
PRESETS = [dict(zip(CHOICES, values, strict=True)) for values in itertools.product(*CHOICES.values())]


def options_of(preset: dict[str, Any]) -> dict[str, Any]:
    """Return the keywords of an environment."""
    return {
        "sensors": preset["sensors"],
        "drives": preset["drives"],
        "randomize": "default",
        **preset["form"],
    }


def with_memory() -> Any:
    """Return a machine whose effects have internal states and delays."""
    machine = BUILTIN_MACHINES["hframe"]()
    return machine.with_effects(
        EFFECTS["dahl_hysteresis"].at("x", F=2.0, L=1e-3),
        EFFECTS["electrical_lag"].at("drives", tau=1e-3),
        EFFECTS["sensor_delay"].at("x_m", d=0.003),
    )


@pytest.mark.parametrize("preset", PRESETS, ids=lambda p: "-".join(map(str, p.values())))
@pytest.mark.parametrize("name", IDS)
def test_a_single_environment_continues_from_a_saved_state_to_the_bit(
    name: str, preset: dict[str, Any]
) -> None:
    env = gym.make(name, **options_of(preset)).unwrapped
    env.reset(seed=3)
    for action in changing_actions(STEPS, (2,), seed=0):
        env.step(action)
    saved = pickle.loads(pickle.dumps(env.get_state()))
    actions = changing_actions(STEPS, (2,), seed=1)

    def continued(environment: Any) -> list[Any]:
        results = [environment.step(action) for action in actions]
        return [*results, environment.reset(), *(environment.step(action) for action in actions[:5])]

    expected = continued(env)
    env.set_state(saved)
    assert_equal(tuple(continued(env)), tuple(expected))
    other = gym.make(name, **options_of(preset)).unwrapped  # it was never reset
    other.set_state(saved)
    assert_equal(tuple(continued(other)), tuple(expected))


@pytest.mark.parametrize("preset", PRESETS, ids=lambda p: "-".join(map(str, p.values())))
@pytest.mark.parametrize("name", IDS)
def test_a_vector_continues_from_a_saved_state_to_the_bit(name: str, preset: dict[str, Any]) -> None:
    """Episodes end and begin in the steps after the saved state."""
    count = 9
    envs, other = (
        gym.make_vec(name, num_envs=count, max_episode_steps=70, **options_of(preset)) for _ in range(2)
    )
    envs.reset(seed=3)
    for action in changing_actions(STEPS, (count, 2), seed=0):
        envs.step(action)
    saved = pickle.loads(pickle.dumps(envs.unwrapped.get_state()))
    actions = changing_actions(STEPS, (count, 2), seed=1)
    expected = tuple(envs.step(action) for action in actions)
    for environment in (envs, other):
        environment.unwrapped.set_state(saved)
        assert_equal(tuple(environment.step(action) for action in actions), expected)


def test_internal_states_of_effects_and_delays_are_saved() -> None:
    env = gym.make("HFrame-v0", machine=with_memory(), sensors="machine", drives="machine").unwrapped
    env.reset(seed=0)
    actions = changing_actions(STEPS, (2,), seed=0)
    for action in actions:
        env.step(action)
    saved = env.get_state()
    expected = tuple(env.step(action) for action in actions)
    env.reset(seed=9)
    env.set_state(saved)
    assert_equal(tuple(env.step(action) for action in actions), expected)


def test_a_state_does_not_change_with_its_environment() -> None:
    env = gym.make("HFrame-v0").unwrapped
    env.reset(seed=0)
    saved = env.get_state()
    before = pickle.dumps(saved)
    env.step(np.ones(2, np.float32))
    env.set_state(saved)
    env.step(np.ones(2, np.float32))
    assert pickle.dumps(saved) == before


def test_a_state_of_other_environments_is_refused() -> None:
    env = gym.make("HFrame-v0").unwrapped
    with pytest.raises(ResetNeeded, match="call reset before get_state"):
        env.get_state()
    env.reset(seed=0)
    state = env.get_state()
    envs = HFrameVectorEnv(2)
    envs.reset(seed=0)
    with pytest.raises(InputError, match="is of a single environment, and this is a vector one"):
        envs.set_state(state)
    for options in ({"sensors": "rig"}, {"machine": "corexy"}, {"period": 0.005}, {"ends": "terminate"}):
        with pytest.raises(InputError, match="another machine, number or options"):
            gym.make("HFrame-v0", **options).unwrapped.set_state(state)
    with pytest.raises(InputError, match="another machine, number or options"):
        HFrameVectorEnv(3).set_state(envs.get_state())
    with pytest.raises(InputError, match="is no state"):
        env.set_state({"x": 1})


def test_parameters_at_reset_are_those_of_a_machine_with_them() -> None:
    """Oracle: an environment whose machine has these parameters."""
    machine = BUILTIN_MACHINES["hframe"]()
    values = {
        "x.mass": 1.3 * machine.parameters["x.mass"],
        "phi1.radius": 1.1 * machine.parameters["phi1.radius"],
    }
    option = {"start": (0.1, 0.05), "target": (0.0, 0.0)}
    expected = gym.make("HFrame-v0", machine=machine.replace(values))
    given = gym.make("HFrame-v0")
    first = expected.reset(seed=0, options=option)
    assert_equal(given.reset(seed=0, options={**option, "parameters": values})[0], first[0])
    for action in changing_actions(20, (2,), seed=0):
        assert_equal(given.step(action)[:4], expected.step(action)[:4])
    assert given.unwrapped.batch.values[0, list(machine.parameters).index("x.mass")] == values["x.mass"]
    given.reset(seed=0)
    nominal = machine.parameters["x.mass"]
    assert given.unwrapped.batch.values[0, list(machine.parameters).index("x.mass")] == nominal


def test_parameters_at_reset_leave_the_other_random_numbers_as_they_are() -> None:
    plain, given = (HFrameVectorEnv(4, randomize="default") for _ in range(2))
    plain.reset(seed=5)
    masses = np.array([8.0, 9.0, 10.0, 11.0])
    _, info = given.reset(seed=5, options={"parameters": {"x.mass": masses}})
    column = list(given.machine.parameters).index("x.mass")
    np.testing.assert_array_equal(given.parameters[:, column], masses)
    np.testing.assert_array_equal(
        np.delete(given.parameters, column, 1), np.delete(plain.parameters, column, 1)
    )
    np.testing.assert_array_equal(info["parameters"]["x.mass"], masses)
    for envs in (plain, given):
        envs.reset()
    np.testing.assert_array_equal(given.parameters, plain.parameters)


def test_parameters_of_some_environments_and_of_the_task() -> None:
    envs = gym.make_vec("HFrameTrack-v0", num_envs=3, autoreset_mode="Disabled").unwrapped
    envs.reset(seed=0)
    mask = np.array([True, False, True])
    envs.reset(options={"reset_mask": mask, "parameters": {"task.speed": [0.1, 0.2]}})
    column = envs.batch.sampler.space.names.index("task.speed")
    assert envs.batch.values[:, column].tolist() == [0.1, 0.3, 0.2]


def test_a_state_at_reset_is_where_the_motion_begins() -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    n = len(machine.coordinates)
    state = np.concatenate([rest_state(machine, [0.1, -0.05])[:n], np.zeros(n)])
    state[machine.coordinate_names.index("x") + n] = 0.5  # m/s
    env = gym.make("HFrame-v0")
    observation, _ = env.reset(seed=0, options={"state": state})
    np.testing.assert_allclose(observation["achieved_goal"], [0.1, -0.05], rtol=1e-6)
    entries = [entry.name for entry in env.unwrapped.entries]
    assert observation["observation"][entries.index("x velocity")] == pytest.approx(0.5)
    after = env.step(np.zeros(2, np.float32))[0]
    assert after["achieved_goal"][0] > observation["achieved_goal"][0] + 1e-3
    at_rest = state.copy()
    at_rest[n:] = 0.0
    by_state, _ = env.reset(seed=0, options={"state": at_rest, "target": (0.0, 0.0)})
    by_start, _ = env.reset(seed=0, options={"start": (0.1, -0.05), "target": (0.0, 0.0)})
    for key, values in by_start.items():
        np.testing.assert_allclose(by_state[key], values, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": {"x.mas": 1.0}}, r"unknown parameter 'x\.mas'; names are, for example, x\.mass"),
        (
            {"parameters": {"x.mass": [1.0, 2.0]}},
            r"\['x\.mass'\] has shape \(2,\), it must be a number or 3 numbers",
        ),
        ({"parameters": {"x.mass": np.nan}}, r"\['x\.mass'\] has the value nan, it must be finite"),
        ({"parameters": {"x.mass": "heavy"}}, r"\['x\.mass'\] is 'heavy', it must be a number"),
        ({"parameters": {"x.mass": -1.0}}, r"\['x\.mass'\] is -1, it must be from"),
        ({"parameters": {"motor1.converter_bits": 7.5}}, "it must be an integer"),
        ({"parameters": [1.0]}, "it must be a dict of values by name"),
        ({"state": np.zeros(5)}, r"\['state'\] has shape \(5,\), it must be positions of x, y, phi1, phi2"),
        ({"state": np.full(8, np.inf)}, r"\['state'\] has the value inf"),
        ({"state": np.full(8, 2.0)}, "the tool must be .x, y. with x in"),
        ({"state": np.zeros(8), "start": (0.0, 0.0)}, "or options\\['state'\\], not both"),
    ],
)
def test_bad_values_are_refused_and_change_nothing(options: dict[str, Any], message: str) -> None:
    envs = HFrameVectorEnv(3, randomize="default")
    envs.reset(seed=0)
    before = envs.get_state()
    with pytest.raises(InputError, match=message):
        envs.reset(seed=1, options=options)
    assert_equal(envs.get_state()["batch"], before["batch"])


def test_options_of_the_adapter_of_stable_baselines3() -> None:
    pytest.importorskip("stable_baselines3")
    envs = HFrameVecEnv(2)
    envs.set_options([{"parameters": {"x.mass": 8.0}}, {"parameters": {"x.mass": 9.0}}])
    envs.reset()
    column = list(envs.envs.machine.parameters).index("x.mass")
    assert envs.envs.parameters[:, column].tolist() == [8.0, 9.0]
    envs.set_options([{"parameters": {"x.mass": 8.0}}, {"parameters": {"y.mass": 9.0}}])
    with pytest.raises(InputError, match="the same parameters"):
        envs.reset()
