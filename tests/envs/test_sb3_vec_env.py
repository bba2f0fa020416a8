"""The stable-baselines3 adapter returns the bits of the vector environment."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.vec_env import VecMonitor

from hframe_gym.envs import HFrameVectorEnv, VectorCostWrapper, VectorObserveQuantities, VectorPenaltyWrapper
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from hframe_gym.errors import InputError


def test_bits_and_episode_ends():
    keywords = {"randomize": "default", "max_episode_steps": 10}
    vec, plain = HFrameVecEnv(6, **keywords), HFrameVectorEnv(6, autoreset_mode="SameStep", **keywords)
    vec.seed(4)
    observation, (expected, info) = vec.reset(), plain.reset(seed=4)
    np.testing.assert_array_equal(observation["observation"], expected["observation"])
    assert vec.reset_infos[2]["parameters"]["x.mass"] == info["parameters"]["x.mass"][2]
    rng = np.random.default_rng(0)
    for step in range(25):
        action = rng.uniform(-1, 1, (6, 2)).astype(np.float32)
        observation, reward, done, infos = vec.step(action)
        expected, expected_reward, terminated, truncated, info = plain.step(action)
        for key, value in observation.items():
            np.testing.assert_array_equal(value, expected[key])
        np.testing.assert_array_equal(reward, expected_reward)
        np.testing.assert_array_equal(done, terminated | truncated)
        assert done.all() == (step % 10 == 9)
        if done.all():
            assert infos[3]["TimeLimit.truncated"] is True
            terminal = infos[3]["terminal_observation"]
            np.testing.assert_array_equal(terminal["observation"], info["final_obs"][3]["observation"])
            assert not np.array_equal(terminal["desired_goal"], observation["desired_goal"][3])


def test_wrapped_environments_give_what_the_wrappers_give():
    """Penalties, costs and observed quantities, through the end of an episode."""

    def wrapped(envs):
        observed = VectorObserveQuantities(VectorPenaltyWrapper(envs, {"velocity": 2.0}), ("belt_force",))
        return VectorCostWrapper(observed, {"velocity": 0.1})

    vec = HFrameVecEnv(3, max_episode_steps=4, wrappers=[wrapped])
    plain = wrapped(HFrameVectorEnv(3, max_episode_steps=4, autoreset_mode="Disabled"))
    vec.seed(4)
    assert vec.observation_space.contains({key: rows[0] for key, rows in vec.reset().items()})
    plain.reset(seed=4)
    actions = np.random.default_rng(0).uniform(-1, 1, (6, 3, 2)).astype(np.float32)
    for step, action in enumerate(actions):
        observation, reward, done, infos = vec.step(action)
        expected, expected_reward, _, over, info = plain.step(action)
        np.testing.assert_array_equal(reward, expected_reward)
        assert [row["cost"] for row in infos] == info["cost"].tolist()
        if step == 3:
            assert done.all()
            for b, row in enumerate(infos):
                last = row["terminal_observation"]["quantities"]
                np.testing.assert_array_equal(last, expected["quantities"][b])
            expected, _ = plain.reset(options={"reset_mask": over})
        np.testing.assert_array_equal(observation["quantities"], expected["quantities"])
    assert info["cost"].any()


def test_an_end_at_the_edge_is_not_a_truncation():
    vec = HFrameVecEnv(1, ends="terminate")
    vec.set_options({"start": (0.27, 0.0)})
    vec.reset()
    done = np.array([False])
    while not done.any():
        _, _, done, infos = vec.step(np.array([[-1.0, 1.0]], np.float32))
    assert infos[0]["TimeLimit.truncated"] is False


@pytest.mark.parametrize("name", ["HFrameTrack-v0", "HFrameTrackFlat-v0"])
def test_an_id_selects_the_environment(name):
    vec = HFrameVecEnv(2, env_id=name, normalize=True)
    plain = gym.make_vec(name, num_envs=2, normalize=True)
    assert vec.observation_space == plain.single_observation_space
    vec.seed(1)
    observation, expected = vec.reset(), plain.reset(seed=1)[0]
    for key in expected if isinstance(expected, dict) else (slice(None),):
        np.testing.assert_array_equal(observation[key], expected[key])


def test_wrong_keywords_are_answered_with_the_right_ones():
    with pytest.raises(TypeError, match=r"HFrameVecEnv.*'n_envs'. Did you mean 'num_envs'\?.*env_id"):
        HFrameVecEnv(n_envs=4)
    with pytest.raises(InputError, match="choose one of HFrame-v0, HFrameTrack-v0, HFrameFlat-v0"):
        HFrameVecEnv(2, env_id="Pendulum-v1")
    with pytest.raises(InputError, match="env_id='HFrameTrack-v0'"):
        HFrameVecEnv("HFrameTrack-v0")


def test_options_must_be_the_same_for_all():
    vec = HFrameVecEnv(2)
    vec.set_options([{"start": (0.0, 0.0)}, {}])
    with pytest.raises(InputError, match="same options"):
        vec.reset()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": (9.0, 9.0)}, r"options\['target'\] must be \(x, y\) with x in"),
        ({"target": "far"}, r"options\['target'\] is \['far', 'far'\], it must be a position"),
        (
            {"goal": (0.0, 0.0)},
            "unknown option 'goal'; choose 'start', 'target', 'parameters', 'state' or 'reset_mask'",
        ),
        ([{"target": (0.0, 0.0)}], "give each of the 2 environments the same options"),
        (5, "set_options: 5 must be a dict, or a list"),
    ],
)
def test_refused_options_are_dropped_and_the_seed_is_kept(options, message):
    vec, other = HFrameVecEnv(2), HFrameVecEnv(2)
    for env in (vec, other):
        env.seed(3)
    vec.set_options(options)
    with pytest.raises(InputError, match=message):
        vec.reset()
    np.testing.assert_array_equal(vec.reset()["desired_goal"], other.reset()["desired_goal"])


def test_a_refused_seed_is_not_stored():
    vec, other = HFrameVecEnv(2), HFrameVecEnv(2)
    for env in (vec, other):
        env.seed(3)
    for seed in (-1, "a", 1.5):
        with pytest.raises(InputError, match=f"seed is {seed!r}, it must be an integer"):
            vec.seed(seed)
    np.testing.assert_array_equal(vec.reset()["desired_goal"], other.reset()["desired_goal"])
    vec.seed()
    vec.reset()


@pytest.mark.train
def test_hindsight_replay_works():
    vec = VecMonitor(HFrameVecEnv(4, reward="sparse", max_episode_steps=20))
    model = SAC(
        "MultiInputPolicy",
        vec,
        replay_buffer_class=HerReplayBuffer,
        learning_starts=100,
        buffer_size=2000,
        batch_size=32,
        gradient_steps=1,
        policy_kwargs={"net_arch": [16]},
        device="cpu",
    )
    model.learn(200)
    assert model.num_timesteps >= 200


@pytest.mark.slow
def test_ppo_learns_with_its_default_hyperparameters():
    def final_distance(model):
        envs = HFrameVectorEnv(64, max_episode_steps=None, normalize=True)
        observation, info = envs.reset(seed=0)
        for _ in range(150):
            observation, _, _, _, info = envs.step(model.predict(observation, deterministic=True)[0])
        return np.median(info["distance_m"])

    model = PPO("MultiInputPolicy", gym.make("HFrame-v0", normalize=True), seed=0, device="cpu")
    assert final_distance(model) > 0.1
    model.learn(8_000)
    # with 120 000 steps below 1 mm (benchmarks/plain_ppo.py)
    assert final_distance(model) < 0.04


def test_infos_hold_what_the_progress_reward_needs():
    """Hindsight replay computes rewards from stored infos, so each must hold the goals before its step."""
    vec, rng = HFrameVecEnv(2, normalize=True), np.random.default_rng(0)
    observation, stored = vec.reset(), []
    for _ in range(5):
        following, rewards, _, infos = vec.step(rng.uniform(-1, 1, (2, 2)).astype(np.float32))
        stored += [(observation, following, b, rewards[b], infos[b]) for b in range(2)]
        observation = following
    for before, after, b, reward, info in stored:
        np.testing.assert_array_equal(info["previous_achieved_goal"], before["achieved_goal"][b])
        goals = (after["achieved_goal"][b], after["desired_goal"][b])
        assert vec.envs.compute_reward(*goals, info) == pytest.approx(reward)


def test_attributes_are_found_by_the_methods_of_single_environments() -> None:
    envs = HFrameVecEnv(3)
    assert envs.env_method("get_wrapper_attr", "max_episode_steps") == [150] * 3
    assert envs.env_method("has_wrapper_attr", "max_episode_steps", indices=[1]) == [True]
    assert envs.env_method("has_wrapper_attr", "nothing") == [False] * 3
    with pytest.raises(AttributeError, match="nothing"):
        envs.env_method("get_wrapper_attr", "nothing")
    assert envs.get_attr("action_space", indices=[0, 2]) == [envs.action_space] * 2
    envs.set_attr("max_episode_steps", 7)
    assert envs.get_attr("max_episode_steps") == [7] * 3
    with pytest.raises(AttributeError, match="have no attribute 'penalty'"):
        envs.set_attr("penalty", 3.0)
