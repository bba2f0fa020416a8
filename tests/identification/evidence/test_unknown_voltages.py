"""Tests of what unknown voltages between the rows of a slow log may explain of the error."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.identification import Dataset, default_free_parameters, fit, prepare
from hframe_gym.identification.evidence.unknown_voltages import cost_beside_voltages, missed_motion
from hframe_gym.identification.predict.prediction import (
    NARROWEST_WITH_VOLTAGE_ERRORS,
    POLISH_STEP,
    SIMULATION,
    predict,
)
from hframe_gym.identification.predict.voltage_errors import with_voltage_errors
from hframe_gym.machine import BUILTIN_MACHINES
from tests.identification.controlled_runs import controlled_run, every, random_places

AXIS = BUILTIN_MACHINES["belt-axis"]()
UPDATES = 4  # of the voltage from one row of the log to the next


@cache
def slow_log() -> Dataset:
    """Return two logs with every fourth row of a controller."""
    recordings = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        angles = random_places(rng, 1500) / AXIS.coordinates[1].radius
        noise = rng.normal(0.0, [sensor.noise for sensor in AXIS.sensors], (1500, 2))
        run = controlled_run(f"run_{seed}", AXIS, angles, noise, window=60, gains=(10.0, 0.05))
        recordings.append(every(run, UPDATES))
    return with_voltage_errors(AXIS, prepare(recordings, AXIS).with_updates(UPDATES))


def measurements(change: str) -> list[Array]:
    """Return the measurements of all runs if something else acts between the rows than the log says."""
    data = slow_log()
    other = data.with_all_runs(interpolation="straight") if change == "straight lines" else data
    found = []
    for run, assumed in zip(other.runs, data.runs, strict=True):
        force = np.zeros((2, len(run.time_s), len(AXIS.coordinates)))
        inputs = np.tile(run.inputs, (2, 1, 1))
        if change == "a force":
            force[1, :, 0] = 0.1 * np.sin(60.0 * run.time_s)  # N, on the carriage
        if change == "answers":  # of a controller, Vs/rad, to the speed of the motor; means from row to row
            missed = missed_motion(AXIS, run, run.initial_state(AXIS), data.period)
            assert missed is not None
            inputs[1, :-1, 0] -= 0.1 * missed[0]
            run, assumed = (dataclasses.replace(each, updates=1) for each in (run, assumed))
        before, after = (
            predict(
                AXIS,
                each,
                SIMULATION,
                period=data.period,
                inputs=volts[None],
                extra_force=newtons[None],
                longest_step=POLISH_STEP,
            ).readings[0]
            for each, volts, newtons in zip((assumed, run), inputs, force, strict=True)
        )
        found.append(run.outputs + after - before)
    return found


@cache
def costs(change: str) -> tuple[float, float]:
    """Return the fitted axis's cost with such measurements, and what is left of it beside the voltages."""
    data = slow_log()
    outputs = measurements(change)
    runs = tuple(dataclasses.replace(r, outputs=o) for r, o in zip(data.runs, outputs, strict=True))
    data = dataclasses.replace(data, runs=runs)
    fitted = fit(AXIS, default_free_parameters(AXIS), data, NARROWEST_WITH_VOLTAGE_ERRORS)
    return fitted.cost, cost_beside_voltages(fitted, data)


@pytest.mark.parametrize(
    ("change", "least", "most"), [("straight lines", -0.1, 0.1), ("answers", 0.0, 0.5), ("a force", 0.9, 1.1)]
)
def test_unknown_voltages_explain_what_they_cause_and_no_other_force(
    change: str, least: float, most: float
) -> None:
    """Answers of the controller are known by their means from row to row only."""
    (logged, known), (cost, beside) = costs(""), costs(change)
    assert cost > logged + 30.0
    assert least < (beside - known) / (cost - logged) < most


def test_nothing_is_known_of_a_machine_that_diverges() -> None:
    data = slow_log()
    fitted = fit(AXIS, default_free_parameters(AXIS), data, NARROWEST_WITH_VOLTAGE_ERRORS)
    unstable = AXIS.replace({"x.viscous": -1e4})
    assert np.isnan(
        cost_beside_voltages(dataclasses.replace(fitted, machine=unstable, free=(), theta=np.zeros(0)), data)
    )
