"""Starts from rest against the drive."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from hframe_gym.data_validation import check_before_fit, check_recordings
from hframe_gym.data_validation.starts import starts_from_rest
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import measure

PERIOD_S = 2e-3
TO_AND_FRO = (0.0, 6.0, 0.0, -6.0, 0.0, 9.0, 0.0, -9.0, 0.0)  # V, levels of half a second
BACKWARDS = (0.0, -6.0, 0.0, -9.0, 0.0, -12.0, 0.0)


def motor(kind: str = "speed", *, drive: str = "duty-cycle", weight: float = 0.0) -> Machine:
    """Return a motor with one sensor of the shaft and a constant force that its file lacks, Nm."""
    machine = BUILTIN_MACHINES["motor"]()
    sensor = Sensor("shaft", {"shaft": 1.0}, noise=1e-3, kind=kind)
    motor_of = {"Kt": 1.0, "Ke": 0.0, "resistance": 1.0} if drive == "torque" else {}
    drives = tuple(dataclasses.replace(each, kind=drive, **motor_of) for each in machine.drives)
    effects = (EFFECTS["constant_force"].at("shaft", size=weight),) if weight else ()
    return machine.replace(sensors=(sensor,), drives=drives, effects=effects)


def run(machine: Machine, levels: tuple[float, ...], name: str = "run") -> Recording:
    """Return a simulated run with these levels of the command."""
    inputs = np.repeat(levels, round(0.5 / PERIOD_S))[:, None]
    time_s = PERIOD_S * np.arange(len(inputs))
    return Recording(name, time_s, inputs, measure(machine, simulate(machine, time_s, inputs).outputs))


def without_sign(recording: Recording) -> Recording:
    """Return a run whose inputs were logged as magnitudes."""
    return dataclasses.replace(recording, inputs=np.abs(recording.inputs))


def messages(recordings: list[Recording], machine: Machine) -> list[str]:
    """Return the findings about starts."""
    return [str(each) for each in check_before_fit(recordings, machine) if "starts from rest" in each.message]


@pytest.mark.parametrize("kind", ["speed", "encoder"])
def test_a_command_without_its_sign_is_a_fault(kind: str) -> None:
    machine = motor(kind)
    runs = [run(machine, TO_AND_FRO, "both"), without_sign(run(machine, BACKWARDS, "reverse"))]
    [line] = messages(runs, machine)
    assert line.startswith("fault: reverse, shaft: starts from rest against")
    assert "3 of 3 starts" in line
    assert messages([runs[0], run(machine, BACKWARDS)], machine) == []


def test_a_machine_that_moves_to_and_fro_without_signs() -> None:
    machine = motor()
    [line] = messages([run(machine, TO_AND_FRO), without_sign(run(machine, TO_AND_FRO, "second"))], machine)
    assert "second" in line
    assert "2 of 4 starts" in line


def test_a_force_that_the_file_lacks_is_no_fault() -> None:
    """The weight is held by friction at rest; a spring would be, too."""
    lacking = motor()
    coulomb = lacking.coordinates[0].coulomb
    heavy = motor(weight=0.8 * coulomb)
    assert messages([run(heavy, TO_AND_FRO), run(heavy, BACKWARDS, "back")], lacking) == []


def test_a_torque_may_brake_a_weight() -> None:
    machine = motor(drive="torque")
    runs = [run(machine, TO_AND_FRO), without_sign(run(machine, BACKWARDS, "reverse"))]
    [finding] = [f for f in check_recordings(runs, machine) if "starts from rest" in f.message]
    assert finding.severity == "advice"
    assert "brake" in finding.message


# Values and force over ten rows of 0.1 s; resting up to 0.1, a motion from 1 on.
CASES = {
    "along": ([0, 0, 0, 0, 0.5, 2, 3, 4, 5, 6], [0, 0, 0, 1, 1, 1, 1, 1, 1, 1], [True]),
    "against": ([0, 0, 0, 0, -0.5, -2, -3, -4, -5, -6], [0, 0, 0, 1, 1, 1, 1, 1, 1, 1], [False]),
    "stuck, then against": ([0, 0, 0, 0, 0, 0, 0, -2, -3, -4], [0, 0, 1, 1, 1, 2, 2, 2, 2, 2], [False]),
    "not measured meanwhile": ([0, 0, 0, np.nan, -2, -3, -4, -5, -6, -7], [0, 0, 0] + 7 * [1], [False]),
    "after the force has changed its sign": (
        [0, 0, 0, 0, 0, 0, -2, -3, -4, -5],
        [0, 0, 1, 1, -1] + 5 * [-1],
        [],
    ),
    "before the force": ([0, 0, 0, -1, -2, -3, -4, -5, -6, -7], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1], []),
    "slower than the rest lasts": ([0, 0, 0, -0.3, -0.5, -0.7, -0.8, -0.9, -1, -2], [0, 0] + 8 * [1], []),
    "no rest without force": ([0, 0, 0, 0, -0.5, -2, -3, -4, -5, -6], 10 * [1], []),
    "no motion": (10 * [0], [0, 0, 0, 1, 1, 1, 1, 1, 1, 1], []),
    "springs back": ([0, 0, 0, 0.2, 0.1, -0.5, -2, -3, -4, -5], [0, 0, 0, 1, 1, 1, 1, 1, 1, 1], []),
    "once, with a pause of the force": (
        [0, 0, 0, 0, 0, 0, 0, 2, 3, 4],
        [0, 0, 1, 1, 0, 0, 1, 1, 1, 1],
        [True],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_a_start(name: str) -> None:
    values, force, expected = CASES[name]
    time_s = 0.1 * np.arange(10)
    starts = list(starts_from_rest(time_s, np.array(force, float), np.array(values, float), 0.1, 1.0))
    assert [start.along for start in starts] == expected
    assert all(earlier.time_s < later.time_s for earlier, later in pairwise(starts))
