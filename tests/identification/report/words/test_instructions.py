"""Tests of the steps that a page advises."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from typing import Any

import pytest

from hframe_gym.controllers import TextbookPID
from hframe_gym.identification import Dataset, write_result
from hframe_gym.identification.report.content.document import (
    DeterminedSum,
    NotSeparable,
    UndeclaredFriction,
    UnknownVoltages,
)
from hframe_gym.identification.report.content.saved_result import load_result
from hframe_gym.identification.report.words.instructions import next_command, next_steps
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.identification.report.axis_results import PLAN, STRIBECK, result_of
from tests.identification.single_axis import AXIS


@pytest.mark.parametrize(
    ("change", "commands"),
    [
        ({}, "voltages"),
        ({"kind": "duty-cycle"}, "duty cycles"),
        ({"kind": "current", "Ke": 0.0, "resistance": 1.0}, "currents"),
    ],
)
def test_the_proposed_experiment_names_what_is_commanded(
    data: Dataset, tmp_path: Path, change: dict[str, Any], commands: str
) -> None:
    write_result(result_of(data, "effect_found", STRIBECK, PLAN), tmp_path)
    saved = load_result(tmp_path)
    machine = saved.machine.replace(drives=(dataclasses.replace(saved.machine.drives[0], **change),))
    steps = next_steps(dataclasses.replace(saved, machine=machine), tmp_path, [], ["run_2"])
    assert any(f"Apply the {commands} of " in step.text for step in steps)


@pytest.mark.parametrize(
    ("variable", "text"),
    [
        (
            "velocity of x",
            "Record runs that isolate it: move x at six or more constant speeds in both directions",
        ),
        ("current of motor", "accelerate motor with voltages from small ones to the largest"),
        ("time", "begin cold, and repeat the same motion"),
        ("v_V", "move slowly and fast, one axis at a time, over the full travel"),
    ],
)
def test_the_run_to_record_follows_from_the_dependence(
    variable: str, text: str, data: Dataset, tmp_path: Path
) -> None:
    write_result(result_of(data, "unexplained", AXIS), tmp_path)
    saved = load_result(tmp_path)
    saved.report.residual.depends_on[0].variable = variable
    (step,) = next_steps(saved, tmp_path, (), ["run_2"])
    assert text in step.text
    assert step.command.startswith("hframe identify RUNS --machine")


def test_a_counter_of_pulses_is_replaced_and_undeclared_friction_declared(
    data: Dataset, tmp_path: Path
) -> None:
    write_result(result_of(data, "unexplained", AXIS), tmp_path)
    saved = load_result(tmp_path)
    counter = dataclasses.replace(AXIS.sensors[0], channel="x_m_s", kind="unsigned-speed")
    saved = dataclasses.replace(saved, machine=AXIS.replace(sensors=(counter,)))
    saved.report.undeclared_friction = [
        UndeclaredFriction(parameter="x.coulomb", value=3.0, std=None, unit="N", percent_of_drives=None)
    ]
    sensor, friction = next_steps(saved, tmp_path, (), ["run_2"])
    assert "Add a sensor that shows the direction" in sensor.text
    assert friction.text == "Declare the friction in declared.json: x.coulomb 3 N."


def test_the_steps_name_what_to_measure_and_a_controller_with_its_period(
    data: Dataset, tmp_path: Path
) -> None:
    write_result(result_of(data, "no_effect", AXIS), tmp_path, ("advice: odd",))
    saved = load_result(tmp_path)
    determined = DeterminedSum(weights={"x.viscous": 1.0, "motor.Ke": 5.0}, value=6.0, std=0.1)
    saved.report.not_separable = [NotSeparable(parameters=["x.viscous", "motor.Ke"], determined=[determined])]
    saved.report.left = 1.0
    control, measure, findings = next_steps(saved, tmp_path, (), ["run_2"])
    assert "determine motor.Ke (take it from the data sheet of the motor, or turn" in measure.text
    assert "determine only x.viscous + 5 motor.Ke." in measure.text
    assert (
        "on the refitted machine, pid first, with a control period of 10 ms. A textbook PID" in control.text
    )
    assert control.command.startswith("hframe evaluate pid")
    assert "Read the findings about the recordings (1)" in findings.text
    saved.report.left = 3205.0
    assert any(
        "Look at run_2, the run with the largest error" in s.text
        for s in next_steps(saved, tmp_path, (), ["run_2"])
    )


def test_a_slow_log_that_may_hide_effects_is_recorded_again_before_anything_else(
    data: Dataset, tmp_path: Path
) -> None:
    """A controller that is designed for the wrong machine is not the next step."""
    write_result(result_of(data, "no_effect", AXIS), tmp_path)
    saved = load_result(tmp_path)
    saved.report.left = 27.0
    saved.report.unknown_voltages = UnknownVoltages(
        changes_per_row=10, period_s=1e-3, errors={"x_m": 3e-5}, fitted_by="instruments"
    )
    first = next_steps(saved, tmp_path, (), ["run_2"])[0]
    assert first.text.startswith("Log every row of the controller (every 1 ms), or describe the drives by")
    assert "this log may hide effects" in first.text
    assert first.command.startswith("hframe identify RUNS --machine")

    def advised() -> bool:
        return any("Log every row" in step.text for step in next_steps(saved, tmp_path, (), ["run_2"]))

    assert advised()
    saved.report.left = 1.0  # only noise is left
    assert not advised()
    saved.report.left, saved.report.unknown_voltages = 27.0, None  # the log has all voltages
    assert not advised()


def test_the_period_of_a_textbook_controller_is_the_longest_one_that_is_stable(
    data: Dataset, tmp_path: Path
) -> None:
    stage = BUILTIN_MACHINES["hframe"]()
    periods = [p for p in (0.01, 0.005, 0.002, 0.001, 0.0005) if TextbookPID(stage, p).concern() is None]
    write_result(result_of(data, "no_effect", AXIS), tmp_path)
    saved = dataclasses.replace(load_result(tmp_path), machine=stage)
    saved.report.left = 1.0
    (step,) = next_steps(saved, tmp_path, (), ["run_2"])
    expected = {
        0.01: "is stable at this period as well",
        0.005: "needs 5 ms or less",
        0.002: "needs 2 ms or less",
        0.001: "needs 1 ms or less",
        0.0005: "needs 0.5 ms or less",
    }
    assert f"A textbook PID {expected[periods[0]]}." in step.text


BOUNDLESS = AXIS.replace(coordinates=(dataclasses.replace(AXIS.coordinates[0], range=None),))


@pytest.mark.parametrize(
    ("verdict", "machine", "command"),
    [
        ("unexplained", AXIS, "hframe report out/rig --open"),  # not the check that has passed
        ("no_effect", AXIS, "hframe evaluate pid --machine out/rig/machine"),
        ("effect_found", AXIS, "hframe evaluate pid --machine out/rig/machine"),
        (
            "effect_found",
            BOUNDLESS,
            "hframe report out/rig --open",
        ),  # no controller moves its tool within a range
    ],
)
def test_the_next_command_is_one_that_verdict_and_machine_permit(
    verdict: str, machine: Machine, command: str
) -> None:
    assert next_command(verdict, machine, Path("out/rig")).startswith(command)


def test_the_next_command_has_a_control_period_at_which_the_belts_can_be_damped() -> None:
    assert "--period" not in next_command("no_effect", BUILTIN_MACHINES["hframe"](), Path("out/rig"))
    command = next_command("no_effect", BUILTIN_MACHINES["corexy"](), Path("out/a rig"))
    words = shlex.split(command)
    assert words[words.index("--period") + 1] == "0.002"  # belts at 82 Hz
    assert words[-2:] == ["--out", str(Path("out/a rig/control"))]
