"""Tests of the check for voltages that are logged one row late."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.data_validation import check_before_fit
from hframe_gym.data_validation.sampling import check_input_timing
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import prepare
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Machine
from hframe_gym.recordings import Recording

DECLARED = BUILTIN_MACHINES["hframe"]()
AXIS = BUILTIN_MACHINES["axis"]()
# The rig is not the declared machine.
RIG = DECLARED.replace({"x.mass": 4.5, "x.coulomb": 2.6, "y.viscous": 20.0})


def recordings(machine: Machine, late: int) -> list[Recording]:
    """Return runs with random voltage steps whose inputs are logged some rows late."""
    rng = np.random.default_rng(1)
    runs = []
    for k in range(4):
        time_s = np.arange(1200) * 1e-3
        inputs = np.repeat(rng.uniform(-5.0, 5.0, (24, 2)), 50, axis=0)
        inputs[:100] = 0.0
        motion = machine.simulate(time_s, inputs)
        outputs = motion.outputs + rng.normal(0.0, [2e-4, 2e-4, 2e-5, 2e-5], motion.outputs.shape)
        logged = np.vstack([np.zeros((late, 2)), inputs[: len(inputs) - late]])
        runs.append(Recording(f"run_{k}", time_s, logged, outputs))
    return runs


def late_findings(machine: Machine, late: int) -> list[str]:
    """Return the faults about late voltages."""
    findings = check_before_fit(recordings(machine, late), DECLARED)
    return [f.message for f in findings if f.severity == "fault" and "one row late" in f.message]


def test_voltages_that_are_logged_one_row_late_are_a_fault() -> None:
    (message,) = late_findings(RIG, 1)
    assert message.startswith("v1_V and v2_V are logged one row late")
    assert "Shift the voltages up by one row and delete the last row" in message


@pytest.mark.parametrize(
    "effect",
    [
        None,
        EFFECTS["input_delay"].at("drives", d=2e-3),
        EFFECTS["electrical_lag"].at("drives", tau=2e-3),
        EFFECTS["stribeck_friction"].at("x", dF=3.0, vs=0.02),
    ],
)
def test_voltages_that_act_when_they_are_logged_are_no_fault(effect: AppliedEffect | None) -> None:
    machine = RIG if effect is None else RIG.with_effects(effect)
    assert late_findings(machine, 0) == []


def with_hidden_mass(noise: float, late: int, controlled: bool = False) -> list[Recording]:
    """Return runs of an axis that carries a second mass on a spring which slips, simulated here step by step.

    Args:
        noise: Standard deviation of the measured position, m.
        late: Rows by which the voltage is logged late.
        controlled: Whether a PD controller of the measured position determines the voltages.
    """
    coordinate, drive = AXIS.coordinates[0], AXIS.drives[0]
    mass, stiffness, damping, limit, step = 0.3, 20_000.0, 15.0, 1.0, 1e-4  # kg, N/m, N s/m, N, s
    viscous = coordinate.viscous + drive.gain * drive.Ke * drive.gear_ratio
    rng = np.random.default_rng(1)
    runs = []
    for k in range(3):
        volts = np.repeat(rng.uniform(-3.0, 3.0, 120), 10)
        volts[:100] = 0.0
        goals = np.repeat(volts[::50] / 150.0, 50)  # m
        errors = rng.normal(0.0, noise, len(volts))
        position = speed = hidden_speed = stretch = 0.0
        positions = np.zeros(len(volts))
        for n, error in enumerate(errors):
            positions[n] = position + error
            if controlled:
                measured_speed = (positions[n] - positions[max(n - 1, 0)]) / 1e-3
                volts[n] = np.clip(300.0 * (goals[n] - positions[n]) - 5.0 * measured_speed, -3.0, 3.0)
            for _ in range(10):
                relative = hidden_speed - speed
                stretch = float(np.clip(stretch + step * relative, -limit / stiffness, limit / stiffness))
                coupling = stiffness * stretch + damping * relative
                friction = coordinate.coulomb * np.tanh(speed / 1e-3) + viscous * speed
                speed += step * (drive.gain * volts[n] - friction + coupling) / coordinate.mass
                hidden_speed -= step * coupling / mass
                position += step * speed
        logged = np.concatenate([np.zeros(late), volts[: len(volts) - late]])[:, None]
        runs.append(Recording(f"run_{k}", np.arange(len(volts)) * 1e-3, logged, positions[:, None]))
    return runs


def timing_findings(recordings: list[Recording]) -> list[tuple[str, str]]:
    """Return severity and message of the findings about late voltages of recordings of the axis."""
    return [
        (f.severity, f.message) for f in check_before_fit(recordings, AXIS) if "one row late" in f.message
    ]


@pytest.mark.parametrize("noise", [1e-6, 15e-6])
def test_a_missing_mass_is_no_fault_of_the_recordings(noise: float) -> None:
    ((severity, message),) = timing_findings(with_hidden_mass(noise, late=0))
    assert severity == "advice"
    assert message.startswith("v_V may be logged one row late, or the machine lacks a force or a mass")


def test_late_voltages_are_a_fault_beside_a_missing_mass() -> None:
    ((severity, _),) = timing_findings(with_hidden_mass(1e-6, late=1))
    assert severity == "fault"


def test_a_controller_whose_voltages_depend_on_the_measurements_of_their_row_is_no_fault() -> None:
    """Noise that is fed back correlates with the voltage of its row, against the direction of the drive."""
    (finding,) = timing_findings(with_hidden_mass(15e-6, late=0, controlled=True))
    assert finding[0] == "advice"
    assert finding[1].startswith("v_V may be logged one row late")


def test_late_voltages_of_a_controller_are_a_fault() -> None:
    ((severity, _),) = timing_findings(with_hidden_mass(1e-6, late=1, controlled=True))
    assert severity == "fault"


@pytest.mark.parametrize("every", [20, 10_000])
def test_late_voltages_are_a_fault_although_a_sensor_measures_rarely_or_never(every: int) -> None:
    runs = recordings(RIG, 1)
    for run in runs:
        run.outputs[np.arange(len(run.time_s)) % every != 1, 3] = np.nan
    (finding,) = check_input_timing(prepare(runs, DECLARED), DECLARED)
    assert finding.severity == "fault"


def test_late_voltages_are_advised_if_every_sensor_is_slow() -> None:
    """No four successive rows show what a measurement depends on."""
    runs = recordings(RIG, 1)
    for run in runs:
        run.outputs[np.arange(len(run.time_s)) % 5 > 0] = np.nan
    (finding,) = check_input_timing(prepare(runs, DECLARED), DECLARED)
    assert finding.severity == "advice"


def test_a_delay_that_is_declared_too_long_is_no_fault_of_the_recordings() -> None:
    declared = DECLARED.with_effects(EFFECTS["input_delay"].at("drives", d=2e-3))
    findings = check_before_fit(recordings(RIG, 0), declared)
    assert [f.message for f in findings if f.severity == "fault"] == []


def test_measurements_that_are_taken_within_a_row_are_no_fault() -> None:
    """The sensor is read 0.6 rows after its row: neither the logged nor the shifted voltages fit."""
    rng = np.random.default_rng(5)
    runs = []
    for k in range(3):
        time_s = np.arange(6000) * 2e-4
        inputs = np.repeat(rng.uniform(-3.0, 3.0, 120), 50)[:, None]
        inputs[:500] = 0.0
        outputs = AXIS.simulate(time_s, inputs).outputs + rng.normal(0.0, 1e-6, (6000, 1))
        runs.append(Recording(f"run_{k}", time_s[:-5:5], inputs[:-5:5], outputs[3:-2:5]))
    ((severity, message),) = timing_findings(runs)
    assert severity == "advice"
    assert message.startswith("v_V may be logged one row late")
