"""Find speeds that contradict the sensors of positions (unit, scale, sign, swapped), or repeat them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from ..arrays import Array
from ..machine import Machine
from ..preparation.forces.contradicted_sensors import forces_decide
from ..preparation.sensors.contradicted_speeds import contradicted_speeds
from ..preparation.sensors.noise import sensor_quantum
from ..recordings import Recording
from .findings import Finding
from .wiring import REMEDY, rigid_prediction

# Fraction of a run over which motions are compared: long enough for filters of speeds and steps of positions,
# short enough that an offset of the speed does not add up.
_WINDOW = 0.1
_MIN_WINDOWS = 20  # that a ratio needs, all runs together
_LARGEST_RATIO = 1.5  # of speeds; a tachometer may be wrong by 20 %, and identification finds that
# Difference between a speed and the change of a position from row to row, relative to the rounding error of
# that change: a speed that was measured by itself differs by all of it, one that was computed from the same
# counts by the digits of the log.
_SAME = 0.3
_CORRELATION = 0.9  # below it, something else than a factor is wrong, or the motion is too fast for the log


def check_speeds(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report, as faults, sensors of signed speeds that measure a multiple of the rate of the positions.

    The multiple is negative, or differs from 1 by a factor of more than 1.5. Two speeds are swapped if
    neither is the rate of the positions at its sensor and both are after an exchange.
    """
    speeds = [j for j, sensor in enumerate(machine.sensors) if sensor.of_velocity]
    positions = machine.position_sensors
    if not speeds or not positions.any():
        return []
    integrated = machine.replace(effects=()).with_components(
        *(dataclasses.replace(machine.sensors[j], kind="encoder") for j in speeds)
    )
    ratios = {j: _ratio(recordings, j, positions, integrated) for j in speeds}
    wrong = [j for j in speeds if not _agrees(ratios[j])]
    findings = []
    for first, second in combinations(wrong, 2):
        exchanged = [_with_exchanged(recording, first, second) for recording in recordings]
        if all(_agrees(_ratio(exchanged, j, positions, integrated)) for j in (first, second)):
            names = f"{machine.sensors[first].channel} and {machine.sensors[second].channel}"
            findings.append(Finding("fault", "", "", f"{names} are swapped: {REMEDY}"))
            ratios |= dict.fromkeys((first, second))
    return findings + [_finding(machine, j, ratio) for j in wrong if (ratio := ratios[j]) is not None]


def _ratio(
    recordings: Sequence[Recording], speed: int, positions: NDArray[np.bool_], machine: Machine
) -> float | None:
    """Return how many times the rate of the positions a speed is; None if it is no multiple of it."""
    parts = [_changes(recording, speed, positions, machine) for recording in recordings]
    measured, expected = np.concatenate(parts).T
    power = float(np.sqrt((measured @ measured) * (expected @ expected)))
    if len(measured) < _MIN_WINDOWS or not power or abs(measured @ expected) < _CORRELATION * power:
        return None
    return float(measured @ expected / (expected @ expected))


def _agrees(ratio: float | None) -> bool:
    """Return whether a speed is the rate of the positions, but for a small error of its scale."""
    return ratio is not None and 1.0 / _LARGEST_RATIO < ratio < _LARGEST_RATIO


def _with_exchanged(recording: Recording, first: int, second: int) -> Recording:
    """Return a recording with two of its outputs exchanged."""
    order = np.arange(recording.outputs.shape[1])
    order[[first, second]] = second, first
    return dataclasses.replace(recording, outputs=recording.outputs[:, order])


