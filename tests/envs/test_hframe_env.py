"""The single environment: interface, determinism, messages of invalid arguments."""

import copy
import dataclasses

import gymnasium as gym
import numpy as np
import pytest

import hframe_gym  # noqa: F401  (registers the environments)
from hframe_gym.dynamics import simulate
from hframe_gym.dynamics.simulation import LONGEST_STEP
from hframe_gym.envs import (
    EnvConfig,
    EnvOptions,
    HFrameEnv,
    HFrameVectorEnv,
    RandomizeParameter,
    Reach,
    Track,
    Uniform,
)
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from tests.envs.test_copies import assert_equal

FULL = np.array([1.0, -0.3], np.float32)


def episode(env, steps=20, seed=None):
    """Return the observations and rewards of an episode, concatenated."""
    rows = [env.reset(seed=seed)[0]["observation"]]
    for _ in range(steps):
        observation, reward, *_ = env.step(FULL)
        rows.append(np.append(observation["observation"], np.float32(reward)))
    return np.concatenate(rows)


def test_types_of_the_results():
    env = HFrameEnv(randomize="default")
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(FULL)
    assert type(reward) is float
    assert type(terminated) is bool
    assert type(truncated) is bool
    assert type(info["is_success"]) is bool
    assert type(info["distance_m"]) is float


@pytest.mark.parametrize("error", [False, True])
@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("name", ["HFrame-v0", "HFrameTrack-v0"])
def test_keys_have_the_order_of_the_space(name, normalize, error):
    """Arrays that are joined in the order of the dict are those that FlattenObservation joins."""
    env = gym.make(name, normalize=normalize, error=error, privileged=True)
    joined = gym.wrappers.FlattenObservation(env)
    for observation in (env.reset(seed=0)[0], env.step(np.zeros(2))[0]):
        assert list(observation) == list(env.observation_space.spaces)
        np.testing.assert_array_equal(
            joined.observation(observation), np.concatenate(list(observation.values()))
        )


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("error", [False, True])
@pytest.mark.parametrize("sensors", ["state", "rig"])
@pytest.mark.parametrize("name", ["HFrame-v0", "HFrameTrack-v0"])
def test_an_observation_keeps_its_values_in_later_steps(name, sensors, error, normalize, flat):
    """The steps share arrays, but no observation does: replay buffers keep what they are given."""
    env = gym.make(name, sensors=sensors, error=error, normalize=normalize, flat=flat).unwrapped
    results = [env.reset(seed=1), env.step(FULL)[::4], env.step(-FULL)[::4], env.reset()]
    kept = copy.deepcopy(results)
    for _ in range(3):
        env.step(FULL)
    env.reset()
    assert_equal(tuple(map(tuple, results)), tuple(map(tuple, kept)))


def test_entries_describe_the_observation():
    env = HFrameEnv()
    assert [(e.name, e.unit) for e in env.entries] == [
        ("x", "m"),
        ("y", "m"),
        ("phi1", "rad"),
        ("phi2", "rad"),
        ("x velocity", "m/s"),
        ("y velocity", "m/s"),
        ("phi1 velocity", "rad/s"),
        ("phi2 velocity", "rad/s"),
    ]
    assert env.observation_space["observation"].shape == (8,)


def test_a_seed_determines_all_episodes():
    env, other = HFrameEnv(randomize="default"), HFrameEnv(randomize="default")
    np.testing.assert_array_equal(episode(env, seed=7), episode(other, seed=7))
    # and the episodes after it, without a new seed
    np.testing.assert_array_equal(episode(env), episode(other))
    assert not np.array_equal(episode(env), episode(env))


def test_info_holds_the_randomized_parameters():
    env = HFrameEnv(randomize=[RandomizeParameter("x.mass", Uniform(2.0, 2.0))])
    _, info = env.reset(seed=0)
    assert info["parameters"] == {"x.mass": pytest.approx(2 * 4.07)}
    assert "parameters" not in HFrameEnv().reset(seed=0)[1]


def test_startup_samples_last_until_the_next_seed():
    env = HFrameEnv(randomize=[RandomizeParameter("*.coulomb", Uniform(0.5, 2.0), when="startup")])
    first = env.reset(seed=1)[1]["parameters"]
    assert env.reset()[1]["parameters"] == first
    assert env.reset(seed=2)[1]["parameters"] != first
    assert env.reset(seed=1)[1]["parameters"] == first


