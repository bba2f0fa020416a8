"""Find wrong scales: units and gear ratios of the outputs, and the unit of time.

A factor between measured and simulated motion may come from the column (turns instead of radians) or from the
machine file (another gain). It is a fault only if another sensor decides between them, or if the factor is
that of a unit and, with it, inertia and friction agree with the machine file as well. Otherwise it is advice.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..identification import Dataset
from ..machine import Machine, Sensor
from ..preparation.forces.force_balance import EXPLAINED, Balance
from ..preparation.sensors.noise import sensor_quantum
from .findings import Finding, channel_unit
from .span_motion import MIN_ROWS, SpanMotion, correlation, span_motion
from .time_unit import check_time_unit
from .travel_ratios import check_travel_ratios
from .wiring import declared_balance, rigid_prediction

_SPEED_FACTOR = 8.0  # factor between measured and simulated speed beyond which a unit is always suspected
# A smaller factor is suspected if it is that of a unit in every run, and if inertia and friction need the
# same factor, since a spring slows a motion, too. It may be off by 1.5: motors are specified within some
# 20 %, and friction slows small motions.
_NEAR_UNIT = 1.5
# Factor between the motion of a channel and what the others predict for it, beyond which they contradict it.
_CONTRADICTION = 4.0
# Factor between measured and expected, beyond that of a unit, that a machine file may cause.
_UNIT_TOLERANCE = 2.0
_STEP_TOLERANCE = 0.05  # relative error of a step that is found from the differences between rows
_CAUSE = "is its unit or gain wrong, or are the file's masses and motor constants guesses?"
_LESS_VOLTAGE = "is it blocked, or does less than the recorded voltage act (amplifier limit, emergency stop)?"
# Suspected unit by the unit of the channel: value per m or rad, and its name.
_SUSPECTS = {
    "m": ((1000.0, "millimeters"), (100.0, "centimeters"), (1000.0 / 25.4, "inches"), (0.001, "kilometers")),
    "rad": ((180 / math.pi, "degrees"), (0.5 / math.pi, "turns")),
}
_FEWEST_COUNTS = 800  # per turn, of encoders in use; fewer cannot be told from degrees
_SPEED_CORRELATION = 0.9  # of a column that is a speed with the simulated speed
_POSITION_CORRELATION = 0.5  # largest correlation of its changes with the simulated speed


def check_scales(data: Dataset, machine: Machine) -> list[Finding]:
    """Report channels with a wrong unit or gear ratio, or else times in a wrong unit.

    For units, measured speeds are compared with those of a simulation with the recorded voltages; for gear
    ratios, encoders with other sensors (`check_travel_ratios`); for times, fitted inertia and friction with
    the declared ones (`check_time_unit`). If the times are suspect, nothing else is reported.

    Returns:
        Findings about all runs together. A speed that a unit explains, or that differs from the simulated one
        by a factor of more than 8, is a fault if the other sensors contradict it by a factor of 4, or if none
        measures the motion and inertia and friction need the same factor; otherwise it is advice, since the
        machine file may be wrong.
    """
    balance = declared_balance(data, machine)
    clock = check_time_unit(data, balance)
    if clock:
        return clock  # a wrong clock makes all speeds wrong
    motion = span_motion(data, machine)
    units = _units(motion, data, machine, balance)
    # A wrong unit of one channel makes the ratios of others wrong as well.
    ratios = (
        []
        if any(finding.severity == "fault" for finding in units)
        else check_travel_ratios(motion, data, machine)
    )
    contradicted = {ratio.channel for ratio in ratios if ratio.severity == "fault"}
    named = {unit.channel for unit in units}
    return [unit for unit in units if unit.channel not in contradicted] + [
        ratio for ratio in ratios if ratio.severity == "fault" or ratio.channel not in named
    ]


def _units(motion: SpanMotion, data: Dataset, machine: Machine, balance: Balance | None) -> list[Finding]:
    """Report channels whose measured speed is a multiple of the simulated one, and speeds as positions.

    This is a fault if the other channels contradict the channel too, or if no other channel measures the
    motion and everything agrees with the factor of a unit. Otherwise the machine file may be wrong, and the
    finding is advice.
    """
    findings = []
    for j, sensor in enumerate(machine.sensors):
        factor = motion.speed_ratio(j)
        unit = channel_unit(sensor.channel, machine)
        if _is_speed(motion, j):
            speed_unit = "rpm" if unit == "rad" else "mm/s"
            message = (
                "looks like a speed, not like a position: it follows the simulated speed. "
                f"Convert it, for example by hframe import FILE --unit {sensor.channel}={speed_unit}; "
                "a spring or a weight that the machine file lacks looks alike in slow motion"
            )
            findings.append(Finding("advice", "", sensor.channel, message))
            continue
        resting = factor < 1 and _is_resting(motion.measured[:, j], data, j)
        suspect = _suspect(factor, unit, sensor.resolution)
        if not factor or resting:
            continue
        if not _is_extreme(factor) and not (
            suspect and _in_every_run(motion, j, suspect[0]) and _agrees(balance, suspect[0])
        ):
            continue
        prediction = rigid_prediction(motion.measured, j, machine)
        steps = _steps(sensor, data, j)
        if prediction is None:
            certain = (
                suspect is not None
                and _is_extreme(factor)
                and _agrees(balance, suspect[0])
                and not _same_step(steps, 1.0)
            )
        else:
            both = np.isfinite(motion.measured[:, j]) & np.isfinite(prediction[0])
            expected = float(np.std(prediction[0][both])) if both.any() else 0.0
            ratio = float(np.std(motion.measured[both, j])) / expected if expected else 1.0
            certain = not 1 / _CONTRADICTION < ratio < _CONTRADICTION
            if not certain and not _is_extreme(factor):
                continue  # other sensors agree with it
        message = _describe_factor(factor, suspect, unit, data, steps)
        findings.append(Finding("fault" if certain else "advice", "", sensor.channel, message))
    return findings


def _describe_factor(
    factor: float, suspect: tuple[float, str] | None, unit: str, data: Dataset, steps: float
) -> str:
    """Return a sentence about a channel that moves faster or slower than simulated.

    Args:
        factor: Measured over simulated speed, dimensionless.
        suspect: Value per m or rad and name of the unit that the column may have.
        unit: Declared unit.
        steps: Steps of the column over the declared resolution, dimensionless; 0 if unknown.
    """
    if not suspect:
        if factor < 1:
            slower = f"{float(f'{1 / factor:.2g}'):,.{0 if factor < 0.1 else 1}f}"
            cause = f"{_CAUSE[:-1]}, {_LESS_VOLTAGE}"
            return f"moves {slower} times slower than a simulation with the machine file: {cause}"
        return f"moves {factor:.3g} times as fast as a simulation with the machine file: {_CAUSE}"
    value, name = suspect
    speed = f"{factor:.3g} times as fast as" if factor > 1 else f"{1 / factor:.3g} times slower than"
    where = f" in all {len(data.runs)} runs" if len(data.runs) > 1 else ""
    of_file = "a gain, a mass or a gear ratio of the machine file is wrong"
    moves = f"moves {speed} the machine simulates{where}"
    if _same_step(steps, 1.0):
        return (
            f"{moves}, and its steps are those of the declared resolution, in {unit}: {of_file}; "
            f"the column may be in {name} only if that resolution is wrong as well"
        )
    multiply = f"multiply it by {1 / value:.4g}"
    if _same_step(steps, value):
        multiply += ", which makes its steps those of the declared resolution"
    return f"{moves}: is the column in {name}, not in {unit}? Then {multiply}; otherwise {of_file}"


def _steps(sensor: Sensor, data: Dataset, j: int) -> float:
    """Return the steps of a column over the declared resolution; 0 if one of them is unknown."""
    steps = sensor_quantum([run.outputs[:, j] for run in data.runs], 0.0)
    return steps / sensor.resolution if sensor.resolution > 0.0 else 0.0


def _same_step(steps: float, value: float) -> bool:
    """Return whether steps over the declared resolution are those of a unit with a value per m or rad."""
    return abs(steps - value) < _STEP_TOLERANCE * value


def _is_extreme(factor: float) -> bool:
    """Return whether a factor between measured and simulated speed is beyond what a machine file explains."""
    return not 1 / _SPEED_FACTOR < factor < _SPEED_FACTOR


def _suspect(factor: float, unit: str, resolution: float) -> tuple[float, str] | None:
    """Return value and name of the unit that explains a factor between measured and simulated speed.

    The simulated speed is only as right as the machine file: where possible, counts are those of the
    `resolution`.
    """
    if factor <= 0.0:
        return None
    candidates = list(_SUSPECTS[unit])
    counts = 2 * math.pi * factor  # per turn
    if resolution > 0.0 and abs(math.log(factor * resolution)) < math.log(_UNIT_TOLERANCE):
        candidates.append((1.0 / resolution, "counts of an encoder, of the declared resolution"))
    elif unit == "rad" and counts > _FEWEST_COUNTS:
        candidates.append((factor, f"counts of an encoder (about {counts:.2g} per turn)"))
    tolerance = _UNIT_TOLERANCE if _is_extreme(factor) else _NEAR_UNIT
    value, name = min(candidates, key=lambda candidate: abs(math.log(factor / candidate[0])))
    return (value, name) if abs(math.log(factor / value)) < math.log(tolerance) else None


def _in_every_run(motion: SpanMotion, sensor: int, value: float) -> bool:
    """Return whether a sensor's speed differs from the simulated one by a unit's factor in every run."""
    return all(
        abs(math.log(ratio / value)) < math.log(_UNIT_TOLERANCE)
        for ratio in motion.speed_ratios_by_run(sensor)
    )


def _agrees(balance: Balance | None, value: float) -> bool:
    """Return whether inertia and friction agree with the machine file after division by a value."""
    if balance is None or balance.unexplained > EXPLAINED:
        return False
    ratios = value * np.concatenate([balance.inertia, balance.viscous])
    ratios = ratios[np.isfinite(ratios)]
    return bool(len(ratios)) and bool(np.all((ratios > 1 / _UNIT_TOLERANCE) & (ratios < _UNIT_TOLERANCE)))


def _is_speed(motion: SpanMotion, sensor: int) -> bool:
    """Return whether a column follows the simulated speed of its sensor, and its changes do not."""
    rows = np.isfinite(motion.measured[:, sensor]) & np.isfinite(motion.values[:, sensor])
    columns = (motion.values[rows, sensor], motion.measured[rows, sensor], motion.simulated[rows, sensor])
    if np.count_nonzero(rows) < MIN_ROWS or not all(column.any() for column in columns):
        return False
    value, change, speed = columns
    return (
        correlation(value, speed) > _SPEED_CORRELATION and correlation(change, speed) < _POSITION_CORRELATION
    )


def _is_resting(changes: Array, data: Dataset, channel: int) -> bool:
    """Return whether changes of a channel are within its noise and quantum."""
    return bool(np.ptp(changes) < max(10 * data.noise[channel], 3 * data.quantum[channel]))
