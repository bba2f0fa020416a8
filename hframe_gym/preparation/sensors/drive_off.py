"""Find rests in which a position does not follow its set point, as while a servo is switched off.

A drive that follows a set point rests where the set point is, but for the zero and scale of the sensor and
the error that friction leaves. While it is off, the machine rests where it was, whatever the set point says.
A simulation follows the set point throughout, so that such rows spoil every fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ...arrays import Array, Times
from ...machine import Machine
from ...recordings import Recording

_MIN_REST = 0.5  # s, without any change of set point or position; a drive may pause for a shorter time
_MIN_ROWS = 5
# Of the set points' span in all runs: what is no change of a set point or position. A sensor with more noise
# shows no rests.
_STILL = 0.005
# Fractions of the set points' span in all runs: rests where the machine followed agree within the first one,
# and the second one is far more than friction leaves.
_AGREES, _APART = 0.05, 0.1
_LARGEST_GAIN = 2.0  # of a position over its set point, or its inverse; another one is a wrong unit
_MOST_COMPARED = 40  # rests that may define the line of all; 780 lines
_MOST = 0.5  # of the rests that must agree; otherwise the drive is weak, and its rests tell nothing


class DriveOff(NamedTuple):
    """Rest in which a position does not follow its set point.

    Attributes:
        run: Name of the run.
        command: Channel of the set point.
        sensor: Channel of the position.
        first: Index of its first row.
        last: Index of its last row.
        apart: Distance of the position from where it rests at this set point otherwise, in the sensor's unit,
            m or rad.
    """

    run: str
    command: str
    sensor: str
    first: int
    last: int
    apart: float


class _Rest(NamedTuple):
    """Rows of a run in which nothing changes, with set point and position there."""

    run: int
    first: int
    last: int
    command: float
    position: float


def drives_off(recordings: Sequence[Recording], machine: Machine) -> list[DriveOff]:
    """Find the rests in which a drive that follows a commanded position seems to be switched off.

    Most rests must be on one line of the position over the set point.

    Args:
        recordings: Runs without unusable measurements.
        machine: Machine as declared.
    """
    found = []
    for i, drive in enumerate(machine.drives):
        for j, sensor in enumerate(machine.sensors):
            follows = drive.command == "position" and sensor.of_position
            if follows and not machine.belts and list(sensor.row) == [drive.coordinate]:
                for rest, apart in _away(recordings, i, j, sensor.row[drive.coordinate]):
                    run = recordings[rest.run].name
                    found.append(DriveOff(run, drive.channel, sensor.channel, rest.first, rest.last, apart))
    return found


def _away(
    recordings: Sequence[Recording], drive: int, sensor: int, scale: float
) -> list[tuple[_Rest, float]]:
    """Return the rests in which a position is not where most rests have it, and how far it is from there."""
    commands = [scale * recording.inputs[:, drive] for recording in recordings]
    span = float(np.ptp(np.concatenate(commands)))
    if not span:
        return []
    rests = [
        rest
        for k, (recording, values) in enumerate(zip(recordings, commands, strict=True))
        for rest in _rests(k, recording.time_s, values, recording.outputs[:, sensor], _STILL * span)
    ]
    if not rests:
        return []
    levels, positions = np.array([(rest.command, rest.position) for rest in rests]).T
    apart = _from_common_line(levels, positions, span)
    return [(rest, float(d)) for rest, d in zip(rests, apart, strict=True) if abs(d) > _APART * span]


def _from_common_line(commands: Array, positions: Array, span: float) -> Array:
    """Return how far each rest is from the line on which most of them are; 0 if there is no such line.

    The line has a gain, since the scale of a servo's angle is often only known to some percent.
    """
    apart = np.zeros(len(commands))
    best = _MOST * len(commands)
    for first, second in combinations(range(min(len(commands), _MOST_COMPARED)), 2):
        change = commands[second] - commands[first]
        gain = (positions[second] - positions[first]) / change if abs(change) > _APART * span else 0.0
        if not 1.0 / _LARGEST_GAIN < gain < _LARGEST_GAIN:
            continue
        distance = positions - positions[first] - gain * (commands - commands[first])
        agreeing = float(np.count_nonzero(np.abs(distance) < _AGREES * span))
        if agreeing > best:
            best, apart = agreeing, distance
    return apart


def _rests(run: int, time_s: Times, command: Array, position: Array, still: float) -> list[_Rest]:
    """Return the rests of a run: longest stretches of measured rows in which neither value changes."""
    measured = np.flatnonzero(np.isfinite(position))
    rests: list[_Rest] = []
    first = 0
    for k in range(1, len(measured) + 1):
        rows = measured[[first, min(k, len(measured) - 1)]]
        changed = max(abs(np.diff(command[rows])[0]), abs(np.diff(position[rows])[0])) > still
        if k < len(measured) and not changed:
            continue
        begin, end = int(measured[first]), int(measured[k - 1])
        if k - first >= _MIN_ROWS and time_s[end] - time_s[begin] >= _MIN_REST:
            rows = measured[first:k]
            rests.append(
                _Rest(run, begin, end, float(np.median(command[rows])), float(np.median(position[rows])))
            )
        first = k
    return rests


def without_drives_off(
    recordings: Sequence[Recording], machine: Machine
) -> tuple[list[Recording], list[DriveOff]]:
    """Leave out the measurements of positions while their drive is off.

    Args:
        recordings: Runs without unusable measurements.
        machine: Machine as declared.

    Returns:
        Runs without these measurements, and the rests of which they are.
    """
    found = drives_off(recordings, machine)
    cleaned = []
    for recording in recordings:
        outputs = recording.outputs.copy()
        for rest in found:
            if rest.run == recording.name:
                outputs[rest.first : rest.last + 1, machine.output_channels.index(rest.sensor)] = np.nan
        cleaned.append(dataclasses.replace(recording, outputs=outputs))
    return cleaned, found