def test_reset_options_set_start_and_target():
    env = HFrameEnv()
    observation, info = env.reset(seed=0, options={"start": (0.1, -0.05), "target": (0.13, -0.01)})
    np.testing.assert_allclose(observation["achieved_goal"], [0.1, -0.05], atol=1e-7)
    np.testing.assert_allclose(observation["desired_goal"], [0.13, -0.01], atol=1e-7)
    assert info["distance_m"] == pytest.approx(0.05, abs=1e-6)
    with pytest.raises(ValueError, match="target"):
        env.reset(options={"target": (0.5, 0.0)})
    with pytest.raises(ValueError, match="'goal'"):
        env.reset(options={"goal": (0.0, 0.0)})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": "here"}, r"options\['start'\] is 'here', it must be a position, numbers in m"),
        ({"start": (9.0, 0.0)}, r"options\['start'\] must be \(x, y\)"),
        (
            [("start", (0.0, 0.0))],
            "it must be a dict; its keys may be 'start', 'target', 'parameters' or 'state'",
        ),
        (5, "options is 5, it must be a dict"),
    ],
)
def test_a_refused_reset_changes_nothing(options, message):
    env, other = HFrameEnv(), HFrameEnv()
    env.reset(seed=1)
    other.reset(seed=1)
    with pytest.raises(InputError, match=message):
        env.reset(seed=7, options=options)
    np.testing.assert_array_equal(env.reset()[0]["desired_goal"], other.reset()[0]["desired_goal"])
    track = HFrameEnv(task="track")
    with pytest.raises(InputError, match="task track has no target"):
        track.reset(seed=7, options={"target": (0.0, 0.0)})


def test_a_machine_at_rest_stays_at_rest():
    env = HFrameEnv()
    start, _ = env.reset(seed=0)
    for _ in range(20):
        observation, *_ = env.step(np.zeros(2, np.float32))
    np.testing.assert_array_equal(observation["observation"], start["observation"])


def test_motion_equals_the_machine_s_simulation():
    machine = BUILTIN_MACHINES["hframe"]()
    env = HFrameEnv(
        machine=machine, task=Reach(start=(0.0, 0.0), target=(0.1, 0.0)), longest_step=LONGEST_STEP
    )
    env.reset(seed=0)
    time = np.arange(11) * 0.01
    volts = np.random.default_rng(0).uniform(-12, 12, (11, 2))
    for row in volts[:-1]:
        observation, *_ = env.step(row / 12)
    q = simulate(machine, time, volts).positions[-1]
    np.testing.assert_allclose(observation["observation"][:4], q, rtol=1e-5, atol=1e-7)


def test_actions_out_of_range_are_clipped_and_counted():
    env, other = HFrameEnv(), HFrameEnv()
    env.reset(seed=0)
    other.reset(seed=0)
    observation, *_, info = env.step(np.array([3.0, 0.5]))
    expected, *_, other_info = other.step(np.array([1.0, 0.5]))
    np.testing.assert_array_equal(observation["observation"], expected["observation"])
    assert (info["clipped_actions"], other_info["clipped_actions"]) == (1, 0)
    assert env.reset()[1]["clipped_actions"] == 0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_action_that_is_not_finite_is_refused(value):
    env = HFrameEnv()
    env.reset(seed=0)
    before = env.batch.simulator.state.copy()
    with pytest.raises(ValueError, match=r"^action of motor2: .* is not finite; give numbers from -1 to 1"):
        env.step(np.array([0.0, value]))
    np.testing.assert_array_equal(env.batch.simulator.state, before)


def test_an_action_of_another_shape_is_refused():
    env = HFrameEnv()
    env.reset(seed=0)
    with pytest.raises(
        ValueError, match=r"^the action has shape \(3,\); give \(2,\), a number for each drive"
    ):
        env.step(np.zeros(3))


def test_leaving_the_workspace_terminates_with_a_penalty():
    env = HFrameEnv(ends="terminate", task=Reach(start=(0.27, 0.0), target=(0.0, 0.0)), penalty=7.0)
    env.reset(seed=0)
    for _ in range(50):
        observation, reward, terminated, *_ = env.step(np.array([-1.0, 1.0], np.float32))
        if terminated:
            break
    assert terminated
    assert reward < -7.0
    assert observation["achieved_goal"][0] > 0.28
    assert reward == env.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})


def test_end_stops_hold_the_tool():
    env = HFrameEnv(task=Reach(start=(0.2, 0.0), target=(0.0, 0.0)))
    env.reset(seed=0)
    reached = 0.0
    for _ in range(100):
        observation, _, terminated, *_ = env.step(np.array([-1.0, 1.0], np.float32))
        reached = max(reached, float(observation["achieved_goal"][0]))
    assert not terminated
    assert 0.28 < reached < 0.295
    # Full voltage against the stop compresses it by a millimeter.
    assert observation["achieved_goal"][0] == pytest.approx(0.2812, abs=5e-4)
    assert abs(observation["observation"][4]) < 1e-3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"machine": "no-such-machine"}, "no-such-machine"),
        ({"task": "juggle"}, "juggle"),
        ({"reward": 1.0}, "reward is 1.0; choose 'dense'"),
        ({"randomize": "wild"}, "wild"),
        ({"randomize": "identified"}, "covariance"),
        ({"ends": "bounce"}, "bounce"),
        ({"period": 0.0}, "period"),
        ({"longest_step": float("nan")}, "longest_step"),
        ({"penalty": -1.0}, "penalty"),
        ({"render_mode": "ascii"}, "ascii"),
    ],
)
def test_invalid_options_are_refused_by_name(settings, message):
    with pytest.raises(ValueError, match=message):
        HFrameEnv(**settings)


