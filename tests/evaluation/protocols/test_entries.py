"""Tests of the entries of protocols: what identifies a controller or agent, and what it observes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.controllers import CONTROLLERS, Controller
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from hframe_gym.errors import InputError
from hframe_gym.evaluation import PROTOCOLS, Entry, Protocol, make_entry, run_protocol
from tests.evaluation.protocols.small_protocols import small

pytestmark = pytest.mark.integration


class _FirstMeasurement(Controller):
    """Zero voltage; records the width of the observation."""

    feedback = "estimated_state"
    widths: list[Any] = []  # noqa: RUF012

    def act(self, observation: Mapping[str, Any]) -> Any:
        self.widths.append(np.array(observation["observation"][0]))
        return np.zeros((len(observation["observation"]), 2))


@pytest.fixture
def _first_measurement() -> Iterator[None]:
    """Register the controller for one test; tests of all registered controllers must not find it."""
    CONTROLLERS.register("first-measurement")(_FirstMeasurement)
    yield
    CONTROLLERS.unregister("first-measurement")


@pytest.mark.usefixtures("_first_measurement")
def test_controllers_of_the_full_state_get_estimates_in_hard() -> None:
    _FirstMeasurement.widths.clear()
    protocol = dataclasses.replace(
        small("hard-v1", draws=2, duration_s=0.02), parts={"reach": PROTOCOLS["hard-v1"].parts["reach"]}
    )
    entry, _ = run_protocol(
        "first-measurement", dataclasses.replace(protocol, digest=protocol.compute_digest())
    )
    assert entry.kind == "controller"
    assert len(_FirstMeasurement.widths) == 2
    assert len(_FirstMeasurement.widths[0]) == 8  # positions and velocities of x, y and both motors


def test_a_folder_with_a_model_for_each_task_enters_hard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    for task, name in (("reach", "HFrame-v0"), ("track", "HFrameTrack-v0")):
        envs = HFrameVecEnv(1, env_id=name, normalize=True, sensors="rig")
        few = {"n_steps": 2, "batch_size": 2, "device": "cpu"}
        stable_baselines3.PPO("MultiInputPolicy", envs, **few).save(tmp_path / task)
    protocol = small("hard-v1", draws=2, duration_s=0.02)
    for part in protocol.parts:
        entry, _ = make_entry(str(tmp_path), protocol, part)
        assert (entry.name, entry.kind, entry.observes) == (tmp_path.name, "agent", "Kalman estimates")
    # What cannot run on a later part is refused before the first one is simulated.
    monkeypatch.setattr(
        "hframe_gym.evaluation.protocols.entries.rollout", lambda *_: pytest.fail("simulated")
    )
    protocol = dataclasses.replace(protocol, digest=protocol.compute_digest())
    with pytest.raises(InputError, match="does not observe preview"):
        run_protocol(str(tmp_path / "reach.zip"), protocol)


def test_agents_are_identified_by_their_files() -> None:
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("hframe_gym.agents")
    protocol = small("reach-v1")
    first, controller = make_entry("ppo", protocol, "reach")
    second, _ = make_entry("ppo-seed1", protocol, "reach")
    assert (first.name, first.kind, second.name) == ("ppo-seed0", "agent", "ppo-seed1")
    assert first.sha256 != second.sha256
    assert controller.period == protocol.period


def test_a_folder_with_the_name_of_a_controller_does_not_replace_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pid").mkdir()
    monkeypatch.chdir(tmp_path)
    entry, _ = make_entry("pid", small("reach-v1"), "reach")
    assert (entry.name, entry.kind) == ("pid", "controller")


NETWORK_SEED = [0]


class _Network(Controller):
    """A controller that holds a network, as an adapter of somebody's agent does."""

    def __init__(self, machine: Any, period: float = 0.01) -> None:
        super().__init__(machine, period)
        import torch

        torch.manual_seed(NETWORK_SEED[0])
        self.agent = {"policy": torch.nn.Linear(2, 2)}

    def act(self, observation: Mapping[str, Any]) -> Any:
        return np.zeros((len(observation["observation"]), 2))


def test_weights_of_a_controller_are_part_of_its_hash(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Two agents behind one adapter had one hash, as a controller that is not learned."""
    pytest.importorskip("torch")
    CONTROLLERS.register("network")(_Network)
    try:
        protocol = small("reach-v1")
        first, second, again = (_make_with_seed(seed, protocol) for seed in (0, 1, 0))
        assert first == again
        assert first.sha256 != second.sha256
        assert first.kind == "agent"
        (tmp_path / "weights").write_bytes(b"1")
        monkeypatch.setattr(_Network, "files", (tmp_path / "weights",))
        third = _make_with_seed(0, protocol)
        (tmp_path / "weights").write_bytes(b"2")
        assert len({first.sha256, third.sha256, _make_with_seed(0, protocol).sha256}) == 3
    finally:
        CONTROLLERS.unregister("network")


def _make_with_seed(seed: int, protocol: Protocol) -> Entry:
    """Return the entry of the network with a seed."""
    NETWORK_SEED[0] = seed
    return make_entry("network", protocol, "reach")[0]


def test_entries_state_what_they_know_and_cost() -> None:
    pytest.importorskip("stable_baselines3")
    reach, hard = small("reach-v1"), PROTOCOLS["hard-v1"]
    ppo = make_entry("ppo", reach, "reach")[0]
    assert (ppo.algorithm, ppo.observes, ppo.model, ppo.training_steps) == (
        "ppo",
        "state",
        "belt geometry",
        1503232,
    )
    plan = make_entry("apg_plan", reach, "reach")[0]
    assert (plan.model, plan.training_cpu_s) == ("feedback laws, plans, estimates parameters", 192.6)
    with pytest.warns(UserWarning, match="with other parameters"):  # the declared machine has current limits
        assert make_entry("residual", hard, "reach")[0].observes == "Kalman estimates"
    assert make_entry("pid", reach, "reach")[0].model == "feedback laws"
