"""The vector environment returns the bits of single ones, in every autoreset mode and any thread count."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import Error
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import hframe_gym  # noqa: F401  (registers the environments)
from hframe_gym.dynamics import LANES, NotFiniteError
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.envs import environment_batch as batch_module
from hframe_gym.errors import InputError


def same(a, b, path=""):
    """Compare bit by bit, through dictionaries, arrays of dictionaries and masks."""
    if isinstance(a, dict):
        assert set(a) == set(b), path
        for key in a:
            same(a[key], b[key], f"{path}/{key}")
    elif isinstance(a, tuple) or (isinstance(a, np.ndarray) and a.dtype == object):
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            same(x, y, f"{path}[{i}]")
    elif a is None:
        assert b is None, path
    else:
        a, b = np.asarray(a), np.asarray(b)
        assert a.dtype == b.dtype, path
        if a.shape != b.shape or a.tobytes() != b.tobytes():  # takes a tenth of the next line's time
            np.testing.assert_array_equal(a, b, err_msg=path)


def actions(n, steps, seed=0):
    """Return random actions, (steps, n, 2), held five steps so that tools move, some outside the range."""
    drawn = np.random.default_rng(seed).uniform(-1.2, 1.2, (steps // 5 + 1, n, 2))
    return np.repeat(drawn, 5, axis=0)[:steps].astype(np.float32)


OPTIONS = [{"randomize": "default"}, {"randomize": "wide", "ends": "terminate", "machine": "hframe-order20"}]


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("options", OPTIONS, ids=["stops", "terminate"])
def test_equals_gymnasium_s_vector_of_single_environments(mode, options):
    n = 11
    ours = HFrameVectorEnv(n, max_episode_steps=23, autoreset_mode=mode, **options)
    make = lambda: gym.wrappers.TimeLimit(gym.make("HFrame-v0", **options).unwrapped, 23)  # noqa: E731
    theirs = SyncVectorEnv([make] * n, autoreset_mode=mode)
    same(ours.reset(seed=5), theirs.reset(seed=5))
    ended = 0
    for action in actions(n, 80):
        mine, other = ours.step(action), theirs.step(action)
        same(mine, other)
        ended += int((mine[2] | mine[3]).sum())
    assert ended >= 3 * n


def test_disabled_mode_resets_by_mask():
    n = 9
    options = {"randomize": "default"}
    ours = HFrameVectorEnv(n, max_episode_steps=None, autoreset_mode="Disabled", **options)
    theirs = SyncVectorEnv(
        [lambda: gym.make("HFrame-v0", **options).unwrapped] * n, autoreset_mode=AutoresetMode.DISABLED
    )
    same(ours.reset(seed=2), theirs.reset(seed=2))
    mask = np.arange(n) % 3 == 1
    for i, action in enumerate(actions(n, 12)):
        same(ours.step(action), theirs.step(action))
        if i % 4 == 3:
            mine, info = ours.reset(options={"reset_mask": mask.copy()})
            other, other_info = theirs.reset(options={"reset_mask": mask.copy()})
            same(mine, other)
            same(info, other_info)


def test_disabled_mode_refuses_steps_after_the_end():
    envs = HFrameVectorEnv(3, max_episode_steps=2, autoreset_mode="Disabled")
    envs.reset(seed=0)
    action = np.zeros((3, 2), np.float32)
    envs.step(action)
    envs.step(action)
    with pytest.raises(RuntimeError, match="environment 0 is over"):
        envs.step(action)


def run(n, steps, seed=3, **options):
    envs = HFrameVectorEnv(n, max_episode_steps=40, randomize="default", **options)
    history = [envs.reset(seed=seed)]
    history += [envs.step(action) for action in actions(n, steps)]
    return history


@pytest.mark.parametrize("threads", ["2", "3"])
def test_the_thread_count_changes_no_bit(monkeypatch, threads):
    monkeypatch.setattr(batch_module, "_COUNT_FOR_THREADS", 1)
    monkeypatch.setenv("HFRAME_THREADS", "1")
    alone = run(70, 90)
    monkeypatch.setenv("HFRAME_THREADS", threads)
    for a, b in zip(alone, run(70, 90), strict=True):
        same(a[0], b[0])
        same(a[1], b[1])


def test_a_seed_determines_everything():
    first, second = run(5, 60), run(5, 60)
    for a, b in zip(first, second, strict=True):
        same(a, b)
    other = run(5, 1, seed=4)
    # Environment i of seed 3 is environment i - 1 of seed 4.
    same(first[0][0]["desired_goal"][1:], other[0][0]["desired_goal"][:-1])
    assert not np.array_equal(first[0][0]["desired_goal"][0], other[0][0]["desired_goal"][0])


def test_returned_arrays_are_fresh():
    envs = HFrameVectorEnv(4, randomize="default")
    observation, _ = envs.reset(seed=0)
    kept = {key: value.copy() for key, value in observation.items()}
    for action in actions(4, 5):
        envs.step(action)
    same(observation, kept)


def test_the_autoreset_mode_is_declared():
    envs = gym.make_vec("HFrame-v0", num_envs=3, autoreset_mode="SameStep")
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.max_episode_steps == 150
    again = gym.make_vec(envs.spec)
    assert again.num_envs == 3
    assert again.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_a_hundred_thousand_steps_stay_finite_and_inside_the_end_stops():
    envs = HFrameVectorEnv(500, randomize="wide")
    envs.reset(seed=0)
    box = envs.observation_space
    for action in actions(500, 200):
        observation, reward, *_ = envs.step(action)
        assert np.isfinite(reward).all()
        assert box.contains(observation)
    # No tool is farther outside than a buffer yields.
    x, y = np.abs(observation["achieved_goal"]).max(axis=0)
    assert x < 0.28 + 0.02
    assert y < 0.19 + 0.02


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"max_episode_steps": 0}, "max_episode_steps"),
        ({"autoreset_mode": "Never"}, "Never"),
        ({"render_mode": "human"}, "render_mode"),
    ],
)
def test_invalid_options_are_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        HFrameVectorEnv(**keywords)


def test_invalid_masks_are_refused():
    envs = HFrameVectorEnv(3)
    with pytest.raises(TypeError, match="reset_mask"):
        envs.reset(options={"reset_mask": [True, False, False]})
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(options={"reset_mask": np.zeros(3, bool)})


def test_start_positions_have_one_row_per_environment():
    envs = HFrameVectorEnv(5)
    with pytest.raises(InputError, match=r"start.*\(3, 2\).*\(5, 2\)"):
        envs.reset(seed=0, options={"start": np.zeros((3, 2))})


def test_parameters_and_travel_are_those_of_the_episodes(hframe):
    envs = HFrameVectorEnv(11, randomize="default")
    _, info = envs.reset(seed=0, options={"start": (0.05, -0.02)})
    observation, *_ = envs.step(np.full((11, 2), 0.5, np.float32))
    column = list(envs.machine.parameters).index("x.mass")
    np.testing.assert_array_equal(envs.parameters[:, column], info["parameters"]["x.mass"])
    np.testing.assert_array_equal(envs.travel[:, :2].astype(np.float32), observation["achieved_goal"])
    np.testing.assert_allclose(
        envs.travel[:, 2:] / hframe.travel_per_unit[2:], observation["observation"][:, 2:4], rtol=1e-6
    )


def test_a_refused_reset_changes_no_random_numbers():
    vector, again = (HFrameVectorEnv(3) for _ in range(2))
    vector.reset(seed=5)
    again.reset(seed=5)
    with pytest.raises(ValueError, match="seed has 2 entries, but there are 3 environments"):
        vector.reset(seed=[1, 2])
    with pytest.raises(InputError, match="unknown option"):
        vector.reset(seed=9, options={"goal": (0.0, 0.0)})
    with pytest.raises(InputError, match=r"must be \(x, y\) with x in"):
        vector.reset(seed=9, options={"target": (9.0, 0.0)})
    with pytest.raises(Error, match="Seed must be greater or equal to zero"):
        vector.reset(seed=[9, -1, 9])
    np.testing.assert_array_equal(vector.reset()[0]["desired_goal"], again.reset()[0]["desired_goal"])


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        *(
            ({"num_envs": n}, f"num_envs is {n!r}, it must be an integer, at least 1")
            for n in (2.5, 2.0, "2", None, True)
        ),
        *(
            ({"max_episode_steps": n}, f"max_episode_steps is {n!r}, it must be an integer")
            for n in (2.5, "5", 0)
        ),
        *(
            ({"autoreset_mode": m}, f"is {m!r}; choose one of NextStep, SameStep, Disabled")
            for m in ("same", 5, None)
        ),
    ],
)
def test_keywords_of_a_wrong_type_are_refused(keywords, message):
    with pytest.raises(InputError, match=message):
        HFrameVectorEnv(**keywords)
    if "num_envs" in keywords and keywords["num_envs"] is not None:
        with pytest.raises(InputError, match=message):
            gym.make_vec("HFrame-v0", **keywords)


def test_attributes_and_methods_of_the_environments_are_reached_as_in_gymnasium() -> None:
    envs = gym.make_vec("HFrame-v0", num_envs=3, randomize="default")
    envs.reset(seed=0)
    assert envs.call("machine") == envs.get_attr("machine") == (envs.unwrapped.machine,) * 3
    goal = np.zeros(2)
    assert envs.call("compute_reward", goal, goal, {}) == (0.0,) * 3
    envs.set_attr("max_episode_steps", 7)
    assert envs.get_attr("max_episode_steps") == (7, 7, 7)
    envs.set_attr("max_episode_steps", [9, 9, 9])
    assert envs.get_attr("max_episode_steps") == (9, 9, 9)
    with pytest.raises(InputError, match="exists once for all environments"):
        envs.set_attr("max_episode_steps", [1, 2, 3])
    with pytest.raises(ValueError, match="2 values for 3 environments"):
        envs.set_attr("max_episode_steps", [1, 2])
    assert envs.get_attr("action_space") == (envs.single_action_space,) * 3
    assert envs.get_attr("observation_space") == (envs.single_observation_space,) * 3
    with pytest.raises(AttributeError, match="have no attribute 'mass'"):
        envs.get_attr("mass")
    with pytest.raises(AttributeError, match="have no attribute 'penalty'"):  # an option, which is read once
        envs.set_attr("penalty", 3.0)


@pytest.mark.parametrize("sensors", ["state", "rig"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_motion_that_is_not_finite_is_reported_with_the_first_environment(sensors, value):
    count, broken = 40, (21, 23, 38)
    envs = gym.make_vec("HFrame-v0", num_envs=count, sensors=sensors)
    envs.reset(seed=0)
    envs.step(np.zeros((count, 2), np.float32))
    for b in broken:
        block, lane = divmod(b, LANES)
        envs.unwrapped.batch.simulator.state[block, 0, lane] = value
    with pytest.raises(NotFiniteError, match="environment 21: the motion of machine 'hframe' is not finite"):
        envs.step(np.zeros((count, 2), np.float32))
