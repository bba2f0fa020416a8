"""Find runs in another unit than the others: in their times, in the travel of a sensor, or in an input.

A unit that is wrong in all runs contradicts the machine file (`check_scales`). One that is wrong in some runs
contradicts the other runs, whatever the machine file says: one machine has one ratio of its sensors, and one
logger seldom has rates that differ much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..arrays import Array
from ..identification import Dataset, PreparedRecording
from ..machine import Machine
from ..recordings import Recording, peak_to_peak
from .findings import Finding
from .span_motion import MIN_ROWS, correlation
from .wiring import rigid_prediction

# Smallest factor between units that are confused, that of inches and millimeters; rates and inputs of one
# session may differ by less.
_UNIT = 25.0
# Ratio between the travel ratio of two sensors in one run and that in the others; belts stretch by less.
_TRAVEL = 1.5
_CORRELATION = 0.9  # of two sensors, above which their ratio is determined
# Fraction of the speed in other runs with which a machine moves as fast as there.
_AS_FAST = 0.5


def check_rates(recordings: Sequence[Recording]) -> list[Finding]:
    """Report, as advice, runs whose times may be in another unit than those of the other runs.

    Their sampling rate is more than 25 times, or less than 1/25, of the median of the others.
    """
    periods = np.array([np.median(np.diff(r.time_s)) if len(r.time_s) > 1 else np.nan for r in recordings])
    findings = []
    for i, recording in enumerate(recordings):
        usual = _of_others(periods, i)
        if not np.isfinite(periods[i]) or not np.isfinite(usual):
            continue
        if abs(math.log(periods[i] / usual)) > math.log(_UNIT):
            message = (
                f"is sampled at {1 / periods[i]:.4g} Hz, the other runs at {1 / usual:.4g} Hz: "
                "are its times in another unit?"
            )
            findings.append(Finding("advice", recording.name, "time_s", message))
    return findings


def check_travel_of_runs(data: Dataset, machine: Machine) -> list[Finding]:
    """Report, as faults, sensors whose travel in one run is in another unit than in the other runs.

    The ratio of a sensor's travel to that which the other sensors measure is a constant of the machine; in
    such a run, it differs from that in the others by a factor of more than 1.5. One sensor is named for each
    run: that whose travel differs most from its travel in the other runs.

    Args:
        data: Runs prepared for a fit.
        machine: Machine as declared, whose sensors are all of positions.
    """
    sensors = range(len(machine.sensors))
    ratios = np.array([[_travel_ratio(run, machine, j) for j in sensors] for run in data.runs])
    travel = np.array([peak_to_peak(run.outputs) for run in data.runs])
    findings = []
    for i, run in enumerate(data.runs):
        usual = np.array([_of_others(ratios[:, j], i) for j in sensors])
        apart = [j for j in sensors if abs(math.log(ratios[i, j] / usual[j])) > math.log(_TRAVEL)]
        if apart:
            # A sensor may rest in this run or in most of the others.
            logarithms = np.log(np.maximum(travel, np.finfo(float).tiny))
            change = {j: abs(_of_others(logarithms[:, j], i) - logarithms[i, j]) for j in apart}
            j = max(apart, key=change.__getitem__)
            message = (
                f"moves {ratios[i, j]:.3g} times as far as other sensors measure, and {usual[j]:.3g} times "
                "in the other runs: it, or they, have another unit in this run. Correct the unit of this log"
            )
            findings.append(Finding("fault", run.name, machine.sensors[j].channel, message))
    return findings


def check_inputs_of_runs(data: Dataset, machine: Machine) -> list[Finding]:
    """Report, as advice, runs whose inputs are too small for their motion, as in another unit.

    Relative to the rated ones, the largest input is less than 1/25 of the median of the other runs; the run
    begins at rest, and a sensor moves more than half as fast as in the others.
    """
    rated = np.array([drive.rated_voltage for drive in machine.drives])
    levels = np.array([np.max(np.abs(run.inputs) / rated) for run in data.runs])
    speeds = np.array([_speeds(run, machine) for run in data.runs])
    findings = []
    for i, run in enumerate(data.runs):
        usual = _of_others(levels, i)
        usual_speeds = np.array([_of_others(speeds[:, j], i) for j in range(speeds.shape[1])])
        as_fast = bool(np.any(speeds[i] > _AS_FAST * usual_speeds))
        if not 0.0 < _UNIT * levels[i] < usual or run.initial.velocity.any() or not as_fast:
            continue
        inputs = " and ".join(machine.input_channels)
        factor = float(f"{usual / levels[i]:.2g}")
        message = (
            f"is {factor:,.0f} times smaller than in the other runs, but the machine, which begins at rest, "
            "moves as fast: does this log have another unit, or does a load move the machine?"
        )
        findings.append(Finding("advice", run.name, inputs, message))
    return findings


def _of_others(values: Array, run: int) -> float:
    """Return the median of a value over the other runs; NaN if none has it."""
    others = np.delete(values, run)
    others = others[np.isfinite(others)]
    return float(np.median(others)) if len(others) else math.nan


def _travel_ratio(run: PreparedRecording, machine: Machine, sensor: int) -> float:
    """Return the measured travel over that which other sensors predict; NaN if they do not determine it."""
    prediction = rigid_prediction(run.outputs, sensor, machine)
    if prediction is None:
        return math.nan
    both = np.column_stack([run.outputs[:, sensor], prediction[0]])
    both = both[np.isfinite(both).all(axis=1)]
    if len(both) < MIN_ROWS:
        return math.nan
    measured, predicted = (both - both.mean(axis=0)).T
    if not measured.any() or not predicted.any() or correlation(measured, predicted) <= _CORRELATION:
        return math.nan
    return float(np.std(measured) / np.std(predicted))


def _speeds(run: PreparedRecording, machine: Machine) -> Array:
    """Return the span of each sensor, that of a position over the duration of the run, shape (sensors,)."""
    seconds = np.where(machine.position_sensors, run.time_s[-1] - run.time_s[0], 1.0)
    return np.asarray(peak_to_peak(run.outputs) / seconds)
