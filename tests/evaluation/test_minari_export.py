"""Minari data sets: what they hold, and that the recovered environment repeats every episode to the bit."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hframe_gym
from hframe_gym.agents import shipped_agent_folder
from hframe_gym.envs import Uniform
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, export_dataset
from hframe_gym.evaluation import minari_export as module
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine, save_machine

minari = pytest.importorskip("minari", reason="needs minari: pip install '.[minari]'")
pytest.importorskip("h5py", reason="needs h5py: pip install '.[minari]'")
pytestmark = pytest.mark.integration


@pytest.fixture
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which Minari looks for data sets."""
    folder = tmp_path / "datasets"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return folder


def leaves(value: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the arrays of nested dictionaries with their paths."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, f"{prefix}/{key}")
    else:
        yield prefix, value


def assert_replays_to_the_bit(dataset: Any) -> None:
    """Repeat every episode in the recovered environment and compare everything that is stored."""
    env = dataset.recover_environment()
    metadata = dataset.storage.get_episode_metadata(dataset.episode_indices)
    for episode, about in zip(dataset, metadata, strict=True):
        observation, info = env.reset(seed=about["seed"])
        moments, steps = [(observation, info)], []
        for action in episode.actions:
            observation, *step, info = env.step(action)
            moments.append((observation, info))
            steps.append(step)
        stored = dict(leaves({"observation": episode.observations, "info": episode.infos}))
        replayed = [dict(leaves({"observation": o, "info": i})) for o, i in moments]
        assert set(stored) == set(replayed[0]) == set(replayed[-1])
        for key, values in stored.items():
            np.testing.assert_array_equal(values, np.array([moment[key] for moment in replayed]), key)
        flags = episode.rewards, episode.terminations, episode.truncations
        for values, column in zip(flags, zip(*steps, strict=True), strict=True):
            np.testing.assert_array_equal(values, column)
        assert episode.truncations[-1]
        assert not episode.truncations[:-1].any()


@pytest.mark.filterwarnings("ignore:agent ppo. trained with sensors")
def test_episodes_of_pid_and_agent_replay_to_the_bit(datasets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHUNK", 2)  # the third episode is in a chunk of another size
    scenario = Scenario(randomize="default", sensors="rig", episodes=3, seed=40, duration_s=0.5)
    for name in ("pid", "ppo"):
        written = export_dataset(name, scenario, datasets)
        assert (written.dataset_id, written.episodes, written.steps) == (f"hframe/reach/{name}-v0", 3, 150)
        dataset = minari.load_dataset(written.dataset_id)
        assert (dataset.total_episodes, dataset.total_steps) == (3, 150)
        assert [about["seed"] for about in dataset.storage.get_episode_metadata(range(3))] == [40, 41, 42]
        returns = [episode.rewards.sum() for episode in dataset]
        assert np.mean(returns) == pytest.approx(written.mean_return)
        assert_replays_to_the_bit(dataset)
    assert not list(datasets.glob(".*")), "a temporary folder is left"


def test_a_path_of_a_track_replays_to_the_bit(datasets: Path) -> None:
    written = export_dataset(
        "pid", Scenario(task="track", randomize="wide", episodes=2, duration_s=0.3), datasets
    )
    dataset = minari.load_dataset("hframe/track/pid-v0")
    assert written.folder == datasets / "hframe" / "track" / "pid-v0"
    assert dataset.env_spec.id == "HFrameTrack-v0"
    assert "contour_m" in dataset[0].infos
    assert_replays_to_the_bit(dataset)


def test_the_drives_of_a_scenario_travel_with_the_data_set(datasets: Path) -> None:
    scenario = Scenario(randomize="none", drives="rig", episodes=1, duration_s=0.1)
    export_dataset("pid", scenario, datasets)
    dataset = minari.load_dataset("hframe/reach/pid-v0")
    assert_replays_to_the_bit(dataset)
    assert dataset.env_spec.kwargs["drives"] == dataset.storage.metadata["hframe"]["drives"] == "rig"
    export_dataset("pid", dataclasses.replace(scenario, drives="ideal"), datasets / "ideal")
    ideal = minari.MinariDataset(datasets / "ideal" / "hframe" / "reach" / "pid-v0" / "data")
    assert not np.array_equal(ideal[0].rewards, dataset[0].rewards)


@pytest.mark.parametrize("flat", [False, True])
def test_normalized_and_flat_observations_replay_to_the_bit(flat: bool, datasets: Path) -> None:
    scenario = Scenario(randomize="none", sensors="rig", episodes=2, duration_s=0.3)
    export_dataset("pid", scenario, datasets / "si")
    export_dataset("pid", scenario, datasets, normalize=True, flat=flat)
    dataset = minari.load_dataset("hframe/reach/pid-v0")
    assert isinstance(dataset[0].observations, np.ndarray) == flat
    assert_replays_to_the_bit(dataset)
    in_si = minari.MinariDataset(datasets / "si" / "hframe" / "reach" / "pid-v0" / "data")
    np.testing.assert_array_equal(dataset[1].actions, in_si[1].actions)


def test_the_machine_of_a_file_travels_with_the_data_set(
    datasets: Path, tmp_path: Path, hframe: Machine
) -> None:
    file = tmp_path / "mine.json"
    mine = hframe.replace({"x.mass": 5.0}, name="my stage")
    save_machine(mine, file)
    scenario = Scenario(file, randomize="none", episodes=2, period=0.005, duration_s=0.1)
    written = export_dataset("pid", scenario, datasets, author="A. Person")
    file.unlink()
    assert written.dataset_id == "my-stage/reach/pid-v0"
    dataset = minari.load_dataset(written.dataset_id)
    assert_replays_to_the_bit(dataset)
    recovered = dataset.recover_environment().unwrapped
    assert recovered.batch.machine.parameters["x.mass"] == 5.0
    assert recovered.batch.config.period == 0.005
    moved = dataset.recover_environment(machine=str(written.folder / "machine.json"))
    assert moved.unwrapped.batch.machine.name == "my stage"


def test_metadata_name_algorithm_machine_seed_and_version(datasets: Path) -> None:
    folder = shipped_agent_folder("ppo", "reach")
    export_dataset(str(folder), Scenario(randomize="none", episodes=1, seed=7, duration_s=0.02), datasets)
    dataset = minari.load_dataset(f"hframe/reach/{folder.name}-v0")
    metadata = dataset.storage.metadata
    assert metadata["algorithm_name"] == "ppo_reach, seed 0"
    assert metadata["requirements"] == [f"hframe_gym=={hframe_gym.__version__}"]
    assert "hframe export" in metadata["description"]
    about = metadata["hframe"]
    assert (about["version"], about["seed"], about["controller_class"]) == (
        hframe_gym.__version__,
        7,
        "Agent",
    )
    assert about["agent"] == json.loads((folder / "agent.json").read_text("utf-8"))
    file = datasets / "declared.json"
    file.write_text(json.dumps(about["machine"]))
    assert load_machine(file).parameters == load_machine("hframe").parameters


@pytest.mark.parametrize(
    ("name", "options", "part"),
    [
        ("pidd", {}, "controller 'pidd' is unknown"),
        ("pid", {"task": "track", "period": 0.002}, "export this task at a period of 0.01 s"),
        ("pid", {"randomize": "some"}, "some"),
        ("textbook-pid", {"sensors": "rig"}, "needs the full state"),
        (
            "pid",
            {"randomize": [hframe_gym.envs.RandomizeParameter("x.mass", Uniform(0.9, 1.1))]},
            "can only state the name of a preset",
        ),
    ],
)
def test_what_cannot_be_exported_is_refused_and_nothing_is_written(
    name: str, options: dict[str, Any], part: str, datasets: Path
) -> None:
    with pytest.raises(InputError, match=part):
        export_dataset(
            name, Scenario(episodes=1, duration_s=0.1, **{"randomize": "none", **options}), datasets
        )
    assert not datasets.exists() or not list(datasets.iterdir())


def test_reference_scores_normalize_returns(datasets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REFERENCE_EPISODES", 8)  # an eighth: each export simulates them
    scenario = Scenario(randomize="none", episodes=4, seed=3)
    for name in ("random", "textbook-pid", "predictive"):
        export_dataset(name, scenario, datasets, reference=True)
    sets = [
        minari.load_dataset(f"hframe/reach/{name}-v0") for name in ("random", "textbook-pid", "predictive")
    ]
    assert len({dataset.storage.metadata["ref_min_score"] for dataset in sets}) == 1
    scores = [
        float(np.mean(minari.get_normalized_score(dataset, np.array([e.rewards.sum() for e in dataset]))))
        for dataset in sets
    ]
    assert scores[0] == pytest.approx(0.0, abs=0.1)
    assert scores[2] == pytest.approx(1.0, abs=0.1)
    assert scores[0] + 0.1 < scores[1] < scores[2]
    assert_replays_to_the_bit(sets[0])


def test_a_data_set_is_not_replaced(datasets: Path) -> None:
    scenario = Scenario(randomize="none", episodes=1, duration_s=0.02)
    written = export_dataset("pid", scenario, datasets)
    before = (written.folder / "data" / "main_data.hdf5").read_bytes()
    with pytest.raises(InputError, match="exists already; delete it or choose another --out"):
        export_dataset("pid", scenario, datasets)
    assert (written.folder / "data" / "main_data.hdf5").read_bytes() == before


def test_the_command_names_the_data_sets_and_the_extra(
    tmp_path: Path, hframe_command: Callable[..., tuple[int, str, str]]
) -> None:
    code, out, errors = hframe_command("export", "pid", "--episodes", "2", "--out", tmp_path / "out")
    assert code == 0, errors
    assert (tmp_path / "out" / "hframe" / "reach" / "pid-v0" / "data" / "metadata.json").is_file()
    assert "wrote hframe/reach/pid-v0: 2 episodes, 300 steps" in out
    hide = "import sys; sys.modules['h5py'] = None; from hframe_gym.cli import main; main()"
    missing = [
        sys.executable,
        "-c",
        hide,
        "export",
        "pid",
        "--episodes",
        "2",
        "--out",
        str(tmp_path / "none"),
    ]
    done = subprocess.run(missing, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.strip() == "hframe: data sets need minari and h5py: pip install 'hframe_gym[minari]'"
    assert not (tmp_path / "none").exists()
