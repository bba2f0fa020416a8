"""Commands on recordings: simulate, import, check, identify and report."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.cli import identify_commands
from hframe_gym.cli.identify_steps import proposed_output
from hframe_gym.errors import InputError
from hframe_gym.identification import simulate_recording
from hframe_gym.identification.budget import LAST_STAGE_END, Budget
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import load_recording
from tests.cli.running import ROOT, Command, assert_refused

pytestmark = pytest.mark.integration


def test_simulate_keeps_times_and_columns(hframe_command: Command, tmp_path: Path, hframe: Machine) -> None:
    source = ROOT / "examples/rig_b/run_01.csv.gz"
    code, _, _ = hframe_command(
        "simulate", "--machine", "hframe", "--inputs", source, "--out", tmp_path / "p.csv"
    )
    assert code == 0
    measured, predicted = load_recording(source, hframe), load_recording(tmp_path / "p.csv", hframe)
    np.testing.assert_allclose(predicted.time_s, measured.time_s, rtol=1e-9)
    np.testing.assert_allclose(predicted.inputs, measured.inputs, rtol=1e-8)
    lasers = [hframe.output_channels.index(channel) for channel in ("x_m", "y_m")]
    np.testing.assert_allclose(predicted.outputs[0, lasers], measured.outputs[0, lasers], atol=1e-3)


def test_simulate_starts_where_identification_starts(
    hframe_command: Command, tmp_path: Path, hframe: Machine
) -> None:
    source = ROOT / "examples/rig_b/run_01.csv.gz"
    hframe_command("simulate", "--inputs", source, "--out", tmp_path / "p.csv")
    recording = load_recording(source, hframe)
    expected = simulate_recording(hframe, recording)
    np.testing.assert_allclose(
        load_recording(tmp_path / "p.csv", hframe).outputs, expected.outputs, rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize(
    ("cells", "header", "location"),
    [
        ({}, "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,w_m", "column w_m"),
        ({(4, "v2_V"): "oops"}, None, "row 4, column v2_V"),
        ({(4, "time_s"): "4.9"}, None, "row 4, column time_s"),
    ],
)
def test_simulate_refuses_a_faulty_recording_and_writes_nothing(
    cells: dict[tuple[int, str], str],
    header: str | None,
    location: str,
    hframe_command: Command,
    write_run: Callable[..., Path],
    tmp_path: Path,
) -> None:
    path = write_run(cells=cells, **({"header": header} if header else {}))
    before = set(tmp_path.iterdir())
    assert_refused(
        hframe_command("simulate", "--inputs", path, "--out", tmp_path / "p.csv"), str(path), location
    )
    assert set(tmp_path.iterdir()) == before


def test_simulate_refuses_inputs_that_make_the_motion_diverge(
    hframe_command: Command, write_run: Callable[..., Path], tmp_path: Path
) -> None:
    path = write_run(cells={(row, "v1_V"): "1e30" for row in range(10, 21)})
    result = hframe_command("simulate", "--inputs", path, "--out", tmp_path / "p.csv")
    assert_refused(result, "machine 'hframe'", "check the inputs and the machine's parameters")
    assert not (tmp_path / "p.csv").exists()


def test_identify_refuses_a_faulty_recording_before_it_writes(
    hframe_command: Command, write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a.csv", cells={(4, "x_m"): "oops"})
    assert_refused(
        hframe_command("identify", tmp_path, "--out", tmp_path / "out"), "a.csv, row 4, column x_m"
    )
    assert_refused(hframe_command("identify", tmp_path, "--out", tmp_path), "is the folder of the recordings")
    assert not (tmp_path / "out").exists()


@pytest.mark.unit
def test_a_command_proposes_another_folder_for_results_than_that_of_the_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert proposed_output(Path("rigs/axis")) == Path("out/axis")
    assert proposed_output(Path("out/axis")) == proposed_output(tmp_path / "out" / "axis") != Path("out/axis")
    assert proposed_output(Path("rigs/..")) == Path("out", tmp_path.name)


def test_a_fault_in_the_data_stops_identify_and_is_the_exit_code_of_check(
    hframe_command: Command, tmp_path: Path, hframe: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Negate one column: `check` exits with 1, `identify` refuses and names it, and --force fits."""
    runs, out = tmp_path / "runs", tmp_path / "out"
    runs.mkdir()
    header = ",".join(["time_s", *hframe.input_channels, *hframe.output_channels])
    for path in sorted((ROOT / "examples/rig_b").glob("run_0[12]*")):
        run = load_recording(path, hframe)
        table = np.column_stack([run.time_s, run.inputs, run.outputs * [1.0, 1.0, -1.0, 1.0]])
        np.savetxt(runs / f"{run.name}.csv", table, fmt="%.9g", delimiter=",", header=header, comments="")
    code, printed, _ = hframe_command("check", runs)
    assert code == 1
    assert "fault: x_m has the wrong sign" in printed
    refused = hframe_command("identify", runs, "--out", out)
    assert_refused(refused, f"all runs of {runs}: x_m has the wrong sign: correct the columns", "--force")
    assert not out.exists()

    def begin_fit(*_args: object, **_keywords: object) -> None:
        raise InputError("the fit begins")

    monkeypatch.setattr("hframe_gym.identification.identify", begin_fit)
    assert_refused(hframe_command("identify", runs, "--out", out, "--force"), "the fit begins")


