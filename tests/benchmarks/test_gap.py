"""Test the protocol `gap-v1`: plants, recordings, control on a plant, entries, and result files."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.gap import __main__ as gap_command
from benchmarks.gap import bounds, machines, protocol, results
from benchmarks.gap.__main__ import run
from benchmarks.gap.catalog import TRAINED, entry_names, get_entry
from benchmarks.gap.control_loop import (
    CLOCK_S,
    DURATION_S,
    RESTING_S,
    GapEpisodes,
    Starts,
    control,
    starts_of,
)
from benchmarks.gap.entries import GapEntry, continued, posterior_covariance
from benchmarks.gap.plants import COUNT, PUBLIC_SEED, GapPlant, declared_machine, draw_plant
from benchmarks.gap.recorder import CHOSEN_S, Recorder, standard_session
from benchmarks.gap.saved_policies import MeasuredRates
from benchmarks.gap.summary import RESULTS, overview, read_all, summarize, trained_against_corrected
from hframe_gym.agents import load_recipe, shipped_agent_folder
from hframe_gym.controllers import Controller, OutputFeedbackController, StateEstimator
from hframe_gym.envs import Reach, Track, observed_machine
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from hframe_gym.errors import InputError
from hframe_gym.machine import Machine, Uncertainty
from hframe_gym.recordings import save_machine
from tests.reference_simulator import Array, Rig, simulate
from tests.rigs.random_effects import draw_effect
from tests.rigs.random_rigs import Residue
from tools.tables.gap import gap_scored_by, plants_table

REACH = Reach()
CIRCLE = Track(path="circle", size=0.05, speed=0.3)
IDEAL = GapPlant(1, 0, (), Residue())


class Constant(Controller):
    """Controller that always commands the same, and remembers what it observes."""

    def __init__(self, action: tuple[float, float]) -> None:
        super().__init__(declared_machine(), 0.01)
        self.action, self.seen = action, []

    def act(self, observation: Any) -> Array:
        self.seen.append({key: np.array(value) for key, value in observation.items()})
        return np.tile(self.action, (len(observation["observation"]), 1))

    def reset(self, mask: Any = None) -> None:
        self.seen.clear()


class Still(GapEntry):
    """Entry that does nothing."""

    name = "still"

    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        self.machine = declared

    def controller(self, task: Any) -> Controller:
        return Constant((0.0, 0.0))


@pytest.fixture(autouse=True)
def _few_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocol, "EPISODES", {"reach": 3, "circle": 1, "square": 1})
    monkeypatch.setattr(results, "EPISODES", {"reach": 3, "circle": 1, "square": 1})
    monkeypatch.setattr(protocol, "check", lambda: None)
    monkeypatch.setattr(results, "stored_bounds", lambda seed: {})


def test_published_plants_are_those_of_the_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    protocol.check()
    monkeypatch.setattr(protocol, "PRACTICE_EPISODES", 9)
    with pytest.raises(InputError, match="other plants or episodes"):
        protocol.check()


@pytest.mark.parametrize(("bow", "same"), [(0.0, True), (5.0, False)])
def test_a_newer_field_of_a_rig_counts_only_where_it_changes_the_plant(bow: float, same: bool) -> None:
    """An effect that the simulator gets later leaves the digest as it is."""
    newer = dataclasses.make_dataclass("Rig", [("friction_bow", float, 0.0)], bases=(Rig,), frozen=True)
    text = protocol.as_text(Rig(coulomb=(1.0, 2.0, 3.0, 4.0)))
    assert (protocol.as_text(newer(coulomb=(1.0, 2.0, 3.0, 4.0), friction_bow=bow)) == text) == same


def test_plants_hide_zero_to_three_effects_and_every_second_of_each_number_a_residue() -> None:
    plants = [draw_plant(PUBLIC_SEED, index) for index in range(COUNT)]
    assert [len(plant.effects) for plant in plants] == [0, 1, 2, 3] * 6
    with_residue = [bool(plant.residue.kind) for plant in plants]
    assert [sum(with_residue[count::4]) for count in range(4)] == [3, 3, 3, 3]
    outside = sum(not getattr(effect, "in_library", False) for plant in plants for effect in plant.effects)
    assert 6 <= outside <= 24
    declared = Rig()
    for plant in plants:
        rig = plant.stage[0]
        changes = np.abs(np.array(rig.mass) / np.array(declared.mass) - 1.0)
        assert ((changes > 0.049) & (changes < 0.201)).all()
        assert max(rig.current_limit_A) <= 12.0
        stage = plant.at_rest((0.1, -0.05), 0.0)
        stage.step((4.0, -3.0), 0.02)
        assert np.isfinite(stage.position).all()


def test_a_plant_follows_from_its_seed_and_index() -> None:
    first = draw_plant(PUBLIC_SEED, 7)
    again = draw_plant(PUBLIC_SEED, 7)
    other = draw_plant(PUBLIC_SEED + 1, 7)
    assert first.describe() == again.describe()
    assert first.stage == again.stage
    assert first.stage != other.stage


def test_recordings_are_those_of_the_plant_and_repeat() -> None:
    one, two = (Recorder(IDEAL).excite("steps") for _ in range(2))
    np.testing.assert_array_equal(one.outputs, two.outputs)
    rest = one.outputs[:50].mean(axis=0)
    radius = Rig().pulley_radius_m
    np.testing.assert_allclose(rest[:2] * radius, [-rest[2] - rest[3], rest[2] - rest[3]], atol=2e-4)


def test_the_budget_is_kept() -> None:
    recorder = Recorder(IDEAL)
    assert len(standard_session(recorder)) * 2.0 == CHOSEN_S
    with pytest.raises(InputError, match="exceeds the budget, of which 0 s are left"):
        recorder.excite("steps")
    with pytest.raises(InputError, match="not for both"):
        recorder.logs()
    with pytest.raises(InputError, match="gets no recordings"):
        Recorder(IDEAL, allowed=False).excite("steps")
    with pytest.raises(InputError, match="'wiggle'"):
        Recorder(IDEAL).excite("wiggle")


def test_own_excitation_sees_measurements_and_is_limited() -> None:
    seen: list[Array] = []

    def excitation(time_s: float, measured: Array) -> Array:
        seen.append(measured)
        return np.array([20.0, 1.0])

    recorder = Recorder(IDEAL)
    run_of_mine = recorder.record(excitation, (0.1, 0.05), 0.25)
    assert recorder.left_s == pytest.approx(CHOSEN_S - 0.25)
    assert np.all(run_of_mine.inputs[:99] == 0.0)
    assert np.all(run_of_mine.inputs[101:] == [8.0, 1.0])
    np.testing.assert_allclose(seen[0][2:], [0.1, 0.05], atol=2e-4)
    with pytest.raises(InputError, match="two finite voltages"):
        recorder.record(lambda time_s, measured: np.array([np.nan, 0.0]), (0.0, 0.0), 0.3)


def test_logs_are_sixty_seconds_of_closed_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.gap.recorder.LOGS_S", 4.0)
    recorder = Recorder(IDEAL)
    logs = recorder.logs()
    assert [len(run.time_s) for run in logs] == [2000, 2000]
    assert recorder.logs() is logs
    assert logs[1].time_s[0] > logs[0].time_s[-1] + 2.9
    with pytest.raises(InputError, match="budget"):
        recorder.excite("steps")


def test_control_moves_the_plant_as_the_simulator_does() -> None:
    controller = Constant((0.1234567, -0.05))
    starts = Starts(np.array([[0.05, -0.03], [0.0, 0.0]]), np.array([[0.1, 0.0], [0.0, 0.1]]))
    episodes = control(controller, IDEAL, REACH, starts, 3)
    step = 24.0 / 4096
    volts = np.round(np.array([0.1234567, -0.05]) * 12.0 / step) * step
    time_s = np.concatenate([[-RESTING_S], episodes.time_s]) + CLOCK_S
    inputs = np.vstack([np.zeros(2), np.tile(volts, (len(time_s) - 1, 1))])
    positions, _ = simulate(IDEAL.stage[0], time_s, inputs, (0.05, -0.03))
    np.testing.assert_allclose(episodes.position[0], positions[1:, :2], atol=1e-7)
    assert episodes.goal[0, 0].tolist() == [0.1, 0.0]
    measured = controller.seen[5]["observation"][0]
    exact = positions[51]
    np.testing.assert_allclose(measured[:2], exact[:2], atol=1e-4)
    np.testing.assert_allclose(measured[2:], exact[2:], atol=5.3e-4)
    rig, q = IDEAL.stage[0], positions
    stretch = q[:, 0] + q[:, 1] + rig.pulley_radius_m * q[:, 2]
    left = rig.belt_EA_N[0] / (rig.belt_length_m[0] + q[:, 0] + q[:, 1]) * stretch
    assert episodes.belt_force_N[0] >= np.abs(left[1:]).max() - 1e-3


def test_a_delayed_laser_measures_the_past() -> None:
    plant = GapPlant(1, 0, (), Residue())
    rig, sensors = plant.stage
    plant.__dict__["stage"] = rig, dataclasses.replace(sensors, delay_s=(0.0, 0.0, 1e-3, 0.0))
    starts = Starts(np.zeros((1, 2)), np.array([[0.1, 0.0]]))
    controller = Constant((-0.5, 0.5))
    episodes = control(controller, plant, REACH, starts, 3)
    late = np.array([seen["observation"][0, 0] for seen in controller.seen])[5:30]
    exact = episodes.position[0, 49:299:10, 0]
    assert np.abs(late - exact).max() < 1e-4
    assert np.abs(late - episodes.position[0, 50:300:10, 0]).max() > 2e-4


def _episodes(error: Array, actions: Array, left: float = 0.0, contour: Array | None = None) -> GapEpisodes:
    """Return episodes with given distances to the goal (B, n), m, and actions (B, m, 2)."""
    position = np.stack([error + left, np.zeros_like(error)], axis=2)
    goal = np.stack([np.full_like(error, left), np.zeros_like(error)], axis=2)
    time_s = np.linspace(0.0, DURATION_S, error.shape[1])
    observed = np.zeros((*actions.shape[:2], 4))
    return GapEpisodes(time_s, position, goal, contour, actions, observed, np.array([5.0] * len(error)))


def test_metrics_of_episodes() -> None:
    error = np.full((2, 1501), 0.01)
    error[0, 300:] = 1e-4
    actions = np.zeros((2, 150, 2))
    actions[1, :75] = 1.0
    values = protocol.episode_values(_episodes(error, actions))
    assert values["settling_s.0.2mm"] == [0.3, None]
    assert values["settling_s.0.05mm"] == [None, None]
    assert values["saturated"] == [0.0, 0.5]
    assert values["left_workspace"] == [0.0, 0.0]
    assert values["final_error_mm"] == [0.1, 10.0]
    beyond = protocol.episode_values(_episodes(error, actions, left=0.275))
    assert beyond["left_workspace"] == [1.0, 1.0]
    path = protocol.episode_values(_episodes(error, actions, contour=np.full_like(error, 2e-3)))
    assert path["path_rms_mm"] == [2.0, 2.0]
    error[1, 700] = 0.03  # does not follow the goal: resting on the path is no success
    path = protocol.episode_values(_episodes(error, actions, contour=np.full_like(error, 2e-3)))
    assert path["path_rms_mm"][0] == 2.0
    assert path["path_rms_mm"][1] == pytest.approx(1e3 * np.sqrt(np.mean(error[1] ** 2)), abs=1e-6)
    assert path["lag_max_mm"] == [10.0, 30.0]


def test_practice_shows_no_true_positions() -> None:
    starts = Starts(np.zeros((1, 2)), np.array([[0.1, 0.0]]))
    episodes = control(Constant((0.1, 0.1)), IDEAL, REACH, starts, 3)
    shown = protocol.as_measured(episodes)
    assert shown.position.shape == (1, 150, 2)
    assert np.isnan(shown.belt_force_N).all()
    assert shown.contour is None
    np.testing.assert_array_equal(shown.position, episodes.observed[:, :, :2])


def test_names_of_entries() -> None:
    assert {
        "pid",
        "predictive-corrected",
        "adaptive-pid-online",
        "ppo",
        "apg_mix-corrected",
        "apg_mix-trained",
    } <= set(entry_names())
    assert get_entry("pid-refitted").track == "identified"
    assert get_entry("predictive-online").track == "online"
    assert get_entry("ppo_mix-corrected").name == "ppo_mix-seed0-corrected"
    second = get_entry("ppo_mix-seed1-online")
    assert (second.track, second.learned, get_entry("pid").learned) == ("online", True, False)
    assert {file.parent.name for file in second.files()} == {"ppo_mix-seed1", "residual-seed1"}
    with pytest.raises(InputError, match="hframe train ppo_mix --task reach --seed 99"):
        get_entry("ppo_mix-seed99").files()
    assert get_entry(f"{__name__}:Still") is Still
    with pytest.raises(InputError, match="GapEntry' lacks the method controller and prepare"):
        get_entry("benchmarks.gap.entries:GapEntry")
    for name in ("nothing", "no.such.module:Class", f"{__name__}:Constant", "pid-best", "pid-seed1"):
        with pytest.raises(InputError, match="entry"):
            get_entry(name)


def test_the_hash_of_an_entry_covers_its_name_and_source() -> None:
    hashes = {
        results.sha256_of(get_entry(name)) for name in ("pid", "pid-refitted", "pid-corrected", "predictive")
    }
    assert len(hashes) == 4


def test_posterior_of_the_parameters() -> None:
    machine = declared_machine()
    assert posterior_covariance(machine) is None
    names = ("x.mass", "y.mass", "phi1.coulomb")
    values = np.array([machine.parameters[name] for name in names])
    relative = np.array([[1e-3, 5e-4, 0.0], [5e-4, 2e-3, 0.0], [0.0, 0.0, 9.0]])
    known = machine.replace(uncertainty=Uncertainty(names, relative * np.outer(values, values)))
    covariance = posterior_covariance(known)
    assert covariance is not None
    observed = observed_machine(known, "machine")
    assert observed is not None
    of = StateEstimator(observed, 0.01).augmented.names
    rows = [of.index(name) for name in names[:2]]
    np.testing.assert_allclose(
        covariance[np.ix_(rows, rows)], relative[:2, :2] + 4e-4 * np.eye(2), atol=1e-12
    )
    worst = of.index("phi1.coulomb")  # hardly identified: no worse than declared, a standard deviation of 0.4
    assert covariance[worst, worst] == pytest.approx(0.4**2)
    assert covariance[of.index("motor1.Kt"), of.index("motor1.Kt")] == pytest.approx(4e-4)
    with pytest.raises(InputError, match="parameter_covariance"):
        StateEstimator(observed, 0.01, np.eye(2))


@pytest.mark.integration
def test_practice_moves_the_model_towards_the_plant() -> None:
    entry = get_entry("pid-online")()
    entry.prepare(declared_machine(), Recorder(IDEAL, allowed=False), Path())
    before = entry.machine.parameters  # type: ignore[attr-defined]
    drawn = starts_of(REACH, 5, 4)
    for k in range(4):
        controller = entry.controller(REACH)
        one = Starts(drawn.start[k : k + 1], drawn.plan[k : k + 1])
        entry.practice(protocol.as_measured(control(controller, IDEAL, REACH, one, k)), controller)
    after, rig = entry.machine.parameters, IDEAL.stage[0]  # type: ignore[attr-defined]
    gain = [v.torque_constant[0] / v.resistance_ohm[0] for v in (Rig(), rig)]
    errors = []
    for values in (before, after):
        ratios = [rig.belt_EA_N[i] / values[f"{b}.EA"] for i, b in enumerate(("left", "right", "bottom"))]
        kt = values["motor1.Kt"] / values["motor1.resistance"]
        errors.append(np.abs(np.log(np.array([*ratios, gain[1] / kt]) * kt / gain[1])).sum())
    assert errors[1] < errors[0]


def test_run_continues_and_keeps_the_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"{__name__}:Still"
    commits = iter(["5f2c8c82", "5f2c8c82-dirty"])
    monkeypatch.setattr(results, "commit", lambda: next(commits))
    path = run(name, PUBLIC_SEED, [0], tmp_path, tmp_path / "cache")
    first = results.read(path)
    assert [row["plant"] for row in first["plants"]] == [0]
    assert first["plants"][0]["values"]["reach"]["settling_s.0.2mm"] == [None] * 3
    again = results.read(run(name, PUBLIC_SEED, [0, 1], tmp_path, tmp_path / "cache"))
    assert again["plants"][0] == first["plants"][0]
    assert [row["plant"] for row in again["plants"]] == [0, 1]
    assert [row["commit"] for row in again["plants"]] == ["5f2c8c82", "5f2c8c82-dirty"]
    assert "still" in overview(read_all(tmp_path))


def test_a_run_replaces_only_what_it_scores_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of other plants stay when the source of the entry changes, and say what scored them."""
    name, code = f"{__name__}:Still", {"sha256": "old", "commit": None}
    monkeypatch.setattr(results, "commit", lambda: code["commit"])
    monkeypatch.setattr(results, "sha256_of", lambda entry: code["sha256"])
    path = run(name, PUBLIC_SEED, [0, 1, 2], tmp_path, tmp_path / "cache")
    first = results.read(path)
    results.write(path, {**first, "versions": {"hframe_gym": "0.2.0"}})

    def scored_by() -> list[tuple[object, ...]]:
        rows = results.read(path)["plants"]
        return [(row["plant"], row["commit"], row.get("version"), row.get("sha256")) for row in rows]

    code.update(sha256="new", commit="83a03865")
    run(name, PUBLIC_SEED, [1], tmp_path, tmp_path / "cache")
    assert results.read(path)["entry"]["sha256"] == "new"
    assert scored_by() == [
        (0, None, "0.2.0", "old"),
        (1, "83a03865", None, None),
        (2, None, "0.2.0", "old"),
    ]
    summary = summarize(read_all(tmp_path))
    assert [(row["code"], row["plants"]) for row in summary["scored_by"]] == [
        ("83a03865", [1]),
        ("version 0.2.0", [0, 2]),
    ]

    code.update(commit="f395f0af")
    run(name, PUBLIC_SEED, [0, 1], tmp_path, tmp_path / "cache")  # continues: plant 1 has the present source
    assert [row[1] for row in scored_by()] == ["f395f0af", "83a03865", None]
    run(name, PUBLIC_SEED, [0, 1], tmp_path, tmp_path / "cache", again=True)
    assert [row[1] for row in scored_by()] == ["f395f0af", "f395f0af", None]
    with pytest.raises(InputError, match="plants of seed 47000; name another folder"):
        run(name, PUBLIC_SEED + 1, [0], tmp_path, tmp_path / "cache")


