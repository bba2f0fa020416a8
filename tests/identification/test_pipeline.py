"""The whole loop on recordings of an independent simulator: the planted effect, and none where there is none."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.identification import IdentificationResult, hold_out, identify
from hframe_gym.identification.report import build_report
from hframe_gym.identification.result_output import write_answer
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording, load_machine, load_recordings
from tools.make_examples import RIGS


@pytest.fixture(scope="module")
def found() -> IdentificationResult:
    machine = BUILTIN_MACHINES["hframe"]()
    return identify(load_recordings("examples/rig_a", machine), machine)


def test_the_planted_effect_is_named_and_removes_the_error(found: IdentificationResult) -> None:
    report = found.as_json()
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


def test_the_twin_has_no_effect() -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    answer = identify(load_recordings("examples/rig_b", machine), machine)
    assert answer.verdict == "no_effect"
    assert answer.found == ()
    ratios = [e.noise_ratio for e in answer.before.held_out.channels.values()]
    assert all(r is not None and r < 1.1 for r in ratios)


def test_a_channel_that_was_never_measured_is_null_and_the_rest_stands(tmp_path: Path) -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    recordings = []
    for r in load_recordings("examples/rig_b", machine):
        outputs = r.outputs.copy()
        outputs[:, 3] = np.nan
        recordings.append(dataclasses.replace(r, outputs=outputs))
    answer = identify(recordings, machine)
    assert answer.verdict == "no_effect"
    write_answer(answer, tmp_path)
    build_report(tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["after"]["held_out"]["y_m"] == {"rmse": None, "noise_ratio": None}
    assert report["after"]["held_out"]["x_m"]["noise_ratio"] < 1.1


def test_held_out_runs_are_never_fitted(found: IdentificationResult) -> None:
    fitted, judged = ({r.name for r in data.runs} for data in (found.fitted, found.held_out))
    assert not fitted & judged
    assert len(fitted | judged) == 8


def test_the_folder_is_complete_and_its_machine_runs(found: IdentificationResult, tmp_path: Path) -> None:
    write_answer(found, tmp_path)
    page = build_report(tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["schema"] == 1
    text = page.read_text()
    assert "stribeck friction at x" in text
    assert "http" not in text.replace("http-equiv", "")
    assert {p.name for p in (tmp_path / "plots").iterdir()} == {
        "coverage.png",
        "error_by_channel.png",
        "error_over_time.png",
        "residual_force.png",
    }
    machine = load_machine(tmp_path / "machine.json")
    assert machine.parameters == found.after.machine.parameters
    assert machine.uncertainty is not None


def test_hold_out_takes_every_fourth_and_refuses_nonsense() -> None:
    runs = [Recording(f"run_{i}", *[None] * 3) for i in range(1, 9)]  # type: ignore[arg-type]
    assert hold_out(runs) == ("run_4", "run_8")
    assert hold_out(runs[:2]) == ("run_2",)
    assert hold_out(runs, ["run_3"]) == ("run_3",)
    with pytest.raises(InputError, match="no such run"):
        hold_out(runs, ["run_9"])
    with pytest.raises(InputError, match="at least one must be left"):
        hold_out(runs[:1])
