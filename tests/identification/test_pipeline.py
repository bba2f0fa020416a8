"""Tests of identification on recordings from another simulator, with and without an undeclared effect."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.identification import (
    IdentificationResult,
    SelectionCriteria,
    hold_out,
    identify,
    write_result,
)
from hframe_gym.identification.report.page import build_report
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import load_machine, load_recordings
from tests.identification.single_axis import AXIS, limited_runs
from tools.make_examples import RIGS

pytestmark = pytest.mark.integration

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def log() -> list[str]:
    """Return the lines that the identification of rig_a reported."""
    return []


@pytest.fixture(scope="module")
def result(log: list[str]) -> IdentificationResult:
    """Return the result for rig_a, which has Stribeck friction at x. It is immutable."""
    machine = BUILTIN_MACHINES["hframe"]()
    return identify(load_recordings(EXAMPLES / "rig_a", machine), machine, log=log.append, budget=math.inf)


@pytest.mark.oracle
def test_the_undeclared_effect_is_identified_and_removes_the_error(result: IdentificationResult) -> None:
    report = result.as_json()
    assert report["verdict"] == "effect_found"
    [effect] = report["effects"]
    assert (effect["name"], effect["site"]) == ("stribeck_friction", "x")
    assert effect["rivals"] == []
    rig = RIGS["rig_a"]
    unit = rig.torque_constant[0] * rig.drive_gain[0] / BUILTIN_MACHINES["hframe"]().drives[0].Kt
    assert effect["parameters"]["dF"]["value"] * unit == pytest.approx(rig.stribeck_force[0], rel=0.01)
    assert effect["parameters"]["vs"]["value"] == pytest.approx(rig.stribeck_velocity[0], rel=0.01)
    for channel, error in report["after"]["held_out"].items():
        assert error["rmse"] < report["before"]["held_out"][channel]["rmse"] / 5
        assert error["noise_ratio"] < 1.1
    assert report["residual"]["white"]
    assert report["residual"]["depends_on"][0]["variable"] == "velocity of x"


@pytest.mark.oracle
def test_each_decision_is_reported_in_words(result: IdentificationResult, log: list[str]) -> None:
    assert result.effects
    text = "\n".join(log)
    assert "stribeck_friction@x reduces chi-squared per sample from " in text
    assert "(observer of 60 rad/s)" in text
    assert log[-1] == "verdict: effect_found"


@pytest.mark.oracle
def test_the_twin_has_no_effect() -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    result = identify(load_recordings(EXAMPLES / "rig_b", machine), machine, budget=math.inf)
    assert result.verdict == "no_effect"
    assert result.effects == ()
    ratios = [e.noise_ratio for e in result.before.held_out.channels.values()]
    assert all(r is not None and r < 1.1 for r in ratios)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("wrong", "warning"), [("run_03", "is not used"), ("run_04", "was held out and contradicts")]
)
def test_a_run_that_contradicts_the_others_is_left_out_and_named(wrong: str, warning: str) -> None:
    """In one run of the rig without effects, both drives had 20 % less gain than in the others."""
    machine = BUILTIN_MACHINES["hframe"]()
    recordings = [
        dataclasses.replace(
            run,
            time_s=run.time_s[:1300],
            inputs=(1.25 if run.name == wrong else 1.0) * run.inputs[:1300],
            outputs=run.outputs[:1300],
        )
        for run in load_recordings(EXAMPLES / "rig_b", machine)
        if run.name not in ("run_05", "run_06", "run_07")
    ]
    result = identify(recordings, machine, held_out=["run_04", "run_08"], budget=math.inf)
    assert result.verdict == "no_effect"
    assert [line for line in result.excluded if line.startswith(f"{wrong} {warning}")]
    assert wrong not in {run.name for run in result.fitted.runs}
    ratios = [e.noise_ratio for e in result.before.held_out.channels.values()]
    assert all(r is not None and (r < 1.1) == (wrong == "run_03") for r in ratios)


@pytest.mark.oracle
@pytest.mark.usefixtures("without_drawing")
def test_a_channel_that_was_never_measured_is_null_in_the_report(tmp_path: Path) -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    recordings = []
    for r in load_recordings(EXAMPLES / "rig_b", machine)[:3]:
        outputs = r.outputs.copy()
        outputs[:, 3] = np.nan
        recordings.append(dataclasses.replace(r, outputs=outputs))
    result = identify(recordings, machine)
    assert result.verdict == "no_effect"
    write_result(result, tmp_path)
    build_report(tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["after"]["held_out"]["y_m"] == {"rmse": None, "noise_ratio": None}
    assert report["after"]["held_out"]["x_m"]["noise_ratio"] < 1.1


def test_the_order_of_the_recordings_does_not_matter() -> None:
    runs = limited_runs([6.0] * 4)
    first, second = (
        identify(recordings, AXIS, budget=math.inf).as_json() for recordings in (runs, runs[::-1])
    )
    assert first["effects"]
    assert first | {"seconds": 0} == second | {"seconds": 0}


def test_held_out_runs_are_never_fitted(result: IdentificationResult) -> None:
    fitted, held_out = ({r.name for r in data.runs} for data in (result.fitted, result.held_out))
    assert not fitted & held_out
    assert len(fitted | held_out) == 8


@pytest.mark.oracle
def test_the_folder_is_complete_and_its_machine_is_the_corrected_one(
    result: IdentificationResult, tmp_path: Path
) -> None:
    write_result(result, tmp_path)
    page = build_report(tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["schema"] == 1
    text = page.read_text()
    assert "stribeck friction at x" in text
    assert "://" not in text  # self-contained
    assert {p.name for p in (tmp_path / "plots").iterdir()} == {
        "correlations.png",
        "coverage.png",
        "effects.png",
        "error_by_channel.png",
        "error_over_motion.png",
        "error_over_time.png",
        "residual_force.png",
    }
    machine = load_machine(tmp_path / "machine.json")
    assert machine.parameters == result.after.machine.parameters
    assert machine.uncertainty is not None


@pytest.mark.unit
def test_one_of_four_runs_is_held_out_and_a_path_is_refused() -> None:
    runs = limited_runs([3.0] * 8)
    assert len(hold_out(runs)) == 2
    assert hold_out(runs, ["run_2"]) == ("run_2",)
    short = [
        dataclasses.replace(r, time_s=r.time_s[:1], inputs=r.inputs[:1], outputs=r.outputs[:1])
        for r in runs[:2]
    ]
    with pytest.raises(InputError, match="run run_0: number of rows is 1, at least 20 are needed"):
        identify(short, AXIS)
    with pytest.raises(InputError, match="runs: 1, held out: 1"):
        identify([*short, runs[2]], AXIS)
    with pytest.raises(InputError, match=r"call load_recordings\('runs', machine\)"):
        identify("runs", BUILTIN_MACHINES["axis"]())  # type: ignore[arg-type]


@pytest.mark.oracle
def test_criteria_are_passed_to_the_search_and_written_to_the_report() -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    criteria = SelectionCriteria(max_effects=0, max_screened_tables=0, max_noise_ratio_explained=1e9)
    result = identify(load_recordings(EXAMPLES / "rig_a", machine)[:2], machine, criteria=criteria)
    assert result.verdict == "unexplained"
    assert not result.effects
    assert result.as_json()["criteria"]["max_effects"] == 0


def test_an_effect_that_only_the_held_out_run_excites_is_a_hint() -> None:
    """No other run confirms the effect, and held-out runs select nothing. The peak is too short to tell."""
    result = identify(limited_runs([3.0] * 4, peak=3), AXIS)
    assert result.effects == ()
    assert [run.name for run in result.held_out.runs] == ["run_3"]
    warnings = " ".join(result.run_warnings)
    assert "run_3 was held out and contradicts the fitted runs" in warnings
    assert "current_limit@motor would explain all runs" in warnings
    assert "Record another run such as run_3" in warnings
    chosen = identify(limited_runs([3.0] * 4, peak=3), AXIS, held_out=["run_3"])
    assert "would explain" not in " ".join(chosen.run_warnings)  # the user chose this division


def test_a_held_out_run_with_another_gain_does_not_cost_the_names() -> None:
    *runs, last = limited_runs([6.0] * 4)
    result = identify([*runs, dataclasses.replace(last, inputs=0.8 * last.inputs)], AXIS)
    assert [selected.effect.label for selected in result.effects] == ["current_limit@motor"]
    assert [run.name for run in result.held_out.runs] == ["run_0"]  # first, it was run_3
    assert "run_3 is not used" in " ".join(result.excluded)


def test_the_only_run_with_large_voltages_is_fitted_so_that_its_effect_is_found() -> None:
    """Every fourth run would hold it out."""
    result = identify(limited_runs([3.0, 3.0, 3.0, 9.0, 3.0]), AXIS)
    assert [selected.effect.label for selected in result.effects] == ["current_limit@motor"]
    assert "run_3" in {run.name for run in result.fitted.runs}
    assert "The held-out runs do not excite current_limit@motor" in " ".join(result.run_warnings)
