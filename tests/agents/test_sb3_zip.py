"""Tests of the models that stable-baselines3 saves, as controllers."""

from __future__ import annotations

import pickle
import warnings
import zipfile
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym.agents import Sb3Model
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from hframe_gym.errors import InputError
from hframe_gym.evaluation import PROTOCOLS, Scenario, evaluate, make_controller, make_entry

stable_baselines3 = pytest.importorskip("stable_baselines3")


def saved(path: Path, env: Any, algorithm: str = "PPO", seed: int = 0, **keywords: Any) -> str:
    """Save a model with random weights; return the path of the file."""
    policy = "MultiInputPolicy" if isinstance(env.observation_space, gym.spaces.Dict) else "MlpPolicy"
    if algorithm == "PPO":
        keywords |= {"n_steps": 8, "batch_size": 8}
    model = getattr(stable_baselines3, algorithm)(policy, env, seed=seed, device="cpu", **keywords)
    model.save(path)
    return str(path)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"normalize": True},
        {"flat": True},
        {"normalize": True, "flat": True},
        {"normalize": True, "error": True},
    ],
)
@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_a_model_acts_as_in_its_training(tmp_path: Path, algorithm: str, options: dict[str, bool]) -> None:
    envs = HFrameVecEnv(4, **options)  # type: ignore[arg-type]
    name = saved(tmp_path / "model.zip", envs, algorithm)
    controller = make_controller(name)
    assert isinstance(controller, Sb3Model)
    plain, _ = HFrameVectorEnv(4).reset(seed=5)
    envs.seed(5)
    model = getattr(stable_baselines3, algorithm).load(name, device="cpu")
    expected, _ = model.predict(envs.reset(), deterministic=True)
    np.testing.assert_array_equal(controller.act(plain), expected)


def test_a_recurrent_model_remembers_each_machine_until_its_episode_ends(tmp_path: Path) -> None:
    contrib = pytest.importorskip("sb3_contrib")
    envs = HFrameVecEnv(3, normalize=True, sensors="rig")
    model = contrib.RecurrentPPO("MultiInputLstmPolicy", envs, n_steps=8, batch_size=8, seed=0, device="cpu")
    model.save(tmp_path / "model.zip")
    controller = make_controller(str(tmp_path / "model.zip"), sensors="rig")
    plain, _ = HFrameVectorEnv(3, sensors="rig").reset(seed=5)
    envs.seed(5)
    seen, memory, starts = envs.reset(), None, np.ones(3, bool)
    for ends in ([False, True, False], [False, False, False], [False, False, False]):
        expected, memory = model.predict(seen, memory, starts, deterministic=True)
        np.testing.assert_array_equal(controller.act(plain), expected)
        starts = np.array(ends)
        controller.reset(starts)
    assert not np.array_equal(
        expected[1], model.predict(seen, None, np.ones(3, bool), deterministic=True)[0][1]
    )
    controller.reset()
    first, _ = model.predict(seen, None, np.ones(3, bool), deterministic=True)
    np.testing.assert_array_equal(controller.act(plain), first)


def test_a_model_of_hindsight_replay_needs_neither_its_environment_nor_its_memory(tmp_path: Path) -> None:
    replay = {
        "replay_buffer_class": stable_baselines3.HerReplayBuffer,
        "replay_buffer_kwargs": {"n_sampled_goal": 4},
        "buffer_size": 1000,
    }
    envs = HFrameVecEnv(2, normalize=True, reward="sparse")
    controller = make_controller(saved(tmp_path / "model.zip", envs, "SAC", **replay))
    assert isinstance(controller, Sb3Model)
    assert controller.model.replay_buffer.buffer_size == 1


def test_a_model_that_does_not_know_the_environment_refuses_normalized_observations(tmp_path: Path) -> None:
    envs = HFrameVectorEnv(4, normalize=True)
    observation, _ = envs.reset(seed=5)
    name = saved(tmp_path / "model.zip", HFrameVecEnv(2, normalize=True))
    with pytest.raises(InputError, match="not in SI units"):
        make_controller(name).act(observation)
    assert make_controller(name, envs).act(observation).shape == (4, 2)


def test_models_are_evaluated_by_their_file(tmp_path: Path) -> None:
    name = saved(tmp_path / "model.zip", HFrameVecEnv(2, normalize=True))
    scores = evaluate([name, "pid"], episodes=4).scores["controllers"]
    assert set(scores) == {name, "pid"}