class Choosy(Still):
    """Entry that refuses the second plant."""

    name = "choosy"

    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        if folder.name.endswith("_01"):
            raise InputError("no controller for this plant")
        super().prepare(declared, recorder, folder)


def test_a_refused_plant_has_a_row_with_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "commit", lambda: "5f2c8c82")
    path = run(f"{__name__}:Choosy", PUBLIC_SEED, [0, 1, 2], tmp_path, tmp_path / "cache")
    run(f"{__name__}:Still", PUBLIC_SEED, [1], tmp_path, tmp_path / "cache")
    refused = {"plant": 1, "refused": "no controller for this plant", "commit": "5f2c8c82"}
    assert results.read(path)["plants"][1] == refused
    summary = summarize(read_all(tmp_path))
    assert summary["entries"]["choosy"]["plants"] == 2
    assert summary["refused"] == [{"entry": "choosy", "plant": 1, "reason": "no controller for this plant"}]
    cells = plants_table(summary, ("choosy", "still")).splitlines()[3].split(" | ")
    assert cells[2:] == ["refused", "1.500 |"]
    monkeypatch.setattr(Choosy, "prepare", Still.prepare)
    run(
        f"{__name__}:Choosy", PUBLIC_SEED, [1], tmp_path, tmp_path / "cache"
    )  # a refused plant is tried again
    assert "values" in results.read(path)["plants"][1]


