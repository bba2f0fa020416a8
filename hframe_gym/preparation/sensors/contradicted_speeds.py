"""Find parts of runs in which a speed is a multiple of the rate of the position at the same coordinate.

A multiple in all runs is a wrong unit or scale, which `hframe check` reports as a fault. In a part of a run,
a counter was read twice, an encoder loses pulses in a part of its turn, or a gear was shifted: one of the two
sensors is wrong there, and nothing about the sensors tells which. The drives' forces do: the motion that one
of them measures follows from the commands, that of the other one only in part.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import median_filter

from ...arrays import Array
from ...errors import name_runs
from ...machine import Machine, Sensor
from ...recordings import Recording, comparison_window
from ..dataset import PreparedRecording
from ..forces.force_balance import SPANS, force_balance
from ..forces.integrated_speeds import with_integrated_speeds
from ..forces.motion_windows import motion_windows

PARTS = 20  # of a run, whose motions are compared: long enough for the filter of a speed
MIN_PARTS = 5  # in a row with the same ratio; the lag of a filter spoils the ratio of one or two after a step
_LARGEST_RATIO = 1.5  # a tachometer may be wrong by 20 %, and identification finds that
_MOVES = 0.1  # of a large motion (the 90th percentile) in all parts; a ratio of less is that of noise
_SCATTER = (
    0.2  # of the logarithm of the ratio about its median, as a median; a lag has all ratios from 0 to 1
)
_MEDIAN = 5  # parts over which the ratio is smoothed, so that one outlier does not divide a part


class ContradictedSpeed(NamedTuple):
    """Part of a run in which a speed is a multiple of the rate of a position.

    Attributes:
        run: Name of the run.
        speed: Channel of the speed.
        position: Channel of the position.
        first: Index of its first row.
        last: Index of its last row.
        ratio: Speed over rate of the position there, dimensionless.
    """

    run: str
    speed: str
    position: str
    first: int
    last: int
    ratio: float


def contradicted_speeds(recordings: Sequence[Recording], machine: Machine) -> list[ContradictedSpeed]:
    """Find the parts of runs in which a speed is a multiple of the rate of the position beside it.

    Nothing is found if the ratio is the same in all parts: only a unit or scale is wrong then.

    Args:
        recordings: Runs without unusable measurements.
        machine: Machine as declared.
    """
    found = []
    for speed in machine.sensors:
        for position in machine.sensors:
            if speed.of_velocity and position.of_position and list(speed.row) == list(position.row):
                found += _of_pair(recordings, speed, position, machine)
    return found


def _of_pair(
    recordings: Sequence[Recording], speed: Sensor, position: Sensor, machine: Machine
) -> list[ContradictedSpeed]:
    """Return the parts in which a speed contradicts a position of the same coordinate."""
    if len(speed.row) > 1:
        return []
    coordinate = speed.coordinate
    scale = speed.row[coordinate] / position.row[coordinate]
    channels = [machine.output_channels.index(sensor.channel) for sensor in (speed, position)]
    motions = [_motions(recording, *channels, scale) for recording in recordings]
    sizes = np.concatenate([np.abs(changes).max(axis=1) for _, changes in motions])
    if not len(sizes):
        return []
    smallest = _MOVES * float(np.percentile(sizes, 90))
    found, agree = [], 0
    for recording, (rows, changes) in zip(recordings, motions, strict=True):
        moves = (np.abs(changes) > smallest).all(axis=1) & (changes[:, 0] * changes[:, 1] > 0.0)
        rows, changes = rows[moves], changes[moves]
        if len(rows) < MIN_PARTS:
            continue
        ratios = np.log(changes[:, 0] / changes[:, 1])
        differ = np.abs(median_filter(ratios, size=_MEDIAN, mode="nearest")) > np.log(_LARGEST_RATIO)
        agree += int(np.count_nonzero(~differ))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], differ.astype(int), [0]]))).reshape(-1, 2)
        for first, end in edges:
            median = float(np.median(ratios[first:end]))
            if end - first < MIN_PARTS or np.median(np.abs(ratios[first:end] - median)) > _SCATTER:
                continue
            first_row, last_row = int(rows[first, 0]), int(rows[end - 1, 1])
            found.append(
                ContradictedSpeed(
                    recording.name,
                    speed.channel,
                    position.channel,
                    first_row,
                    last_row,
                    float(np.exp(median)),
                )
            )
    return found if agree >= MIN_PARTS else []


def _motions(recording: Recording, speed: int, position: int, scale: float) -> tuple[Array, Array]:
    """Return the rows and the motions of the parts of a run.

    Returns:
        First and last row of each part, shape (parts, 2), and its motion by the speed and by the position,
        in the unit of the integrated speed, m or rad, shape (parts, 2). Rows without either are left out.
    """
    measured = np.flatnonzero(np.isfinite(recording.outputs[:, [speed, position]]).all(axis=1))
    bounds = np.linspace(0, len(measured) - 1, PARTS + 1).astype(int)
    if len(measured) < 2 * PARTS:
        return np.zeros((0, 2), int), np.zeros((0, 2))
    travel = cumulative_trapezoid(recording.outputs[measured, speed], recording.time_s[measured], initial=0.0)
    both = np.column_stack([travel, scale * recording.outputs[measured, position]])[bounds]
    return np.column_stack([measured[bounds[:-1]], measured[bounds[1:]]]), np.diff(both, axis=0)


def without_contradictions(
    recordings: Sequence[Recording], runs: Sequence[PreparedRecording], machine: Machine
) -> tuple[list[Recording], tuple[str, ...]]:
    """Leave out the sensor that is wrong where a speed contradicts a position.

    Of a speed, the rows of the part are left out. Of a position, all rows of the run: those after the part
    have another zero.

    Args:
        recordings: Runs without unusable measurements.
        runs: The same runs, prepared for a fit.
        machine: Machine as declared.

    Returns:
        Runs without these measurements, and a sentence about each sensor; the same runs and no sentence if
        nothing is contradicted.
    """
    parts = contradicted_speeds(recordings, machine)
    if not parts:
        return list(recordings), ()
    of_position = _position_is_wrong(runs, machine)
    cleaned = []
    for recording in recordings:
        outputs = recording.outputs.copy()
        for part in parts:
            if part.run == recording.name:
                rows = slice(None) if of_position else slice(part.first, part.last + 1)
                outputs[rows, machine.output_channels.index(part.position if of_position else part.speed)] = (
                    np.nan
                )
        cleaned.append(dataclasses.replace(recording, outputs=outputs))
    return cleaned, tuple(_statements(parts, of_position))


def _statements(parts: Sequence[ContradictedSpeed], of_position: bool) -> Iterator[str]:
    """Yield a sentence about each sensor that is left out."""
    for speed, position in dict.fromkeys((part.speed, part.position) for part in parts):
        own = [part for part in parts if (part.speed, part.position) == (speed, position)]
        runs = name_runs(list(dict.fromkeys(part.run for part in own)))
        ratio = float(np.median([part.ratio for part in own]))
        what = (
            f"In parts of {runs}, {speed} is about {ratio:.3g} times the rate at which {position} changes, "
            "in other parts it is not."
        )
        if of_position:
            left_out = f"{position} is left out in these runs, since the motion that {speed} shows"
            yield f"{what} {left_out} follows better from the commands."
        else:
            yield f"{what} {speed} is left out there."


def _position_is_wrong(runs: Sequence[PreparedRecording], machine: Machine) -> bool:
    """Decide whether the measured speeds follow from the drives' forces better than the positions do.

    False for drives that follow a set point, whose force is not known, and for machines with belts, where
    the speed of one coordinate does not show the motion of all.
    """
    if machine.drive_laws or machine.belts:
        return False
    of_position = machine.position_sensors
    sensors = tuple(sensor for sensor in machine.sensors if sensor.of_position)
    positions = [dataclasses.replace(run, outputs=run.outputs[:, of_position]) for run in runs]
    by_position = _unexplained(positions, machine.replace(sensors=sensors, effects=()))
    return _unexplained(*with_integrated_speeds(runs, machine)) < by_position


def _unexplained(runs: Sequence[PreparedRecording], machine: Machine) -> float:
    """Return the fraction of the drives' squared force that no machine explains, in the best window."""
    unchanged = np.eye(len(machine.sensors)), np.eye(len(machine.drives))
    left = 1.0
    for span in SPANS:
        windows = [motion_windows(run, comparison_window(run.outputs, run.time_s, span)) for run in runs]
        balance = force_balance(windows, machine, *unchanged)
        left = min(left, balance.unexplained if balance else 1.0)
    return left
