"""The options `normalize`, `flat` and `error`: bounds, bits, rewards of relabeled goals, and the flat ids."""

import copy

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation

from hframe_gym.envs import HFrameEnv, HFrameTrackEnv, HFrameVectorEnv
from hframe_gym.errors import InputError

RIG = {"sensors": "rig", "drives": "rig", "randomize": "wide", "privileged": True}
OPTIONS = [{}, {"task": "track"}, RIG, {**RIG, "task": "track"}, {"machine": "hframe-order20"}]


def actions(steps, *shape):
    return np.random.default_rng(0).uniform(-1, 1, (steps, *shape)).astype(np.float32)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_normalized_entries_are_those_in_si_units_over_their_scales(options):
    env, plain = HFrameEnv(normalize=True, **options), HFrameEnv(**options)
    observation, expected = env.reset(seed=3)[0], plain.reset(seed=3)[0]
    for action in actions(20, 2):
        for key, specs in (("observation", env.entries), ("privileged", env.privileged_entries)):
            if not specs:
                continue
            values = (expected[key] - [s.center for s in specs]) / [s.scale for s in specs]
            np.testing.assert_allclose(observation[key], values, rtol=1e-5, atol=1e-6)
        for key in ("achieved_goal", "desired_goal"):
            np.testing.assert_allclose(observation[key], expected[key] / [0.28, 0.19], rtol=1e-6)
        assert env.observation_space.contains(observation)
        observation, expected = env.step(action)[0], plain.step(action)[0]


def test_entries_of_a_running_stage_are_about_one():
    envs = HFrameVectorEnv(64, normalize=True, randomize="wide", privileged=True, task="track")
    envs.reset(seed=0)
    largest = {}
    for action in actions(100, 64, 2):
        for key, values in envs.step(np.sign(action))[0].items():
            largest[key] = np.maximum(largest.get(key, 0.0), np.abs(values).max(axis=0))
    assert all(values.max() < 1.5 for values in largest.values())
    assert all(values.min() > 0.1 for key, values in largest.items() if key != "privileged")
    for space in envs.single_observation_space.values():
        assert np.abs(space.high).max() <= 3.0 + 1e-6


@pytest.mark.parametrize("options", [{}, {"normalize": True}, {"sensors": "rig"}], ids=str)
def test_the_error_is_the_logarithm_of_the_distance_along_each_axis(options):
    env = HFrameEnv(error=True, **options)
    target = np.array([0.1, -0.05])
    for offset in (0.3, 1e-2, 1e-4, -1e-5, 0.0):
        observation, _ = env.reset(seed=0, options={"start": target - [offset, 0.0], "target": target})
        assert env.observation_space.contains(observation)
        seen = {key: observation[key].astype(float) for key in ("achieved_goal", "desired_goal")}
        error = seen["desired_goal"] - seen["achieved_goal"]
        if options.get("normalize"):
            error *= [0.28, 0.19]
        largest = np.array([0.66, 0.48])  # m, between the bounds of positions
        expected = np.sign(error) * np.log1p(np.abs(error) / 1e-4) / np.log1p(largest / 1e-4)
        # float32 rounds positions to 30 nm
        np.testing.assert_allclose(observation["error"], expected, atol=3e-4)
    assert "error" not in HFrameEnv(**options).observation_space.spaces


def test_the_error_of_flat_observations_is_in_alphabetical_order_and_undone():
    form = HFrameVectorEnv(2, normalize=True, flat=True, error=True, task="track").batch.format
    names = [entry.name for entry in form.entries]
    assert names[3:7] == ["desired_goal y", "error x", "error y", "x"]
    plain, _ = HFrameVectorEnv(2, task="track").reset(seed=0)
    restored = form.restore(form.apply(plain))
    assert restored.keys() == plain.keys()
    for key, values in plain.items():
        np.testing.assert_allclose(restored[key], values, atol=1e-6)


REWARDED = [{}, {"reward": "dense"}, {"reward": "sparse"}, {"ends": "terminate"}, RIG, {"task": "track"}]


@pytest.mark.parametrize("options", REWARDED, ids=str)
def test_rewards_of_observed_goals_are_those_of_the_step_to_the_bit(options):
    env = HFrameEnv(normalize=True, **options)
    env.reset(seed=1)
    for action in actions(30, 2):
        observation, reward, _, _, info = env.step(action)
        goals = observation["achieved_goal"], observation["desired_goal"]
        assert env.compute_reward(*goals, info) == reward
        both = env.compute_reward(*(np.stack([goal, goal]) for goal in goals), [info, info])
        np.testing.assert_array_equal(both, [reward, reward])


