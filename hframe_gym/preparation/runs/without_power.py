"""Find beginnings and ends of runs in which the drives have no effect, as while an amplifier is switched off.

A command that starts the machine from rest later in the log, or in other runs, has no effect there. A fit
would take such rows for dry friction that the other rows refute. Friction that differs from start to start is
no such case: its failed starts lie between others. Nor is a spring, a weight or an end stop, against which a
command starts the machine at one position and not farther in its direction: they stop it under a command.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...arrays import Array, Times
from ...machine import Machine
from ...recordings import Recording
from ..dataset import MIN_ROWS

# Change of a measurement at rest, in standard deviations of its noise and in steps: about the span of 20 000
# normally distributed samples, and the two steps between which a resting counter alternates.
_STILL_NOISE, _STILL_STEPS = 8.0, 2.5
_REST_ROWS = 4  # before a push
_FULL = 0.95  # fraction of its peak from which on a push counts as acting
_AS_STRONG = 0.99  # fraction of a push's force; commands are rounded
_MIN_STARTS = 2  # by no larger force that must succeed, all runs together
_LONGER = 2.0  # times the longest time that such a start takes; a start may be late by chance
_SHORTEST = 0.2  # s, for which a failed push acts; friction and inertia outlast the pushes of a fast sweep
# Failed pushes at one end of a run; a single one may be stiction after a long rest, unless it is so many
# times as strong as pushes that succeed elsewhere.
_MIN_FAILED, _STRONG = 2, 1.5


class WithoutPower(NamedTuple):
    """Beginning or end of a run in which commands have no effect.

    Attributes:
        run: Name of the run.
        coordinate: Name of the coordinate that does not move.
        commands: Channels of its drives.
        first: Index of its first row.
        last: Index of its last row.
        pushes: Number of times that a command starts without effect.
    """

    run: str
    coordinate: str
    commands: tuple[str, ...]
    first: int
    last: int
    pushes: int


class _Push(NamedTuple):
    """Rows in which the drives push a resting coordinate in one direction.

    `force` is the largest force, signed, before the coordinate moves, N or Nm; `seconds` the time for which
    nearly this force acts until it moves, or at all. `stops` says whether it moves and rests at the end.
    """

    first: int
    end: int
    force: float
    seconds: float
    moves: bool
    stops: bool


def without_power(
    recordings: Sequence[Recording], noise: Array, quantum: Array, machine: Machine
) -> list[WithoutPower]:
    """Find the beginnings and ends of runs in which commands that start the machine elsewhere do not.

    Args:
        recordings: Runs without unusable measurements.
        noise: Noise of each sensor, in its unit, shape (sensors,).
        quantum: Quantization step of each sensor, in its unit, 0 for none, shape (sensors,).
        machine: Machine as declared. Machines with belts, and drives whose force is not in proportion to
            their command, are not checked.
    """
    if machine.belts or machine.drive_laws:
        return []
    found: list[WithoutPower] = []
    still = np.maximum(_STILL_NOISE * noise, _STILL_STEPS * quantum)
    for coordinate in dict.fromkeys(drive.coordinate for drive in machine.drives):
        drives = [drive for drive in machine.drives if drive.coordinate == coordinate]
        gains = [drive.gain if drive in drives else 0.0 for drive in machine.drives]
        sensors = [
            j
            for j, sensor in enumerate(machine.sensors)
            if list(sensor.row) == [coordinate] and (sensor.of_position or sensor.of_velocity)
        ]
        if not sensors:
            continue
        j = sensors[0]
        speed, factor = machine.sensors[j].of_velocity, machine.sensors[j].row[coordinate]
        tolerance = float(still[j] if speed else still[j] / abs(factor))
        pushes = []
        for recording in recordings:
            values, force = recording.outputs[:, j], recording.inputs @ gains
            values = np.abs(values) if speed else values / factor
            pushes.append(_pushes(recording.time_s, force, values, tolerance, speed=speed))
        failed = _failed(pushes)
        for recording, own, fails in zip(recordings, pushes, failed, strict=True):
            for first, last, count in _ends(own, fails, len(recording.time_s)):
                commands = tuple(drive.channel for drive in drives)
                found.append(WithoutPower(recording.name, coordinate, commands, first, last, count))
    return found


def with_power(recordings: Sequence[Recording], found: Sequence[WithoutPower]) -> list[Recording]:
    """Leave out these beginnings and ends of runs; a run of which too few rows would remain is kept whole."""
    kept = []
    for recording in recordings:
        first, end = 0, len(recording.time_s)
        for part in found:
            if part.run == recording.name:
                first = max(first, part.last + 1) if part.first == 0 else first
                end = min(end, part.first) if part.first else end
        shorter = end - first < len(recording.time_s) and end - first >= MIN_ROWS
        kept.append(recording.rows(slice(first, end)) if shorter else recording)
    return kept


def _pushes(time_s: Times, force: Array, values: Array, still: float, *, speed: bool) -> list[_Push]:
    """Return the pushes of a run that begin at rest; those with too few measurements are left out.

    The values are speeds, or else positions.
    """
    signs = np.sign(force)
    edges = np.flatnonzero(np.diff(signs) != 0) + 1
    pushes = []
    bounds = [0, *edges.tolist(), len(force)]
    for first, end in pairwise(bounds):
        # Not the last row: a log that is one row late shows the motion before the command.
        before = values[max(0, first - 1 - _REST_ROWS) : max(first - 1, 1)]
        rows = values[first : min(end + 1, len(values))]
        if not signs[first] or np.isnan(before).all() or np.isfinite(rows).sum() < 2:
            continue
        if np.nanmax(before) - np.nanmin(before) > still:
            continue
        at_rest = before[np.isfinite(before)][-1]
        moved = np.flatnonzero(np.abs(rows - at_rest) > still)
        last = rows[np.isfinite(rows)][-_REST_ROWS - 1 :]
        moves = len(moved) > 0
        stops = moves and abs(last[-1] - (at_rest if speed else last[0])) <= still
        until = min(first + int(moved[0]), end - 1) if len(moved) else end - 1
        largest = float(np.abs(force[first : until + 1]).max())
        acting = first + int(np.argmax(np.abs(force[first : until + 1]) >= _FULL * largest))
        seconds = float(time_s[min(until + 1, len(time_s) - 1)] - time_s[acting])
        pushes.append(_Push(first, end, float(signs[first]) * largest, seconds, moves, bool(stops)))
    return pushes


def _failed(pushes: Sequence[Sequence[_Push]]) -> list[list[int]]:
    """Return for each push how much its failure counts: 0 if no weaker or equal ones succeed elsewhere.

    It counts 0 as well if one in its direction stops the machine, as a spring does.
    """
    starts = [push for own in pushes for push in own if push.moves]

    def fails(push: _Push, margin: float) -> bool:
        alike = [start for start in starts if start.force * push.force > 0.0]
        if any(start.stops for start in alike):
            return False
        weaker = [start.seconds for start in alike if margin * abs(start.force) <= abs(push.force)]
        long_enough = max(_SHORTEST, _LONGER * max(weaker, default=0.0))
        return not push.moves and len(weaker) >= _MIN_STARTS and push.seconds >= long_enough

    def count(push: _Push) -> int:
        return _MIN_FAILED if fails(push, _STRONG) else int(fails(push, _AS_STRONG))

    return [[count(push) for push in own] for own in pushes]


def _ends(pushes: Sequence[_Push], fails: Sequence[int], rows: int) -> list[tuple[int, int, int]]:
    """Return first and last row of a run's beginning and end without power, and the pushes in each."""
    moving = [k for k, push in enumerate(pushes) if push.moves]
    if not moving or any(fails[moving[0] : moving[-1]]):
        return []
    ends = []
    before, after = fails[: moving[0]], fails[moving[-1] + 1 :]
    if sum(before) >= _MIN_FAILED:
        last = max(k for k, failed in enumerate(before) if failed)
        ends.append((0, pushes[last].end - 1, int(np.count_nonzero(before))))
    if sum(after) >= _MIN_FAILED:
        first = moving[-1] + 1 + min(k for k, failed in enumerate(after) if failed)
        ends.append((pushes[first].first, rows - 1, int(np.count_nonzero(after))))
    return ends