def test_two_models_have_two_hashes_and_count_as_learned(tmp_path: Path) -> None:
    protocol = PROTOCOLS["reach-v1"]
    names = [saved(tmp_path / f"{seed}.zip", HFrameVecEnv(2, normalize=True), seed=seed) for seed in (0, 1)]
    first, second = (make_entry(name, protocol, "reach")[0] for name in names)
    assert first.sha256 != second.sha256
    assert (first.name, first.kind, first.algorithm, first.model) == ("0", "agent", "ppo", "none")
    assert first.training_steps == 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: gym.wrappers.FlattenObservation(gym.make("HFrame-v0", machine="corexy")),
            "its bounds are others",
        ),
        (
            lambda: HFrameVecEnv(2, env_id="HFrameTrack-v0"),
            "it observes preview, which the environment lacks",
        ),
        (lambda: HFrameVecEnv(2, privileged=True), "it observes privileged, which the environment lacks"),
        (
            lambda: HFrameVecEnv(2, privileged=True, error=True),
            "it observes privileged, which the environment lacks",  # it has `error` on request
        ),
        (lambda: gym.make("Pendulum-v1"), "its actions are Box"),
        (
            lambda: gym.wrappers.FrameStackObservation(gym.make("HFrameFlat-v0"), 3),
            r"one array of shape \(3, 12\), not",
        ),
    ],
)
def test_a_model_of_other_observations_is_refused_by_what_is_missing(
    tmp_path: Path, make: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make_controller(saved(tmp_path / "model.zip", make()))


def trained(path: Path, algorithm: str, options: dict[str, Any], scaling: dict[str, Any] | None) -> str:
    """Train a model for 64 steps, with `VecNormalize` if it has keywords; save both; return its path."""
    envs: Any = HFrameVecEnv(2, **options)
    if scaling is not None:
        envs = stable_baselines3.common.vec_env.VecNormalize(envs, **scaling)
    policy = "MlpPolicy" if options.get("flat") else "MultiInputPolicy"
    few: dict[str, Any] = {"learning_starts": 10_000, "buffer_size": 100}
    if algorithm == "PPO":
        few = {"n_steps": 32, "batch_size": 32, "n_epochs": 1}
    model = getattr(stable_baselines3, algorithm)(policy, envs, seed=0, device="cpu", **few)
    model.learn(64)
    model.save(path)
    if scaling is not None:
        envs.save(path.with_name("statistics.pkl"))
    return str(path)


_UNKNOWN = pytest.warns(UserWarning, match="VecNormalize, whose statistics are not in this file")
_SCALED = pytest.raises(InputError, match="was trained on observations that were scaled")


@pytest.mark.parametrize(
    ("algorithm", "options", "scaling", "ending"),
    [
        ("PPO", {}, None, nullcontext()),
        ("SAC", {}, None, nullcontext()),
        ("PPO", {"normalize": True, "flat": True}, None, nullcontext()),
        ("SAC", {"normalize": True, "flat": True}, None, nullcontext()),
        ("PPO", {}, {"norm_obs": True}, _SCALED),
        ("SAC", {"flat": True}, {"norm_obs": True}, _SCALED),
        ("SAC", {"normalize": True}, {"norm_obs": True}, _SCALED),
        ("PPO", {"flat": True}, {"norm_obs": False}, _UNKNOWN),
        ("SAC", {}, {"norm_obs": False}, nullcontext()),
    ],
)
def test_a_model_whose_observations_were_scaled_is_not_scored_silently(
    tmp_path: Path,
    algorithm: str,
    options: dict[str, Any],
    scaling: dict[str, Any] | None,
    ending: AbstractContextManager[Any],
) -> None:
    name = trained(tmp_path / "model.zip", algorithm, options, scaling)
    with warnings.catch_warnings(), ending:
        if isinstance(ending, nullcontext):
            warnings.filterwarnings("error", ".*VecNormalize")
        make_controller(name, Scenario())


def test_the_documented_controller_applies_the_statistics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = trained(tmp_path / "model.zip", "PPO", {}, {"norm_obs": True})
    page = (Path(__file__).parents[2] / "docs" / "with_your_library.md").read_text("utf-8")
    (source,) = (
        block for block in page.split("```python\n") if '@CONTROLLERS.register("scaled-ppo")' in block
    )
    monkeypatch.chdir(tmp_path)
    exec(compile(source.partition("```")[0], "my_control.py", "exec"), {})
    scaled = make_controller("scaled-ppo", Scenario())
    plain, _ = HFrameVectorEnv(4).reset(seed=5)
    model = stable_baselines3.PPO.load(name, device="cpu")
    statistics = pickle.loads((tmp_path / "statistics.pkl").read_bytes())
    expected, _ = model.predict(statistics.normalize_obs(plain), deterministic=True)
    np.testing.assert_array_equal(scaled.act(plain), expected)


def test_other_zip_files_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("x", "y")
    (tmp_path / "text.zip").write_text("no archive")
    for name in ("other.zip", "text.zip"):
        with pytest.raises(InputError, match=f"{name}: is no model that stable-baselines3 saved"):
            make_controller(str(tmp_path / name), Scenario())
    with pytest.raises(InputError, match="it has no file named data"):
        make_controller(str(tmp_path / "other.zip"), Scenario())
    with pytest.raises(InputError, match="there is no such file"):
        make_controller(str(tmp_path / "missing.zip"))