def test_only_refused_plants_give_no_scores(tmp_path: Path) -> None:
    run(f"{__name__}:Choosy", PUBLIC_SEED, [1], tmp_path, tmp_path / "cache")
    assert summarize(read_all(tmp_path))["entries"] == {}
    assert "choosy" not in overview(read_all(tmp_path))


def test_each_set_of_plants_has_its_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The table of a held set leaves that of the published plants as it is."""
    written: list[str] = []
    monkeypatch.setattr(gap_command, "write_results", lambda name, content, seed: written.append(name))
    monkeypatch.setattr(gap_command, "RESULTS", tmp_path)
    run(f"{__name__}:Still", PUBLIC_SEED, [0], tmp_path, tmp_path / "cache")
    run(f"{__name__}:Still", 48000, [0], tmp_path / "48000", tmp_path / "cache")
    for arguments in (["table"], ["table", "--seed", "48000"]):
        monkeypatch.setattr("sys.argv", ["gap", *arguments])
        gap_command.main()
    assert written == ["gap", "gap_48000"]
    monkeypatch.setattr("sys.argv", ["gap", "table", "--out", str(tmp_path / "48000")])
    with pytest.raises(SystemExit, match="plants of seed 48000, not 47000"):
        gap_command.main()


def test_equal_models_are_scored_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = declared_machine()
    heavier = machine.replace({"x.mass": 5.0})
    found = [
        machines.Identified(machine, corrected, "no_effect", (), 1.0, 0.0, ())
        for corrected in (machine, heavier)
    ]
    runs = []

    def fake_control(*arguments: Any) -> GapEpisodes:
        runs.append(arguments)
        arguments[0].actions += 1
        error = np.full((1, 1501), 1e-5)
        return _episodes(error, np.zeros((1, 150, 2)))

    monkeypatch.setattr(protocol, "control", fake_control)
    monkeypatch.setattr(protocol, "EPISODES", {"reach": 1, "circle": 1, "square": 1})
    monkeypatch.setattr(results, "EPISODES", {"reach": 1, "circle": 1, "square": 1})
    monkeypatch.setattr("benchmarks.gap.entries.standard_session", lambda recorder: ())
    monkeypatch.setattr("benchmarks.gap.entries.identified", lambda *arguments: found[len(runs) >= 6])
    monkeypatch.setattr("benchmarks.gap.entries.encoders_drift", lambda *arguments: len(runs) >= 9)
    rows = []
    for name in ("pid-refitted", "pid-corrected", "predictive-refitted", *["predictive-corrected"] * 2):
        known = {(row["plant"], row["key"]): row for row in rows}
        rows.append(protocol.score(get_entry(name)(), IDEAL, tmp_path, known))
    assert len(runs) == 12
    assert rows[0]["key"] == rows[1]["key"]
    assert len({row["key"] for row in rows}) == 4
    assert [row["about"]["drifting_encoders"] for row in rows] == [False] * 4 + [True]


class Rates(Controller):
    """Controller that remembers what it observes, and of which machines it forgot."""

    def act(self, observation: Any) -> Array:
        self.seen = observation["observation"]
        return np.zeros((len(self.seen), 2))

    def reset(self, mask: Any = None) -> None:
        self.forgot = mask


def test_measured_rates_are_differences_within_an_episode() -> None:
    inner = Rates(declared_machine(), 0.01)
    controller = MeasuredRates(inner)
    for k, expected in enumerate([0.0, 1.0]):
        controller.act({"observation": np.full((2, 4), 0.01 * k)})
        np.testing.assert_allclose(
            inner.seen, np.hstack([np.full((2, 4), 0.01 * k), np.full((2, 4), expected)])
        )
    controller.reset(np.array([True, False]))
    assert inner.forgot.tolist() == [True, False]
    controller.act({"observation": np.full((2, 4), 0.03)})
    np.testing.assert_allclose(inner.seen[:, 4:], [[0.0] * 4, [2.0] * 4], rtol=1e-5)


@pytest.mark.parametrize("suffix", ["", "@machine"])
def test_saved_policies_control_moves_and_paths(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    monkeypatch.chdir(tmp_path)
    sensors = "machine" if suffix else "state"
    for name, task in (("moves", "HFrame-v0"), ("paths", "HFrameTrack-v0")):
        envs = HFrameVecEnv(1, env_id=task, normalize=True, sensors=sensors)
        few = {"n_steps": 2, "batch_size": 2, "device": "cpu"}
        stable_baselines3.PPO("MultiInputPolicy", envs, **few).save(name)
    make = get_entry(f"moves.zip+paths.zip{suffix}")
    assert (make.name, make.track, make.learned) == ("moves+paths", "zero-shot", True)
    before = results.sha256_of(make)
    entry = make()
    entry.prepare(declared_machine(), Recorder(IDEAL, allowed=False), tmp_path)
    observation = {key: np.zeros((2, 2)) for key in ("achieved_goal", "desired_goal")}
    for task_object, preview in ((REACH, {}), (CIRCLE, {"preview": np.zeros((2, 20))})):
        controller = entry.controller(task_object)
        assert isinstance(controller, MeasuredRates if suffix else OutputFeedbackController)
        if suffix:
            assert controller.act({**observation, "observation": np.zeros((2, 4)), **preview}).shape == (2, 2)
    (tmp_path / "paths.zip").write_bytes((tmp_path / "moves.zip").read_bytes())
    assert results.sha256_of(make) != before
    with pytest.raises(InputError, match="does not observe preview"):
        entry.controller(CIRCLE)


def test_a_pair_of_policies_that_is_incomplete_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"one for paths, REACH\+TRACK"):
        get_entry("moves.zip")
    with pytest.raises(InputError, match=r"paths\.zip: there is no such file or folder"):
        get_entry(f"{tmp_path}+paths.zip")
    with pytest.raises(InputError, match=r"agent\.json is missing"):
        get_entry(f"{tmp_path}+{tmp_path}").files()
    for task, recipe in (("reach", "ppo"), ("track", "residual")):
        shutil.copytree(shipped_agent_folder(recipe, task), tmp_path / task)
    complete = get_entry(str(tmp_path))
    assert (complete.name, len(complete.files())) == (tmp_path.name, 6)


def test_edited_and_impossible_results_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = run(f"{__name__}:Still", PUBLIC_SEED, [0], tmp_path, tmp_path / "cache")
    content = json.loads(path.read_text())
    content["plants"][0]["values"]["reach"]["settling_s.0.2mm"] = [0.2, 0.2, 0.2]
    edited = tmp_path / "edited.json"
    edited.write_text(json.dumps(content))
    with pytest.raises(InputError, match="checksum does not fit"):
        results.read(edited)
    monkeypatch.setattr(results, "stored_bounds", lambda seed: {0: np.array([0.1, 0.3, np.nan])})
    results.write(edited, content)
    with pytest.raises(
        InputError, match=r"move 1 takes 0\.2 s, less than the shortest possible time, 0\.3000 s"
    ):
        results.read(edited)
    results.write(edited, {**content, "digest": "0" * 16})
    with pytest.raises(InputError, match="other plants or episodes"):
        results.read(edited)
    edited.write_text("[]")
    with pytest.raises(InputError, match="no result file"):
        results.read(edited)


def _content(name: str, times: list[list[float]], learned: bool = False) -> dict[str, Any]:
    """Return a result with given settling times per plant."""
    rows = []
    for index, column in enumerate(times):
        safety = {"belt_force_N": [1.0], "saturated": [0.0], "left_workspace": [0.0]}
        paths = {part: {"path_rms_mm": [0.1], **safety} for part in ("circle", "square")}
        values = {"reach": {results.SETTLED: column, **safety}, **paths}
        rows.append({"plant": index, "values": values, "prepare_cpu_s": 0.0, "control_us": 1.0, "about": {}})
    entry = {"name": name, "track": "zero-shot", "knowledge": "", "learned": learned, "sha256": ""}
    return {"seed": PUBLIC_SEED, "entry": entry, "versions": {"hframe_gym": "0"}, "plants": rows}


def test_comparison_is_paired_by_plant_and_move(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "stored_bounds", lambda seed: {0: np.array([0.2, 0.2, np.nan])})
    base = _content("pid", [[0.4, 0.5, 0.6], [0.4, 0.5, 0.6], [0.4, 0.5, 0.6]])
    other = _content("pid-corrected", [[0.3, 0.4, 0.5], [0.3, 0.6, 0.5], [0.5, 0.6, 0.7]])
    found = results.compare([other], [base], "reach")
    assert found[:4] == (2, 1, 1, 1)
    assert found.plants == 3
    assert found.ratio[0] == pytest.approx(np.mean([0.8, 1.4 / 1.5, 1.2]))
    scores = results.plant_scores(base)
    assert scores[0].over_bound == pytest.approx(0.45 / 0.2)
    summary = summarize({"pid": base, "pid-corrected": other})
    assert summary["steps"]["pid-corrected"]["reach"]["better"] == 2
    assert summary["learned"] == {}


def test_seeds_of_an_agent_are_one_entry() -> None:
    base = _content("pid", [[0.4, 0.5], [0.4, 0.5], [0.6, 0.7]])
    seeds = [
        _content(f"apg_mix-seed{seed}", [[0.3 + change, 0.4 - change]] * 2, learned=True)
        for seed, change in enumerate((-0.05, 0.15))
    ]
    summary = summarize({content["entry"]["name"]: content for content in (base, *seeds)})
    entry = summary["entries"]["apg_mix"]
    assert (entry["seeds"], entry["plants"]) == (2, 2)
    assert entry["settling_s"][0] == pytest.approx(0.35)
    best = summary["learned"]["zero-shot"]["reach"]
    assert (best["learned"], best["other"], best["plants"]) == ("apg_mix", "pid", 2)
    assert best["better"] == best["clearly_better"] == 2
    assert best["ratio"][0] == pytest.approx(0.35 / 0.45)


def test_the_summary_says_which_code_scored_which_plants() -> None:
    contents = {name: _content(name, [[0.4]] * 3) for name in ("ppo_mix-seed0", "ppo_mix-seed1", "pid")}
    for name, content in contents.items():
        for row in content["plants"][1:]:
            row["commit"] = "5f2c8c82" if name != "pid" else "83a03865"
    summary = summarize(contents)
    old = f"version {contents['pid']['versions']['hframe_gym']}"
    assert summary["scored_by"] == [
        {"code": "5f2c8c82", "plants": [1, 2], "entries": ["ppo_mix-seed0", "ppo_mix-seed1"]},
        {"code": "83a03865", "plants": [1, 2], "entries": ["pid"]},
        {"code": old, "plants": [0], "entries": ["pid", "ppo_mix-seed0", "ppo_mix-seed1"]},
    ]
    lines = gap_scored_by(summary).splitlines()
    assert lines[2] == "| 5f2c8c82 | `ppo_mix` (seeds 0, 1) | 1, 2 |"
    assert lines[4] == f"| {old} | `pid`, `ppo_mix` (seeds 0, 1) | 0 |"


def test_a_model_is_compared_with_the_declared_one_by_seed() -> None:
    declared = [_content(f"ppo_mix-seed{seed}", [[0.4 + seed]]) for seed in range(3)]
    corrected = [_content(f"ppo_mix-seed{seed}-corrected", [[0.2 + seed]]) for seed in (0, 2, 3)]
    summary = summarize({content["entry"]["name"]: content for content in (*declared, *corrected)})
    steps = summary["steps"]["ppo_mix-corrected"]["reach"]
    assert steps["ratio"][0] == pytest.approx((0.2 / 0.4 + 2.2 / 2.4) / 2)


def test_agents_are_trained_on_each_task_and_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("stable_baselines3")
    found = [machines.Identified(declared_machine(), declared_machine(), "no_effect", (), 1.0, 0.0, ())]
    runs = []

    def fake_train(recipe: Any, machine: Machine, task: str, *, out: Path, **settings: Any) -> None:
        runs.append((recipe.name, recipe.start, recipe.env["randomize"], task, machine.parameters["x.mass"]))
        out.mkdir(parents=True, exist_ok=True)
        (out / "card.json").write_text(json.dumps({"kept": 7, "curve": [{"cpu_s": 2.0, "steps": 9}]}))

    monkeypatch.setattr("hframe_gym.agents.train", fake_train)
    monkeypatch.setattr(
        "hframe_gym.agents.agent_files.read_training_card", lambda p: json.loads(p.read_text())
    )
    monkeypatch.setattr("benchmarks.gap.entries.standard_session", lambda recorder: ())
    monkeypatch.setattr("benchmarks.gap.entries.identified", lambda *arguments: found[-1])
    monkeypatch.setattr("benchmarks.gap.entries.encoders_drift", lambda *arguments: False)

    def prepared() -> GapEntry:
        entry = get_entry("ppo_mix-trained")()
        entry.prepare(declared_machine(), Recorder(IDEAL), tmp_path)
        return entry

    about = prepared().about()
    assert [run[:4] for run in runs] == [
        ("ppo_mix_reach", "ppo_mix", "default", "reach"),
        ("residual_track", "residual", "default", "track"),
    ]
    assert (about["kept_steps"], about["training_cpu_s"]) == ({"reach": 7, "track": 7}, 4.0)
    assert about["training_steps"] == {"reach": 9, "track": 9}
    prepared()
    assert len(runs) == 2  # the agents of this machine are kept
    heavier = declared_machine().replace({"x.mass": 5.0})
    found.append(machines.Identified(heavier, heavier, "no_effect", (), 1.0, 0.0, ()))
    prepared()
    assert [run[4] for run in runs[2:]] == [5.0, 5.0]


def test_sac_continues_with_the_noise_of_its_last_episodes_and_learns_its_critics_first() -> None:
    for task, entropy in (("reach", -8.0), ("track", -2.0)):
        name, start = TRAINED["sac_mix"][task]
        recipe = continued(load_recipe(name, task), start, "identified")
        assert recipe.start == start
        assert recipe.env["randomize"] == "identified"
        assert recipe.algorithm["target_entropy"] == entropy
        assert 0 == recipe.algorithm["learning_starts"] < recipe.algorithm["critic_steps"] < recipe.steps


def test_trained_agents_are_compared_with_those_of_corrected_laws() -> None:
    trained = _content("ppo_mix-seed0-trained", [[0.3, 0.3, 0.4]])
    trained["plants"][0]["about"] = {
        "training_steps": {"reach": 9, "track": 9},
        "training_cpu_s": 1.0,
        "kept_steps": {"reach": 8, "track": 0},
    }
    corrected = _content("ppo_mix-seed0-corrected", [[0.4, 0.4, 0.5], [0.4, 0.4, 0.5]])
    contents = {content["entry"]["name"]: content for content in (trained, corrected)}
    (row,) = trained_against_corrected(contents)["rows"]
    assert (row["plant"], row["kept_steps"]) == (0, {"reach": 8, "track": 0})
    assert row["reach"]["difference"] == pytest.approx((-0.1, -0.1, -0.1))
    assert row["circle"] == {"corrected": 0.1, "trained": 0.1, "difference": (0.0, 0.0, 0.0)}


def test_intervals_are_over_plants_and_seeds() -> None:
    of_plants = results.interval([1.0, 2.0, 3.0, 4.0])
    assert of_plants[0] == 2.5
    assert results.interval([[1.0, 2.0, 3.0, 4.0]] * 3) == pytest.approx(of_plants)
    mean, low, high = results.interval([[1.0] * 4, [2.0] * 4])
    assert (mean, low, high) == (1.5, 1.0, 2.0)
    assert np.isnan(results.interval([])).all()


def test_identification_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def fake_identify(recordings: Any, machine: Machine, *, budget: float) -> str:
        calls.append(budget)
        return "result"

    def fake_write(result: str, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("before", "machine"):
            save_machine(declared_machine(), folder / f"{name}.json")
        report = {"verdict": "effect_found", "effects": [{"name": "cogging", "site": "motor1"}], "left": 1.5}
        report |= {"runs": {"held_out": ["run_01_steps"]}}
        (folder / "report.json").write_text(json.dumps(report))

    monkeypatch.setattr(machines, "identify", fake_identify)
    monkeypatch.setattr(machines, "write_result", fake_write)

    def found(start: str) -> machines.Identified:
        runs = (Recorder(IDEAL).excite("steps", start),)
        return machines.identified(runs, declared_machine(), tmp_path / "standard")

    first, again = found("center"), found("center")
    assert calls == [math.inf]  # a limited search finds less on a slower processor
    expected = ("effect_found", ("cogging@motor1",), 1.5, first.cpu_s, ("run_01_steps",))
    assert first[2:] == again[2:] == expected
    found("elsewhere")  # other recordings
    assert len(calls) == 2


@pytest.mark.parametrize("path", sorted(RESULTS.rglob("*.json")), ids=lambda path: path.stem)
def test_published_results_are_valid(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    content = results.read(path)
    held = path.parent != RESULTS
    assert content["seed"] == (int(path.parent.name) if held else PUBLIC_SEED)
    least = 1 if held else 12
    assert len({row["plant"] for row in content["plants"]}) == len(content["plants"]) >= least


def test_the_bound_leaves_out_what_the_optimization_does_not_support() -> None:
    pytest.importorskip("casadi")
    rng = np.random.default_rng(0)
    names = (("belt_play", "belts"), ("bridge_yaw", "machine"), ("cogging", "motor1"))
    effects = tuple(draw_effect(name, site, 1.0, rng) for name, site in names)
    row = bounds.compute(
        GapPlant(1, 0, effects, Residue()), np.zeros((2, 2)), np.array([[0.05, 0.0], [0.1, 0.1]])
    )
    assert row["left_out"] == ["belt_play@belts", "bridge_yaw@machine"]
    assert 0.03 < row["times_s"][0] < row["times_s"][1] < 0.4


def test_bounds_belong_to_the_moves() -> None:
    for times in bounds.stored_bounds(PUBLIC_SEED).values():
        assert len(times) == 12
        assert np.isfinite(times[: bounds.MOVES]).any()
        assert np.nanmin(times) > 0.02
