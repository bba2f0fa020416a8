"""Rewards: exact recomputation, slope near the goal, and functions of a user."""

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameEnv, HFrameVectorEnv, Lasers, Sensors
from hframe_gym.envs.rewards import as_reward
from hframe_gym.machine import BUILTIN_MACHINES


def dense(distances):
    """Return the dense rewards at distances from the goal."""
    achieved = np.zeros((len(distances), 2), np.float32)
    achieved[:, 0] = distances
    return as_reward("dense", 1e-3)(achieved, np.zeros_like(achieved))


def manhattan(achieved, desired):
    """Return minus the sum of the distances along x and y."""
    return -np.abs(achieved - desired).sum(axis=1)


def test_the_dense_reward_pays_for_every_halving():
    d = 0.4 * 0.5 ** np.arange(16)  # down to 12 um
    gains = np.diff(dense(d))
    assert np.all(gains > 0.015)
    assert gains.max() < 3.5 * gains.min()
    assert dense([0.0])[0] == 0.0


def test_the_arrival_reward_pays_most_for_the_last_millimeters():
    d = np.array([[0.2, 0.0], [0.01, 0.0], [1e-3, 0.0], [2e-4, 0.0], [0.0, 0.0]], np.float32)
    gains, of_dense = np.diff(as_reward("arrival", 1e-3)(d, np.zeros_like(d))), np.diff(dense(d[:, 0]))
    assert gains / of_dense == pytest.approx([0.45, 1.22, 1.80, 1.22], abs=0.01)
    assert gains.sum() == pytest.approx(0.967, abs=1e-3)


@pytest.mark.parametrize("reward", ["dense", "sparse"])
@pytest.mark.parametrize("ends", ["stops", "terminate"])
def test_compute_reward_returns_the_bits_of_step(reward, ends):
    envs = HFrameVectorEnv(37, reward=reward, ends=ends, randomize="default", autoreset_mode="SameStep")
    envs.reset(seed=0)
    single = HFrameEnv(reward=reward, ends=ends)
    ended = 0
    for _ in range(40):
        observation, rewards, over, _, info = envs.step(np.full((37, 2), 0.7, np.float32))
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        for b in np.flatnonzero(over):
            achieved[b] = info["final_obs"][b]["achieved_goal"]
            desired[b] = info["final_obs"][b]["desired_goal"]
        np.testing.assert_array_equal(envs.compute_reward(achieved, desired, {}), rewards)
        one_by_one = [single.compute_reward(a, d, {}) for a, d in zip(achieved, desired, strict=True)]
        np.testing.assert_array_equal(one_by_one, rewards)
        assert type(one_by_one[0]) is float
        ended += int(over.sum())
    assert (ended > 0) == (ends == "terminate")


@pytest.mark.parametrize("reward", ["dense", "sparse", "progress", manhattan])
def test_one_goal_goes_with_many_positions(reward):
    env = HFrameEnv(reward=reward, ends="terminate")
    positions = np.random.default_rng(0).uniform(-0.3, 0.3, (6, 2)).astype(np.float32)
    goal = np.array([0.1, 0.05], np.float32)
    infos = [{"previous_achieved_goal": position / 2} for position in positions]
    expected = env.compute_reward(positions, np.tile(goal, (6, 1)), infos)
    np.testing.assert_array_equal(env.compute_reward(positions, goal, infos), expected)
    np.testing.assert_array_equal(env.compute_reward(positions, goal[None], infos), expected)
    reverse = env.compute_reward(goal, positions, [{"previous_achieved_goal": goal / 2}] * 6)
    assert reverse.shape == (6,)
    assert np.all(np.isfinite(reverse))