def test_normalized_rewards_are_those_in_si_units():
    env, plain = HFrameEnv(normalize=True, reward="dense"), HFrameEnv()
    env.reset(seed=1), plain.reset(seed=1)
    for action in actions(30, 2):
        assert env.step(action)[1] == pytest.approx(plain.step(action)[1], rel=1e-5)
    relabeled = env.compute_reward(np.array([0.5, 0.0]), np.array([0.5, 0.0]), {})
    assert relabeled == 0.0


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize(
    "options",
    [{"normalize": True}, {"flat": True}, {"normalize": True, "flat": True}, {"error": True}],
    ids=str,
)
def test_vector_environments_have_the_bits_of_single_ones(options, mode):
    envs = HFrameVectorEnv(3, max_episode_steps=8, autoreset_mode=mode, randomize="default", **options)
    singles = [gym.make("HFrame-v0", max_episode_steps=8, randomize="default", **options) for _ in range(3)]
    observation, _ = envs.reset(seed=5)
    assert envs.observation_space.contains(observation)
    begin = [env.reset(seed=5 + i)[0] for i, env in enumerate(singles)]
    for i, first in enumerate(begin):
        assert_equal(row(observation, i), first)
    for step, action in enumerate(actions(8, 3, 2)):
        observation, reward, _, truncated, info = envs.step(action)
        for i, env in enumerate(singles):
            expected, expected_reward, *_ = env.step(action[i])
            last = step == 7 and mode == "SameStep"
            assert_equal(info["final_obs"][i] if last else row(observation, i), expected)
            assert reward[i] == expected_reward
    assert truncated.all()


def row(observation, i):
    return {k: v[i] for k, v in observation.items()} if isinstance(observation, dict) else observation[i]


def assert_equal(observation, expected):
    if isinstance(expected, dict):
        assert observation.keys() == expected.keys()
        for key, values in expected.items():
            np.testing.assert_array_equal(observation[key], values)
    else:
        np.testing.assert_array_equal(observation, expected)


@pytest.mark.parametrize("name", ["HFrame", "HFrameTrack"])
def test_flat_ids_are_the_dict_ids_flattened(name):
    flat, wrapped = gym.make(f"{name}Flat-v0", **RIG), FlattenObservation(gym.make(f"{name}-v0", **RIG))
    assert flat.observation_space == wrapped.observation_space
    assert not hasattr(flat.unwrapped, "compute_reward")
    assert len(flat.unwrapped.entries) == flat.observation_space.shape[0]
    names = [entry.name for entry in flat.unwrapped.entries]
    assert names[:6] == ["achieved_goal x", "achieved_goal y", "desired_goal x", "desired_goal y", "x", "y"]
    np.testing.assert_array_equal(flat.reset(seed=0)[0], wrapped.reset(seed=0)[0])
    for action in actions(5, 2):
        np.testing.assert_array_equal(flat.step(action)[0], wrapped.step(action)[0])
    envs = gym.make_vec(f"{name}Flat-v0", num_envs=2)
    assert isinstance(envs, HFrameVectorEnv)
    assert (
        envs.reset(seed=0)[0].shape
        == envs.observation_space.shape
        == (2, *envs.single_observation_space.shape)
    )


def test_every_entry_of_a_flat_observation_has_its_own_name():
    env = gym.make("HFrameFlat-v0", privileged=True, randomize="default").unwrapped
    names = [entry.name for entry in env.entries]
    assert len(set(names)) == len(names) == env.observation_space.shape[0]
    assert names[4:6] == ["x", "y"]
    assert {f"privileged {entry.name}" for entry in env.privileged_entries} <= set(names)


def test_a_flat_environment_is_copied_and_made_again_from_its_specification():
    env = gym.make("HFrameFlat-v0", normalize=True)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    np.testing.assert_array_equal(env.reset(seed=2)[0], again.reset(seed=2)[0])
    copied = copy.deepcopy(env.unwrapped)
    for action in actions(5, 2):
        np.testing.assert_array_equal(env.unwrapped.step(action)[0], copied.step(action)[0])


def test_options_must_be_switches():
    with pytest.raises(InputError, match="normalize is 'yes'"):
        HFrameEnv(normalize="yes")
    with pytest.raises(InputError, match="needs a task with a path"):
        HFrameTrackEnv(task="reach", flat=True)


def test_progress_is_the_log_ratio_of_distances_and_a_bonus_at_the_goal():
    env = HFrameEnv(normalize=True)
    _, info = env.reset(seed=1, options={"start": (0.01, 0.0), "target": (0.0, 0.0)})
    for action in actions(30, 2):
        before = info["distance_m"]
        _, reward, _, _, info = env.step(action)
        after = info["distance_m"]
        expected = np.log((1e-3 + before) / (1e-3 + after)) + 1.0 / (1.0 + after / 2e-3)
        assert reward == pytest.approx(expected, rel=1e-4)
    at_goal = np.zeros(2, np.float32)
    assert env.compute_reward(at_goal, at_goal, {"previous_achieved_goal": at_goal}) == 1.0


def test_progress_starts_anew_with_every_episode():
    envs = HFrameVectorEnv(3, normalize=True, max_episode_steps=5, autoreset_mode="SameStep")
    envs.reset(seed=1)
    for action in actions(12, 3, 2):
        _, reward, _, _, info = envs.step(action)
        assert np.abs(reward).max() < 0.5  # a jump to another start and goal would be up to ln 1000
        keys = info["final_info"].keys() if "final_info" in info else info.keys()
        assert {"previous_achieved_goal", "_previous_achieved_goal"} <= keys


def test_relabeled_progress_needs_the_goal_before_the_step():
    env = HFrameEnv(normalize=True)
    env.reset(seed=1)
    observation, _, _, _, info = env.step([1.0, 1.0])
    reached = observation["achieved_goal"]
    assert env.compute_reward(reached, reached, info) > 0.0  # as if the tool had moved to its goal
    with pytest.raises(InputError, match="choose reward='sparse' or 'dense'"):
        env.compute_reward(reached, reached, {})
