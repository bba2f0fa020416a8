"""Recordings: accepted formats, refusals by file, row and column, and gaps."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import (
    Recording,
    fill_gaps,
    load_recording,
    load_recordings,
    missing_rows,
    usual_step,
    write_recording,
    write_trajectory,
)

WriteRun = Callable[..., Path]


def test_columns_may_come_in_any_order_and_outputs_may_be_empty(write_run: WriteRun, hframe: Machine) -> None:
    path = write_run(cells={(3, "x_m"): "", (4, "y_m"): "nan", (5, "x_m"): "0.25"})
    run = load_recording(path, hframe)
    assert run.name == "run"
    assert run.inputs.shape == (20, 2)
    assert np.isnan(run.outputs[2, 2])
    assert np.isnan(run.outputs[3, 3])
    assert run.outputs[4, 2] == 0.25
    assert run.time_s[0] == 5.0
    lines = path.read_text().splitlines()
    order = [0, 6, 1, 5, 2, 3, 4]
    mixed = path.with_name("mixed.csv")
    mixed.write_text("\n".join(",".join(line.split(",")[i] for i in order) for line in lines))
    again = load_recording(mixed, hframe)
    np.testing.assert_array_equal(again.outputs, run.outputs)


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ({(7, "v1_V"): "abc"}, "row 7, column v1_V: 'abc' is not a number"),
        ({(7, "x_m"): "abc"}, "row 7, column x_m: 'abc' is not a number"),
        (
            {(7, "v1_V"): ""},
            "row 7, column v1_V: value is empty. Times and inputs must have no gaps; "
            "hframe import keeps the value",
        ),
        ({(7, "y_m"): "inf"}, "row 7, column y_m: inf is infinite"),
        (
            {(7, "time_s"): "5.001"},
            "row 7, column time_s: 5.001 goes back, row 6 is 5.005; times must increase",
        ),
        (
            {(7, "time_s"): "5.005"},
            "5.005 repeats row 6; times must increase: correct the time or delete the row",
        ),
        ({(7, "time_s"): ""}, "row 7, column time_s"),
        ({(7, "x_m"): "125.0"}, "row 7, column x_m: 125 cannot be m; is the column in millimeters?"),
        (
            {(7, "x_m"): "15.0"},
            "column x_m: moves by 15 m, but the range of x in the machine file is 0.56 m (correct it, "
            "or leave it out, if the machine moves that far); is the column in millimeters?",
        ),
        (
            {(7, "x_m"): "2.0"},
            "column x_m: moves by 2 m, but the range of x in the machine file is 0.56 m (correct it, "
            "or leave it out, if the machine moves that far); is the column in millimeters?",
        ),
        (
            {(r, c): "" for r in range(1, 21) for c in ("phi1_rad", "phi2_rad", "x_m", "y_m")},
            "all outputs are empty",
        ),
    ],
)
def test_an_error_names_file_row_and_column_of_a_faulty_cell(
    cells: dict[tuple[int, str], str], message: str, write_run: WriteRun, hframe: Machine
) -> None:
    path = write_run(cells=cells)
    with pytest.raises(InputError) as error:
        load_recording(path, hframe)
    assert str(path) in str(error.value)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (
            "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_mm,y_m",
            "column x_mm: is in millimeters; recordings have x_m",
        ),
        (
            "time_s,v1_V,v2_V,phi1_deg,phi2_rad,x_m,y_m",
            "column phi1_deg: is in degrees; recordings have phi1_rad",
        ),
        (
            "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,z_m",
            "column z_m: unknown; .*Is this the machine of the recordings .--machine.. If it is, rename",
        ),
        ("v1_V,time_s,v2_V,phi1_rad,phi2_rad,x_m,y_m", "the first column must be time_s"),
        ("time_s,v1_V,v1_V,phi1_rad,phi2_rad,x_m,y_m", "column v1_V: appears twice"),
    ],
)
def test_a_header_with_unknown_repeated_or_misplaced_columns_is_refused(
    header: str, message: str, write_run: WriteRun, hframe: Machine
) -> None:
    with pytest.raises(InputError, match=message):
        load_recording(write_run(header=header), hframe)


@pytest.mark.parametrize("place", [".", ".."])
def test_a_machine_file_beside_the_runs_is_pointed_out(place: str, tmp_path: Path, hframe: Machine) -> None:
    """The command had used the H-frame, without a word of the file."""
    runs = tmp_path / "runs"
    runs.mkdir()
    (runs / "a.csv").write_text("time_s,v_V,x_m\n0,0,0\n0.001,1,1\n")
    (runs / place / "machine.json").write_text("{}")
    with pytest.raises(InputError, match=r"\(--machine; .*machine\.json lies beside them\)\?"):
        load_recording(runs / "a.csv", hframe)


def test_a_missing_column_is_refused_but_voltages_alone_can_be_simulated(
    tmp_path: Path, hframe: Machine
) -> None:
    path = tmp_path / "v.csv"
    path.write_text("time_s,v1_V,v2_V\n0,0,0\n0.001,1,1\n")
    with pytest.raises(InputError, match="column phi1_rad: missing"):
        load_recording(path, hframe)
    with pytest.raises(
        InputError, match=r"column v1_V: unknown; machine 'axis' has .*\(--machine\)\? If it is, rename"
    ):
        load_recording(path, BUILTIN_MACHINES["axis"](), outputs_needed=False)
    run = load_recording(path, hframe, outputs_needed=False)
    assert np.isnan(run.outputs).all()
    path.write_text("time_s,v1_V\n0,0\n")
    with pytest.raises(
        InputError, match=r"column v2_V: missing .*\(--machine\)\? If it is, the column must be recorded"
    ):
        load_recording(path, hframe)
    path.write_text("time_s,v1_V,v2_V,x_m\n0,0,0,0\n")
    with pytest.raises(InputError, match="column phi1_rad: missing"):
        load_recording(path, hframe, outputs_needed=False)


def test_angles_in_degrees_under_a_rad_name_are_refused(tmp_path: Path, hframe: Machine) -> None:
    time = np.arange(200) * 1e-3
    y = 0.1 * time
    phi = np.degrees(-y / 0.0194)
    table = np.column_stack([time, 0 * time, 0 * time, phi, phi, 0 * time, y])
    path = tmp_path / "deg.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m", comments="")
    with pytest.raises(
        InputError,
        match="columns phi1_rad, phi2_rad: 57 times the travel that the belts allow; are they in degrees",
    ):
        load_recording(path, hframe)


def test_a_short_move_in_millimeters_is_refused_because_the_pulleys_disagree(
    tmp_path: Path, hframe: Machine
) -> None:
    time = np.arange(200) * 1e-3
    y = 0.005 * time
    phi = -y / 0.0194
    table = np.column_stack([time, 0 * time, 0 * time, phi, phi, 0 * time, 1000 * y])
    path = tmp_path / "mm.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m", comments="")
    with pytest.raises(
        InputError,
        match="columns x_m, y_m: 1000 times the travel that the belts allow; are they in millimeters",
    ):
        load_recording(path, hframe)


@pytest.mark.parametrize("content", ["", "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m\n"])
def test_an_empty_file_is_refused(content: str, tmp_path: Path, hframe: Machine) -> None:
    (tmp_path / "empty.csv").write_text(content)
    with pytest.raises(InputError, match=r"empty\.csv: (empty|no rows)"):
        load_recording(tmp_path / "empty.csv", hframe)


def test_a_folder_is_read_in_the_order_of_file_names(
    write_run: WriteRun, tmp_path: Path, hframe: Machine
) -> None:
    write_run("b.csv")
    write_run("a.csv")
    (tmp_path / "notes.txt").write_text("not a run")
    assert [r.name for r in load_recordings(tmp_path, hframe)] == ["a", "b"]
    assert [r.name for r in load_recordings(tmp_path, "hframe")] == ["a", "b"]
    with pytest.raises(InputError, match="no such folder"):
        load_recordings(tmp_path / "none", hframe)
    with pytest.raises(InputError, match="is a file, give the folder"):
        load_recordings(tmp_path / "a.csv", hframe)
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress((tmp_path / "a.csv").read_bytes()))
    with pytest.raises(InputError, match=r"the run 'a' exists twice"):
        load_recordings(tmp_path, hframe)


def test_a_written_trajectory_reads_back_and_leaves_no_temporary_file(
    tmp_path: Path, hframe: Machine
) -> None:
    time = np.arange(50) * 1e-3
    inputs = np.full((50, 2), -4.0)
    trajectory = hframe.simulate(time, inputs)
    for name in ("out.csv", "out.csv.gz"):
        write_trajectory(tmp_path / name, trajectory, inputs, hframe)
        run = load_recording(tmp_path / name, hframe)
        np.testing.assert_allclose(run.outputs, trajectory.outputs, rtol=1e-8, atol=1e-12)
    assert {p.name for p in tmp_path.iterdir()} == {"out.csv", "out.csv.gz"}


def test_lost_rows_are_inserted_with_interpolated_inputs_and_empty_outputs() -> None:
    time = 3.0 + np.arange(10) * 1e-3
    run = Recording("r", time, np.arange(20.0).reshape(10, 2), np.ones((10, 4)))
    keep = np.ones(10, bool)
    keep[[4, 5, 8]] = False
    filled = fill_gaps(Recording("r", time[keep], run.inputs[keep], run.outputs[keep]))
    np.testing.assert_allclose(filled.time_s, time, atol=1e-12)
    np.testing.assert_allclose(filled.inputs, run.inputs, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(filled.outputs).all(axis=1), ~keep)


def test_a_run_without_lost_rows_is_returned_unchanged() -> None:
    time = np.arange(50) * 1e-3 + np.random.default_rng(0).uniform(-2e-4, 2e-4, 50)
    run = Recording("r", time, np.zeros((50, 2)), np.zeros((50, 4)))
    assert fill_gaps(run) is run
    single = Recording("r", time[:1], np.zeros((1, 2)), np.zeros((1, 4)))
    assert fill_gaps(single) is single


def test_a_log_of_events_lacks_no_rows() -> None:
    """Rows are written as values of several messages arrive, each at its rate: no step is the period."""
    rng = np.random.default_rng(0)
    clocks = [
        np.arange(phase, 20.0, period)
        for phase, period in ((0.0, 0.05), (0.001, 0.05), (0.012, 0.05), (0.02, 0.033))
    ]
    time = np.unique(np.concatenate([t + rng.uniform(0.0, 5e-3, len(t)) for t in clocks]))
    steps = np.diff(time)
    assert np.mean(steps > 1.5 * np.median(steps)) > 0.2
    assert np.mean(missing_rows(time) > 0) < 0.01
    # A pause is a gap all the same, of rows as far apart as the usual ones.
    pause = np.concatenate([time, time[-1] + 1.0 + time])
    assert missing_rows(pause)[len(time) - 1] == pytest.approx(1.0 / usual_step(time), abs=2)


@pytest.mark.parametrize("kept", [0.97, 0.9])
def test_a_clock_lacks_the_rows_that_were_dropped(kept: float) -> None:
    time = np.arange(5000) * 1e-3
    rng = np.random.default_rng(0)
    recorded = time[rng.random(5000) < kept]
    jittered = recorded + rng.uniform(-2e-4, 2e-4, len(recorded))
    assert usual_step(jittered) == pytest.approx(1e-3, rel=0.1)
    assert missing_rows(jittered).sum() == pytest.approx(5000 - len(recorded), rel=0.02)


def test_filled_gaps_predict_the_motion_better_than_inputs_held_over_the_gap(hframe: Machine) -> None:
    """Drive the stage by a sine of 20 Hz, drop 3 % of rows, and compare both simulations with the truth."""
    time = np.arange(2000) * 1e-3
    inputs = 6 * np.sin(2 * np.pi * 20 * time)[:, None] * [1.0, 0.5] + [2.0, -1.0]
    outputs = hframe.simulate(time, inputs).outputs
    keep = np.random.default_rng(1).random(2000) > 0.03
    keep[0] = True
    lost = Recording("r", time[keep], inputs[keep], outputs[keep])
    held = hframe.simulate(lost.time_s, lost.inputs).outputs - lost.outputs
    filled = fill_gaps(lost)
    error = hframe.simulate(filled.time_s, filled.inputs).outputs - filled.outputs
    assert np.nanstd(error[:, 2]) < 0.3 * np.std(held[:, 2])
    assert np.nanstd(error[:, 2]) == pytest.approx(0.0, abs=2e-4)


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "parquet"])
def test_of_long_sessions_the_beginnings_are_read(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every run keeps the same number of rows; shorter ones are complete and not mentioned."""
    monkeypatch.setattr("hframe_gym.recordings.recording.MIN_ROWS", 40)
    axis = BUILTIN_MACHINES["axis"]()
    for name, rows in (("long", 5000), ("short", 60)):
        time_s = np.arange(rows) * 1e-3
        run = Recording(name, time_s, np.sin(time_s)[:, None], 0.01 * np.cos(time_s)[:, None])
        write_recording(tmp_path / f"{name}.{suffix}", run, axis)
    lines: list[str] = []
    whole = load_recordings(tmp_path, axis)
    cut = load_recordings(tmp_path, axis, max_rows=200, log=lines.append)
    assert [len(run.time_s) for run in cut] == [100, 60]
    for run, complete in zip(cut, whole, strict=True):
        for key in ("time_s", "inputs", "outputs"):
            np.testing.assert_array_equal(getattr(run, key), getattr(complete, key)[: len(run.time_s)])
    assert lines == ["long: only the first 0.099 s (100 rows) are used, see --max-rows"]
    assert [len(run.time_s) for run in load_recordings(tmp_path, axis, max_rows=10, log=lines.append)] == [
        40,
        40,
    ]