def _changes(recording: Recording, speed: int, positions: NDArray[np.bool_], machine: Machine) -> Array:
    """Return integrals of a speed over parts of a run, and those that positions predict, shape (parts, 2)."""
    values = recording.outputs[:, speed]
    rows = np.flatnonzero(np.isfinite(values))
    prediction = rigid_prediction(np.where(positions, recording.outputs, np.nan), speed, machine)
    if prediction is None or len(rows) < 2:
        return np.zeros((0, 2))
    time_s, expected = recording.time_s[rows], prediction[0][rows]
    travel = cumulative_trapezoid(values[rows], time_s, initial=0.0)
    known = np.isfinite(expected)
    if np.count_nonzero(known) < 2:
        return np.zeros((0, 2))
    window = max(1, round(_WINDOW * len(rows)))
    both = np.column_stack([travel, np.interp(time_s, time_s[known], expected[known])])
    return (both[window:] - both[:-window])[:: max(1, window // 4)]


def _finding(machine: Machine, speed: int, ratio: float) -> Finding:
    """Return the finding about a sensor of speeds that measures a multiple of the speed of the positions."""
    channel = machine.sensors[speed].channel
    others = ", ".join(sensor.channel for sensor in machine.sensors if sensor.of_position)
    verb = "change" if "," in others else "changes"
    message = (
        f"is {ratio:.3g} times the speed at which {others} {verb}: "
        "a unit, scale or gear ratio of one of them is wrong. If it is that of the speed: "
        f"hframe import FILE --scale {channel}={1.0 / ratio:.4g} (times its present factor)"
    )
    return Finding("fault", "", channel, message)


def check_speeds_in_parts(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report, as advice, parts of runs in which a speed is a multiple of the rate of a position.

    Identification leaves out one of the two sensors.
    """
    findings = []
    left_out = (
        "the sensor whose motion follows less from the commands" if forces_decide(machine) else "the speed"
    )
    for part in contradicted_speeds(recordings, machine):
        message = (
            f"is {part.ratio:.3g} times the speed at which {part.position} changes in rows {part.first + 1} "
            f"to {part.last + 1}, but not in other parts: the scale of one of the two sensors changes. "
            f"Identification leaves out {left_out}. If you know "
            f"which is wrong: hframe import FILE --map {part.speed}=none, or --map {part.position}=none"
        )
        findings.append(Finding("advice", part.run, part.speed, message))
    return findings


def check_computed_speeds(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report, as advice, speeds that are the change of an encoder's counts from row to row.

    Such a speed says nothing that the counts do not: it is late by half a row, and its rounding error, which
    is that of two counts, is not independent of theirs.
    """
    findings = []
    for j, speed in enumerate(machine.sensors):
        for k, position in enumerate(machine.sensors):
            if not (speed.of_velocity and position.of_position and list(speed.row) == list(position.row)):
                continue
            coordinate = next(iter(speed.row))
            ratio = speed.row[coordinate] / position.row[coordinate]
            quantum = sensor_quantum([r.outputs[:, k] for r in recordings], position.resolution)
            parts = [_differences(r, j, k, ratio, quantum) for r in recordings]
            differences = np.concatenate([part for part, _ in parts])
            rounding = np.concatenate([error for _, error in parts])
            if len(differences) < _MIN_WINDOWS or not np.median(np.abs(differences)) < _SAME * np.median(
                rounding
            ):
                continue
            period = float(np.median(np.concatenate([np.diff(r.time_s) for r in recordings])))
            message = (
                f"is the change of {position.channel} from row to row, so that it tells nothing new: it is "
                f"{500 * period:.3g} ms late and rounded twice. Leave it out: hframe import FILE --map "
                f"{speed.channel}=none, or delete the sensor in machine.json"
            )
            findings.append(Finding("advice", "", speed.channel, message))
    return findings


def _differences(
    recording: Recording, speed: int, position: int, ratio: float, quantum: float
) -> tuple[Array, Array]:
    """Return speed minus change of position, and the rounding error of this change, rad/s or m/s, (rows,).

    Rows in which the position rests are left out; there are none if the position has no `quantum`, m or rad.
    """
    steps = np.diff(recording.time_s)
    change = ratio * np.diff(recording.outputs[:, position]) / steps
    differences = recording.outputs[1:, speed] - change
    used = np.isfinite(differences) & (change != 0.0) & (quantum > 0.0)
    return differences[used], abs(ratio) * quantum / np.sqrt(6.0) / steps[used]
