"""Find parts of runs in which a speed is a multiple of the rate of the position at the same coordinate.

A multiple in all runs is a wrong unit or scale, which `hframe check` reports as a fault. In a part of a run,
a counter was read twice, an encoder loses pulses in a part of its turn, or a gear was shifted: one of the two
sensors is wrong there, and nothing about the sensors tells which. The drives' forces do
(`forces/contradicted_sensors.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import median_filter

from ...arrays import Array, Measurements, Times
from ...machine import Machine, Sensor
from ...recordings import Recording

PARTS = 20  # of a run, whose motions are compared: long enough for the filter of a speed
MIN_PARTS = 5  # in a row with the same ratio; the lag of a filter spoils the ratio of one or two after a step
_LARGEST_RATIO = 1.5  # a tachometer may be wrong by 20 %, and identification finds that
_MOVES = 0.1  # of a large motion (the 90th percentile) in all parts; a ratio of less is that of noise
# Of the logarithm of the ratio about its median, as a median; a lag has all ratios from 0 to 1.
_SCATTER = 0.2
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
    columns = [machine.output_channels.index(sensor.channel) for sensor in (speed, position)]
    motions = [_motions(r.time_s, r.outputs[:, columns], scale) for r in recordings]
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


def _motions(time_s: Times, outputs: Measurements, scale: float) -> tuple[NDArray[np.int_], Array]:
    """Return the rows and the motions of the parts of a run, whose outputs are a speed and a position.

    Returns:
        First and last row of each part, shape (parts, 2), and its motion by the speed and by the position,
        in the unit of the integrated speed, m or rad, shape (parts, 2). Rows without either are left out.
    """
    measured = np.flatnonzero(np.isfinite(outputs).all(axis=1))
    if len(measured) < 2 * PARTS:
        return np.zeros((0, 2), np.int_), np.zeros((0, 2))
    travel = cumulative_trapezoid(outputs[measured, 0], time_s[measured], initial=0.0)
    bounds = np.linspace(0, len(measured) - 1, PARTS + 1).astype(int)
    both = np.column_stack([travel, scale * outputs[measured, 1]])[bounds]
    return np.column_stack([measured[bounds[:-1]], measured[bounds[1:]]]), np.diff(both, axis=0)
