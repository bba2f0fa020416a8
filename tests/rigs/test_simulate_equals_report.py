"""Test on rigs of the library's effects that `hframe simulate` has the errors that report.json states."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.identification import identify, simulate_recording, write_result
from hframe_gym.recordings import Recording, load_machine
from tests.reference_simulator import Array
from tests.rigs.cases import Case, cases, effect
from tests.rigs.fresh_process import in_fresh_process
from tests.rigs.recording_sessions import record

pytestmark = pytest.mark.slow

LIBRARY = sorted(
    name for name, case in cases().items() if case.group == "library-full" or name in ("none 1", "idlers 1")
)
# Most runs begin with a laser at the end of its range, under a force that stretches the belts at rest.
TILT_AND_RANGE = Case(
    "tilt and range",
    "pairs",
    "library",
    "full",
    (effect("constant_force", "y", 1.0), effect("sensor_range", "x_m", 1.0)),
)


def simulation_errors(file: Path, recordings: list[Recording]) -> list[Array]:
    """Return the errors of a written machine on some runs."""
    machine = load_machine(file)
    return [simulate_recording(machine, recording).error for recording in recordings]


@pytest.mark.parametrize("name", [*LIBRARY, TILT_AND_RANGE.name])
def test_simulate_reproduces_the_errors_of_the_report(name: str, tmp_path: Path) -> None:
    case = cases().get(name, TILT_AND_RANGE)
    session = record(case, tmp_path / "rigs")
    recordings = {recording.name: recording for recording in session.recordings()}
    write_result(identify(list(recordings.values()), session.machine()), tmp_path / "out")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    curves = np.load(tmp_path / "out" / "evidence.npz")
    for stage, file in (("declared", "declared.json"), ("before", "before.json"), ("after", "machine.json")):
        machine, held_out = load_machine(tmp_path / "out" / file), report["runs"]["held_out"]
        errors = in_fresh_process(
            simulation_errors, tmp_path / "out" / file, [recordings[run] for run in held_out]
        )
        for run, error in zip(held_out, errors, strict=True):
            reported = np.sqrt(np.nanmean(curves[f"{run}/{stage}"] ** 2, axis=0))
            np.testing.assert_allclose(np.sqrt(np.nanmean(error**2, axis=0)), reported, rtol=0.05)
        complete = np.sqrt(np.nanmean(np.concatenate(errors) ** 2, axis=0))
        stated = [report[stage]["held_out"][channel]["rmse"] for channel in machine.output_channels]
        np.testing.assert_allclose(complete, stated, rtol=0.05)