@pytest.mark.parametrize("reward", ["dense", "progress"])
def test_goals_of_other_shapes_raise_an_error(reward):
    compute = HFrameEnv(reward=reward).compute_reward
    info = {"previous_achieved_goal": np.zeros(2, np.float32)}
    for first, second in (((3, 2), (4, 2)), ((3, 5), (3, 5)), ((3,), (3,)), ((1, 3, 2), (1, 3, 2)), ((), ())):
        with pytest.raises(ValueError, match=r"both must be \(2,\) or \(n, 2\)"):
            compute(np.zeros(first, np.float32), np.zeros(second, np.float32), [info] * 3)
    if reward == "progress":
        with pytest.raises(ValueError, match="1 infos for goals of shape"):
            compute(np.zeros((3, 2)), np.zeros((3, 2)), info)
    with pytest.raises(ValueError, match="must be"):
        as_reward(reward, 1e-3)(np.zeros((9, 2), np.float32), np.zeros((1, 2), np.float32))


@pytest.mark.parametrize("lasers", [Lasers(noise=1e-3), Lasers(span=np.inf, noise=1e-3), None])
def test_the_penalty_and_the_end_of_an_episode_coincide(lasers):
    machine = BUILTIN_MACHINES["hframe"]()
    for channel in machine.output_channels:
        machine = machine.with_effects(EFFECTS["sensor_delay"].at(channel, d=0.012))
    envs = HFrameVectorEnv(
        32, machine=machine, sensors=Sensors(lasers=lasers), ends="terminate", autoreset_mode="SameStep"
    )
    envs.reset(seed=0)
    actions = np.sign(np.random.default_rng(0).normal(size=(32, 2))).astype(np.float32)
    ended = 0
    for _ in range(60):
        _, rewards, terminated, _, _ = envs.step(actions)
        np.testing.assert_array_equal(terminated, rewards < -50.0)
        ended += int(terminated.sum())
    assert ended > 20


def test_the_sparse_reward_is_zero_in_the_band():
    reward = as_reward("sparse", 1e-3)
    goals = np.zeros((2, 2), np.float32)
    goals[:, 1] = [0.0009, 0.0011]
    np.testing.assert_array_equal(reward(goals, np.zeros_like(goals)), [0.0, -1.0])


def test_a_function_can_be_the_reward():
    env = HFrameEnv(reward=manhattan)
    observation, _ = env.reset(seed=0)
    observation, reward, *_ = env.step(np.zeros(2))
    assert reward == pytest.approx(-np.abs(observation["achieved_goal"] - observation["desired_goal"]).sum())


def test_a_function_of_another_shape_is_refused():
    with pytest.raises(ValueError, match="one finite number per row"):
        HFrameEnv(reward=lambda achieved, desired: 0.0)


@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("reward", ["dense", "arrival", "sparse", "progress"])
@pytest.mark.parametrize("task", ["reach", "track"])
def test_the_compiled_rewards_equal_those_from_goals_as_observed(reward, normalize, task):
    envs = HFrameVectorEnv(
        19, reward=reward, normalize=normalize, task=task, sensors="rig", max_episode_steps=11
    )
    envs.reset(seed=2)
    rng = np.random.default_rng(0)
    compared = 0
    for _ in range(30):
        observation, rewards, _, _, info = envs.step(rng.uniform(-1.0, 1.0, (19, 2)))
        infos = [{key: info[key][b] for key in info if key.startswith("previous")} for b in range(19)]
        going_on = envs.batch.elapsed > 0  # in the step that begins an episode, the reward is zero
        again = envs.compute_reward(observation["achieved_goal"], observation["desired_goal"], infos)
        np.testing.assert_array_equal(again[going_on], rewards[going_on])
        compared += int(going_on.sum())
    assert compared > 500


def test_results_of_earlier_steps_are_not_overwritten():
    envs = HFrameVectorEnv(3, normalize=True, randomize="default")
    envs.reset(seed=0)
    _, rewards, terminated, _, info = envs.step(np.full((3, 2), 0.4))
    kept = rewards.copy(), terminated.copy(), info["distance_m"].copy()
    envs.step(np.full((3, 2), -0.9))
    for now, before in zip((rewards, terminated, info["distance_m"]), kept, strict=True):
        np.testing.assert_array_equal(now, before)


def test_changing_an_info_changes_nothing_in_the_environment():
    env = HFrameEnv(randomize="default")
    _, info = env.reset(seed=0)
    expected = dict(info["parameters"])
    info["parameters"].clear()
    assert env.step(np.zeros(2))[4]["parameters"] == expected