def test_the_budget_of_identify_counts_from_the_start_of_the_command(
    hframe_command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock advances by 1 s while the files are read; time for the report is left at the end."""
    clock = [100.0]
    monkeypatch.setattr("time.process_time", lambda: clock[0])
    load = identify_commands._load_runs

    def loaded(*arguments: Any) -> Any:
        clock[0] += 1.0
        return load(*arguments)

    def begin_fit(*_args: object, budget: Budget, **_keywords: object) -> None:
        left = budget.until(LAST_STAGE_END).seconds
        raise InputError(f"{budget.spent:.0f} s of {budget.seconds:.0f} s, then {left:.0f} s")

    monkeypatch.setattr(identify_commands, "_load_runs", loaded)
    monkeypatch.setattr(identify_commands, "check_recordings_before_fit", lambda *arguments: [])
    monkeypatch.setattr("hframe_gym.identification.identify", begin_fit)
    refused = hframe_command("identify", ROOT / "examples/rig_b", "--out", tmp_path / "out", "--budget", "20")
    assert_refused(refused, "1 s of 20 s, then 13 s")


@pytest.mark.parametrize(
    "contents",
    [None, '{"schema": 1', "[]", '{"schema": 1}'],
    ids=["missing", "truncated", "a list", "incomplete"],
)
def test_report_refuses_a_damaged_folder(
    contents: str | None, hframe_command: Command, tmp_path: Path
) -> None:
    if contents is not None:
        (tmp_path / "report.json").write_text(contents)
    assert_refused(hframe_command("report", tmp_path), str(tmp_path))


def test_import_converts_a_folder_of_logs_that_check_then_accepts(
    hframe_command: Command, tmp_path: Path
) -> None:
    source = np.loadtxt(ROOT / "examples/rig_b/run_01.csv.gz", delimiter=",", skiprows=1)[:800]
    (tmp_path / "logs").mkdir()
    for name in ("a", "b"):
        lines = ["Zeit [ms];U1;U2;phi1 [deg];phi2 [deg];Laser X;Y [mm]"]
        scales = [1e3, 1, 1, 180 / np.pi, 180 / np.pi, 1e3, 1e3]
        lines += [";".join(f"{value:.12g}".replace(".", ",") for value in row) for row in source * scales]
        (tmp_path / "logs" / f"{name}.txt").write_text("\n".join(lines))
    (tmp_path / "map.toml").write_text(
        "[map]\nv1_V = 'U1'\nv2_V = 'V2'\nx_m = 'Laser X'\n[scale]\nx_m = 0.001\n"
    )
    options = ("--mapping", tmp_path / "map.toml", "--out", tmp_path / "runs")
    result = hframe_command("import", tmp_path / "logs", *options)
    assert_refused(result, "--map v2_V=V2: there is no such column; the columns are Zeit [ms], U1, U2")
    assert_refused(
        hframe_command("import", tmp_path / "logs", *options, "--map", "U2"), "--map U2: must be CHANNEL=COL"
    )
    assert_refused(
        hframe_command("import", tmp_path / "logs", *options, "--scale", "x_m=a"), "'a' is not a factor"
    )
    assert not (tmp_path / "runs").exists()
    code, out, _ = hframe_command(
        "import", tmp_path / "logs", *options, "--map", "v2_V=U2", "--format", "parquet"
    )
    assert code == 0
    assert "phi1 [deg] angle deg phi1_rad (deg to rad)" in " ".join(out.split())
    assert (
        f"wrote 2 runs to {tmp_path / 'runs'}. Next: hframe check {tmp_path / 'runs'} --machine hframe" in out
    )
    run = load_recording(tmp_path / "runs" / "b.parquet", BUILTIN_MACHINES["hframe"]())
    np.testing.assert_allclose(np.column_stack([run.time_s, run.inputs, run.outputs]), source, rtol=1e-10)
    code, out, _ = hframe_command("check", tmp_path / "runs")
    assert code == 0
    assert "faults: 0" in out


def test_a_single_run_cannot_be_identified_and_the_message_says_how_to_cut_it(
    hframe_command: Command, tmp_path: Path
) -> None:
    shutil.copy(ROOT / "examples/rig_b/run_01.csv.gz", tmp_path)
    result = hframe_command("identify", tmp_path, "--out", tmp_path / "out")
    command = f"hframe import {tmp_path / 'run_01.csv.gz'} --out RUNS --split-at-rests"
    assert_refused(result, "has the single run 'run_01' of", command)
    assert not (tmp_path / "out").exists()
