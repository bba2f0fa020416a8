"""Recognize angles and counters that wrap (after a turn or at the end of a register), and unwrap them.

An absolute encoder measures an angle within one turn, and a counter of n bits counts modulo 2^n. When the
motion passes the end, the measurement jumps by the modulus against the direction of the motion, and the
motion continues at the other end. All measurements then lie within one modulus. Both together distinguish a
wrap from an outlier and from a step. A potentiometer has a dead angle between its ends: its output needs more
than one sample to change from one end to the other, and may rest at an end meanwhile.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Times
from ..machine import Machine
from .cleaning import missing_rows
from .quantization import exact_quantum
from .recording import Recording

_MIN_VALUES = 10  # different successive values; fewer do not show a motion around a jump
_JUMP = 0.5  # fraction of the range of the values; a larger change may be a wrap
# Fraction of the modulus that regular changes may reach. At half of it, the direction of the motion is
# ambiguous.
_FASTEST = 0.3
_FAST_PERCENT = 98.0  # of the regular changes; a larger one may extend over a gap
_NEIGHBORS = 4  # regular changes on each side of a jump, from which the motion during the jump follows
# Relative deviation of a jump from a modulus. Moduli in use (4000 and 4096 counts) differ by 2.3 %; a
# constant acceleration changes the motion during a jump by far less.
_TOLERANCE = 0.01
# Fraction of the jumps that must have the size of the modulus and the opposite sign of the motion.
_AGREEING = 0.9
# Times the usual number of rows between two changes; a longer rest at an end next to most jumps is a dead
# angle. An encoder stays as long at its end as at any other value.
_DEAD = 5.0
_END = 0.1  # fraction of the range of the values from its end that is the end
_BITS = (8, 10, *range(12, 25), 32)  # of counters and absolute encoders in use
_TURNS = {2 * math.pi: "one turn", 360.0: "one turn in degrees", 1.0: "one turn in turns"}
_COUNTS_PER_TURN = (
    *(400, 800, 1000, 1440, 1600, 2000, 2400, 2500, 3600, 4000),
    *(5000, 7200, 8000, 10000, 20000, 36000),
)


class Wrap(NamedTuple):
    """How the values of a channel wrap.

    Attributes:
        modulus: Size of the jumps, in the unit of the values.
        name: Description of the modulus, such as "one turn" or "a counter of 16 bits".
        jumps: Number of jumps.
        lost: Number of measurements at no valid angle, see `_lost_rows`.
    """

    modulus: float
    name: str
    jumps: int
    lost: int = 0

    def describe(self, unit: str) -> str:
        """Describe the wrap in a clause: "wraps 13 times at one turn (6.28319 rad) and is unwrapped".

        Args:
            unit: Unit of the values, for the text.
        """
        times = "once" if self.jumps == 1 else f"{self.jumps} times"
        clause = f"wraps {times} at {self.name} ({self.modulus:.6g} {unit}) and is unwrapped"
        return f"{clause}; {self.describe_lost()}" if self.lost else clause

    def describe_lost(self) -> str:
        """Describe in a clause the `lost` measurements, of which there is at least one."""
        rows = f"{self.lost} rows in which" if self.lost > 1 else "one row in which"
        return f"{rows} it switches between its ends or rests in its dead angle count as not measured"


def known_moduli(quantum: float, *, angle: bool) -> dict[float, str]:
    """Return the sizes at which angles and counters usually wrap, with a name for each.

    Args:
        quantum: Quantization step in the unit of the values; 1 for raw counts, 0 if there is none.
        angle: Whether the values may be an angle (in radians, degrees or turns).

    Returns:
        Name of each modulus by its size: turns for an angle, powers of two and usual numbers of counts per
        turn for quantized values.
    """
    moduli = dict(_TURNS) if angle else {}
    if quantum > 0.0:
        counted = {count * quantum: f"{count} counts" for count in _COUNTS_PER_TURN}
        counted |= {2.0**bits * quantum: f"a counter of {bits} bits" for bits in _BITS}
        # A turn is known exactly, a quantization step only as exactly as the file states the values.
        turns = list(moduli)
        moduli |= {m: name for m, name in counted.items() if not np.isclose(m, turns, rtol=_TOLERANCE).any()}
    return moduli


def find_wrap(values: Array, moduli: Mapping[float, str]) -> Wrap | None:
    """Recognize values that wrap at a known modulus.

    Args:
        values: Values of one channel in one run, NaN where not measured, shape (n,).
        moduli: Name of each possible modulus by its size, in the unit of the values, see `known_moduli`.

    Returns:
        Modulus, its name, and the numbers of jumps and of lost measurements. None if nothing jumps, if the
        jumps have no known size, if the values extend over more than one modulus, or if the motion is so fast
        that its direction at a jump is ambiguous.
    """
    measured = values[np.isfinite(values) & ~_switching_rows(values)]
    changes = np.diff(measured)
    changes = changes[changes != 0.0]  # repeated values do not matter
    extent = float(np.ptp(measured)) if len(measured) else 0.0
    jumps = np.flatnonzero(np.abs(changes) > _JUMP * extent)
    regular = np.delete(changes, jumps)
    jumps = jumps[jumps > 0]  # the first value may be left from the run before
    if len(jumps) == 0 or len(regular) < _MIN_VALUES:
        return None
    motions = np.array([_motion_around(changes, int(jump), extent) for jump in jumps])
    sizes = np.abs(changes[jumps] - motions)
    modulus = min(moduli, key=lambda m: abs(m - float(np.median(sizes))), default=0.0)
    fast, smallest = np.percentile(np.abs(regular), _FAST_PERCENT), float(np.abs(regular).min())
    agreeing = (np.abs(sizes - modulus) < _TOLERANCE * modulus) & (changes[jumps] * motions <= 0.0)
    if np.mean(agreeing) < _AGREEING or fast > _FASTEST * modulus:
        return None
    if extent > (1.0 + _TOLERANCE) * modulus + smallest:
        return None
    return Wrap(modulus, moduli[modulus], len(jumps), int(np.count_nonzero(_lost_rows(values))))


def _motion_around(changes: Array, jump: int, extent: float) -> float:
    """Return the median of the regular changes around a jump; 0 if they are few or differ in direction."""
    near = changes[max(jump - _NEIGHBORS, 0) : jump + _NEIGHBORS + 1]
    regular = near[np.abs(near) <= _JUMP * extent]
    moves = len(regular) >= _NEIGHBORS and abs(int(np.sign(regular).sum())) == len(regular)
    return float(np.median(regular)) if moves else 0.0


def _switching_rows(values: Array) -> NDArray[np.bool_]:
    """Return the rows (n,) measured while the sensor switched from one end of its range to the other.

    Such a value lies between the one before and the one after it, which are more than half of the range
    apart, and it is farther away from both than regular changes are large.
    """
    switching = np.zeros(len(values), np.bool_)
    measured = np.flatnonzero(np.isfinite(values))
    changes = np.diff(values[measured])
    size = np.abs(changes)
    jump = _JUMP * float(np.ptp(values[measured])) if len(measured) else 0.0
    regular = size[(size > 0.0) & (size <= jump)]
    if len(regular) < _MIN_VALUES:
        return switching
    fast = float(np.percentile(regular, _FAST_PERCENT))
    between = (changes[:-1] * changes[1:] > 0.0) & (np.minimum(size[:-1], size[1:]) > fast)
    switching[measured[1:-1]] = between & (size[:-1] + size[1:] > jump)
    return switching


def _lost_rows(values: Array) -> NDArray[np.bool_]:
    """Return the rows (n,) in which values that wrap are at no valid angle.

    They were measured while the sensor switched from one end to the other (`_switching_rows`), or while it
    rested at an end, in a dead angle: within a few changes of nearly all jumps, the value stays at the
    smallest or largest one for several times as long as usual. The changes between rest and jump belong to
    the dead angle as well.
    """
    lost = _switching_rows(values)
    measured = np.flatnonzero(np.isfinite(values) & ~lost)
    kept = values[measured]
    changes = np.diff(kept)
    ends = np.append(np.flatnonzero(changes), len(changes))  # last row of each stretch of equal values
    if len(ends) < 2:
        return lost
    lengths = np.diff(ends, prepend=-1)
    usual = float(np.median(lengths))
    jumps = np.flatnonzero(np.abs(changes[ends[:-1]]) > _JUMP * float(np.ptp(kept)))
    extremes = float(kept.min()), float(kept.max())
    resting: list[tuple[int, int]] = []  # first and last stretch from a rest to its jump, or from a jump on
    beside = 0  # jumps
    for jump in jumps.tolist():
        near = range(max(jump - _NEIGHBORS + 1, 0), min(jump + _NEIGHBORS + 1, len(lengths)))
        rests = [k for k in near if lengths[k] > _DEAD * usual and kept[ends[k]] in extremes]
        resting += [(k, jump) if k <= jump else (jump + 1, k) for k in rests]
        beside += bool(rests)
    if len(jumps) > 1 and beside >= _AGREEING * len(jumps):
        for first, last in resting:
            lost[measured[ends[first] + 1 - lengths[first] : ends[last] + 1]] = True
    return lost


def unwrapped(values: Array, modulus: float, time_s: Times) -> Array:
    """Unwrap values: add multiples of the modulus, so that no change between measurements exceeds half of it.

    In a gap of the times, a fast motion passes the end several times. There, the change is the one that is
    closest to the motion at the mean of the speeds before and after the gap.

    Args:
        values: Values of one channel, NaN where not measured, shape (n,).
        modulus: Size of the jumps, in the unit of the values.

    Returns:
        Copy that begins with the same value and has no jumps, shape (n,). NaN where the values are, and in
        the rows that belong to no angle: measured while the sensor jumped from one end to the other, or while
        it rested at an end before or after nearly every jump.
    """
    result = np.where(_lost_rows(values), np.nan, values)
    measured = np.isfinite(result)
    changes, steps = np.diff(values[measured]), np.diff(time_s[measured])
    if not len(changes):
        return result
    turns = np.rint(changes / modulus)
    gaps = np.flatnonzero(missing_rows(time_s[measured]))
    motion = _speed_around(changes - modulus * turns, steps, gaps) * steps[gaps]
    turns[gaps] = np.rint((changes[gaps] - motion) / modulus)
    result[measured] -= modulus * np.concatenate([[0.0], np.cumsum(turns)])
    return result


def _speed_around(changes: Array, steps: Array, gaps: NDArray[np.int_]) -> Array:
    """Return the mean speed before and after each gap, shape (gaps,), 0 where nothing else was measured."""
    regular = np.ones(len(steps), np.bool_)
    regular[gaps] = False
    sums = [np.concatenate([[0.0], np.cumsum(np.where(regular, x, 0.0))]) for x in (changes, steps)]
    first, last = np.maximum(gaps - _NEIGHBORS, 0), np.minimum(gaps + 1 + _NEIGHBORS, len(steps))
    speeds = []
    for begin, end in ((first, gaps), (gaps + 1, last)):
        distance, duration = (total[end] - total[begin] for total in sums)
        speeds.append(np.divide(distance, duration, out=np.full(len(gaps), np.nan), where=duration > 0.0))
    known = np.isfinite(speeds)
    return np.asarray(np.where(known, speeds, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def wraps_of(recording: Recording, machine: Machine) -> dict[str, Wrap]:
    """Recognize the output channels of a recording that wrap.

    A sensor that measures within one turn (`Sensor.turn`) wraps where it jumps by more than half of it. Of
    other sensors of positions, `find_wrap` decides, with the usual turns and counters (`known_moduli`).

    Returns:
        Wrap, in the unit of the sensor, by channel; channels that do not wrap are missing.
    """
    found = {}
    for sensor, values in zip(machine.sensors, recording.outputs.T, strict=True):
        if sensor.turn is not None:
            jumps = int(np.count_nonzero(np.abs(np.diff(values[np.isfinite(values)])) > sensor.turn / 2))
            if jumps:
                lost = int(np.count_nonzero(_lost_rows(values)))
                found[sensor.channel] = Wrap(sensor.turn, "one turn", jumps, lost)
            continue
        if not sensor.of_position:
            continue
        angle = machine.coordinate(sensor.coordinate).kind == "rotary"
        wrap = find_wrap(values, known_moduli(exact_quantum(values, sensor.resolution), angle=angle))
        if wrap is not None:
            found[sensor.channel] = wrap
    return found


class EndJumps(NamedTuple):
    """Jumps of a sensor from one end of its values to the other.

    Attributes:
        rows: Index of the first row after each jump, shape (jumps,).
        before: Value before the first jump, in the sensor's unit.
        after: Value after it.
    """

    rows: NDArray[np.int_]
    before: float
    after: float


def jumps_between_ends(values: Array, low: float, high: float) -> EndJumps | None:
    """Find jumps between the ends of a range in a channel that otherwise changes slowly.

    An angle that wraps jumps like this, whatever the size of its turn, and so does a potentiometer that
    passes its dead angle. An outlier, in contrast, returns at once, and a fast motion takes several rows.

    Args:
        values: Values of one channel in one run, NaN where not measured, shape (n,).
        low: Lower end of the values in all runs, in the unit of the values.
        high: Upper end, in the same unit.

    Returns:
        Rows and values of the jumps. None without jumps, if one jump is not from end to end, if two follow
        each other within four measurements, or if the channel moves too fast between them.
    """
    extent = high - low
    measured = np.flatnonzero(np.isfinite(values) & ~_switching_rows(values))
    kept = values[measured]
    changes = np.diff(kept)
    jumps = np.flatnonzero(np.abs(changes) > _JUMP * extent)
    regular = changes[(np.abs(changes) <= _JUMP * extent) & (changes != 0.0)]
    if len(jumps) == 0 or len(regular) < _MIN_VALUES or extent <= 0.0:
        return None
    if np.percentile(np.abs(regular), _FAST_PERCENT) > _FASTEST * _END * extent:
        return None
    if np.any(np.diff(jumps) < _NEIGHBORS):
        return None
    nearer = np.minimum(kept[jumps], kept[jumps + 1]) - low, high - np.maximum(kept[jumps], kept[jumps + 1])
    if np.max(nearer) > _END * extent:
        return None
    return EndJumps(measured[jumps + 1], float(kept[jumps[0]]), float(kept[jumps[0] + 1]))


def shared_wraps(recordings: Sequence[Recording], machine: Machine) -> dict[tuple[str, str], Wrap]:
    """Find channels that wrap in a run, as another run of the same sensor shows.

    A run with few jumps, or with an outlier beside them, does not determine the size of the turn. If another
    run does, jumps between the same ends count as wraps.

    Returns:
        Wraps by the name of the run and of the channel, in the sensors' units, without those that `wraps_of`
        finds.
    """
    alone = [wraps_of(recording, machine) for recording in recordings]
    shared = {}
    for j, channel in enumerate(machine.output_channels):
        known = [(r, w[channel]) for r, w in zip(recordings, alone, strict=True) if channel in w]
        if not known or len({wrap.modulus for _, wrap in known}) > 1:
            continue
        low = min(float(np.nanmin(recording.outputs[:, j])) for recording, _ in known)
        high = max(float(np.nanmax(recording.outputs[:, j])) for recording, _ in known)
        margin = _TOLERANCE * known[0][1].modulus
        for recording, wraps in zip(recordings, alone, strict=True):
            values = recording.outputs[:, j]
            jumps = None if channel in wraps else jumps_between_ends(values, low, high)
            if jumps and np.nanmin(values) >= low - margin and np.nanmax(values) <= high + margin:
                lost = int(np.count_nonzero(_lost_rows(values)))
                wrap = known[0][1]._replace(jumps=len(jumps.rows), lost=lost)
                shared[recording.name, channel] = wrap
    return shared


def without_shared_wraps(recordings: Sequence[Recording], machine: Machine) -> list[Recording]:
    """Copy the runs, and make sensors continuous that wrap as other runs show (`shared_wraps`)."""
    shared = shared_wraps(recordings, machine)
    return [
        _without(
            recording, {c: wrap for (name, c), wrap in shared.items() if name == recording.name}, machine
        )
        for recording in recordings
    ]


def without_wraps(recording: Recording, machine: Machine) -> Recording:
    """Copy a recording with continuous angles and counters, or return it if no output wraps.

    A measurement wraps at the turn that its sensor declares; without one, at jumps of a known modulus
    (`find_wrap`), if it is a position. Other jumps stay.
    """
    return _without(recording, wraps_of(recording, machine), machine)


def _without(recording: Recording, wraps: Mapping[str, Wrap], machine: Machine) -> Recording:
    """Copy a recording with continuous values of the channels that wrap, or return it if none does."""
    if not wraps:
        return recording
    outputs = recording.outputs.copy()
    for j, channel in enumerate(machine.output_channels):
        if channel in wraps:
            outputs[:, j] = unwrapped(outputs[:, j], wraps[channel].modulus, recording.time_s)
    return dataclasses.replace(recording, outputs=outputs)