@pytest.mark.parametrize("make", [HFrameEnv, HFrameVectorEnv])
def test_an_unknown_keyword_is_refused_with_the_list_of_keywords(make):
    with pytest.raises(
        TypeError, match=f"{make.__name__} got .* 'sensor'. Did you mean 'sensors'.* machine, task, .*"
    ):
        make(sensor="rig")
    with pytest.raises(TypeError, match="render_mode"):
        make(color="blue")


def test_typed_keywords_are_those_of_the_configuration():
    assert list(EnvOptions.__annotations__) == [field.name for field in dataclasses.fields(EnvConfig)]


def test_a_machine_without_range_is_refused_with_advice():
    machine = BUILTIN_MACHINES["hframe"]()
    unlimited = dataclasses.replace(machine.coordinate("x"), range=None)
    with pytest.raises(InputError, match=r"coordinate 'x' has no range.*Add .range.: \[low, high\]"):
        HFrameEnv(machine=machine.with_components(unlimited))


@pytest.mark.parametrize("make", [HFrameEnv, HFrameVectorEnv])
def test_step_before_reset_is_refused(make):
    env = make()
    with pytest.raises(gym.error.ResetNeeded, match="call reset before step"):
        env.step(env.action_space.sample())


@pytest.mark.parametrize("task", ["reach", Reach()], ids=["name", "object"])
def test_the_track_environment_refuses_a_task_without_a_path(task):
    with pytest.raises(
        InputError, match="HFrameTrack-v0 needs a task with a path, not 'reach'; use HFrame-v0"
    ):
        gym.make("HFrameTrack-v0", task=task)
    with pytest.raises(InputError, match="needs a task with a path"):
        gym.make_vec("HFrameTrack-v0", num_envs=2, task=task)
    assert gym.make("HFrameTrack-v0", task=Track(path="square")).unwrapped.batch.task.path == "square"


@pytest.mark.parametrize(
    "options", [{"randomize": "default"}, {}, {"task": "track", "randomize": "wide"}], ids=str
)
def test_the_keys_of_info_are_always_the_same(options):
    env = HFrameEnv(**options)
    _, first = env.reset(seed=0)
    *_, second = env.step(np.zeros(2))
    assert first.keys() == second.keys()
    assert ("parameters" in first) == ("randomize" in options)
    assert first.get("parameters") == second.get("parameters")


@pytest.mark.parametrize("options", [{}, {"sensors": "rig", "drives": "rig", "privileged": True}], ids=str)
def test_spec_makes_the_same_environment_again(options):
    env = gym.make("HFrame-v0", randomize="default", period=0.005, **options)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    np.testing.assert_array_equal(episode(env, seed=1), episode(again, seed=1))


@pytest.mark.parametrize(
    "options", [{}, {"randomize": "default"}, {"normalize": True}, {"task": "track"}], ids=str
)
def test_infos_of_reset_and_step_have_the_same_keys(options):
    env = HFrameEnv(**options)
    _, at_reset = env.reset(seed=0)
    assert env.step([0.0, 0.0])[4].keys() == at_reset.keys()


@pytest.mark.parametrize("machine", [5, None, ["hframe"], True, b"hframe"])
def test_a_machine_of_another_type_is_refused(machine):
    with pytest.raises(
        InputError, match=r"machine is .*; give one of hframe, .*, the path of a machine.json, or a Mach"
    ):
        gym.make("HFrame-v0", machine=machine)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"reward": lambda achieved: achieved},
            r"reward: a test call with \(achieved, desired\) failed: .*1 positional",
        ),
        ({"task": Reach(band="1 mm")}, "band is '1 mm', it must be a positive number, m or rad"),
        ({"task": Reach(margin="a")}, "margin is 'a'"),
        ({"task": Reach(start="home")}, "start must be"),
        ({"task": Track(margin="a")}, "margin of 'a' does not fit"),
    ],
)
def test_options_of_a_wrong_type_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        gym.make("HFrame-v0", **options)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"previews": 2.5}, "previews is 2.5, it must be an integer, at least 1"),
        ({"speed": "fast"}, "speed is 'fast', it must be a positive number"),
        ({"phase": "a"}, "phase is 'a'"),
        ({"path": ["circle", "square"]}, "choose from circle"),
    ],
)
def test_keywords_of_track_of_a_wrong_type_are_refused(keywords, message):
    with pytest.raises(InputError, match=message):
        Track(**keywords)
