"""Output of findings, and the command `hframe check`."""

from __future__ import annotations

import dataclasses
import io
import json
import sys
from pathlib import Path

import pytest
from rich.console import Console

from hframe_gym.cli import main
from hframe_gym.data_validation import Finding, group_findings, print_findings
from hframe_gym.data_validation.findings import channel_unit
from hframe_gym.machine import BUILTIN_MACHINES
from tests.example_runs import EXAMPLES

FINDINGS = [Finding("fault", "run_01", "x_m", "stuck [at 0.1]"), Finding("note", "", "", "8 runs")]


def test_findings_are_lines_in_a_file_and_a_table_on_a_terminal() -> None:
    plain = io.StringIO()
    print_findings(FINDINGS, Console(file=plain, force_terminal=False, soft_wrap=True))
    assert plain.getvalue().splitlines() == [
        "faults: 1, advice: 0, notes: 1",
        "fault: run_01, x_m: stuck [at 0.1]",
        "note: 8 runs",
    ]
    rich = io.StringIO()
    print_findings(FINDINGS, Console(file=rich, force_terminal=True, width=100))
    assert "channel" in rich.getvalue()
    assert "stuck [at 0.1]" in rich.getvalue()


def test_the_unit_of_a_channel_is_in_its_name_else_that_of_its_quantity() -> None:
    machine = BUILTIN_MACHINES["axis"]()
    assert [channel_unit(c, machine) for c in (*machine.input_channels, *machine.output_channels)] == [
        "V",
        "m",
    ]
    inputs = {
        name: dataclasses.replace(machine.drives[0], channel=name) for name in ("torque_Nm", "i_A", "duty")
    }
    outputs = {
        name: dataclasses.replace(machine.sensors[0], channel=name) for name in ("shaft_rad", "counter")
    }
    units = [channel_unit(name, machine.replace(drives=(drive,))) for name, drive in inputs.items()]
    assert units == ["Nm", "A", "V"]
    assert [channel_unit(name, machine.replace(sensors=(s,))) for name, s in outputs.items()] == ["rad", "m"]


def test_equal_findings_of_many_runs_are_printed_once() -> None:
    findings = [
        Finding("advice", f"run_{i}", "time_s", f"{i} gaps (3.{i} ms): samples were dropped")
        for i in range(5)
    ]
    plain = io.StringIO()
    notes = [Finding("note", "", "x", f"standard error at least {percent} %") for percent in (1, 2)]
    print_findings([*findings, *notes], Console(file=plain))
    counts, advice, *others = plain.getvalue().splitlines()
    assert counts == "faults: 0, advice: 1, notes: 2"
    assert advice.startswith("advice: run_0 and 4 more runs, time_s: 0 gaps")
    assert others == [*map(str, notes)]


def test_a_finding_about_all_runs_is_not_one_of_several_runs() -> None:
    findings = [Finding("advice", run, "x_m", "noisy") for run in ("", "run_1", "run_2")]
    assert [finding.run for finding in group_findings(findings)] == ["", "run_1 and 1 more run"]


def test_the_command_prints_findings_and_writes_them_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    written = tmp_path / "findings.json"
    monkeypatch.setattr(sys, "argv", ["hframe", "check", str(EXAMPLES / "rig_b"), "--json", str(written)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 0
    assert "faults: 0" in capsys.readouterr().out
    content = json.loads(written.read_text())
    assert content["schema"] == 1
    assert {f["severity"] for f in content["findings"]} <= {"advice", "note"}


def test_the_command_refuses_a_faulty_file_with_exit_code_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text("time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m\n0,0,0,0,0,0,oops\n")
    monkeypatch.setattr(sys, "argv", ["hframe", "check", str(tmp_path)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "a.csv, row 1, column y_m" in capsys.readouterr().err
