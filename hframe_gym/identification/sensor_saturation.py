"""Sensors that stick at the ends of their range: seen in the readings themselves, before any model is fitted.

Many readings together at the outermost value, while the encoders say that the machine moved, are an end of the range.
Those rows carry no position: they are kept out of the fit, and the effect `sensor_range` goes into the machine.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..machine import AppliedEffect, Machine
from ..recordings import Recording

Array = NDArray[np.float64]
Range = tuple[float, float]

_LEAST_SHARE = 0.01  # of all rows
# A sensor that sticks at one end may stick at the other, which takes less to believe.
_ALSO = 1.0 / 5.0
_BAND = 8.0  # noise deviations: readings this close together do not move
_MOVED = 300.0  # noise deviations that the machine must have moved meanwhile: more than belts can stretch
_ENDLESS = 10.0


def saturation_ranges(recordings: Sequence[Recording], machine: Machine, noise: Array) -> dict[str, Range]:
    """By channel of a sensor on a linear coordinate that sticks: the ends of its range, far away where it has none.

    noise (sensors,): standard deviations.
    """
    found: dict[str, Range] = {}
    travel = [_by_encoders(r, machine) for r in recordings]
    for j, sensor in enumerate(machine.sensors):
        if machine.coordinate(sensor.coordinate).kind != "linear":
            continue
        i = machine.coordinate_names.index(sensor.coordinate)
        ends = [_end(recordings, travel, i, j, float(noise[j]), sign) for sign in (-1.0, 1.0)]
        if any(end is not None for end in ends):
            ends = [_end(recordings, travel, i, j, float(noise[j]), sign, _ALSO) for sign in (-1.0, 1.0)]
            far = _ENDLESS * max(float(np.nanmax(np.abs(r.outputs[:, j]), initial=0.0)) for r in recordings)
            low, high = (sign * far if end is None else end for sign, end in zip((-1.0, 1.0), ends, strict=True))
            found[sensor.channel] = (low, high)
    return found


def _by_encoders(recording: Recording, machine: Machine) -> Array:
    """Positions (n, coordinates) that the rotary sensors tell, belts unstretched, from the run's first row."""
    rotary = [j for j, s in enumerate(machine.sensors) if machine.coordinate(s.coordinate).kind == "rotary"]
    count = len(machine.coordinates)
    if not rotary or not machine.belts:
        return np.full((len(recording.time_s), count), np.nan)
    G = np.array([machine.row(b.extension) for b in machine.belts]) * machine.radii
    known = np.vstack([machine.sensor_matrix[rotary], G])
    readings = recording.outputs[:, rotary] - recording.outputs[0, rotary]
    told = np.hstack([readings, np.zeros((len(readings), len(G)))])
    return np.asarray(np.linalg.lstsq(known, told.T, rcond=None)[0].T)


def _end(
    recordings: Sequence[Recording],
    travel: Sequence[Array],
    i: int,
    j: int,
    noise: float,
    sign: float,
    share: float = 1.0,
) -> float | None:
    """Where sensor j sticks on one side; share: of what is asked of the readings there."""
    readings = sign * np.concatenate([r.outputs[:, j] for r in recordings])
    if not np.isfinite(readings).any():
        return None
    top = float(np.nanmax(readings))
    together = readings > top - _BAND * noise
    if together.mean() < share * _LEAST_SHARE:
        return None
    moved = 0.0
    first = 0
    for path, recording in zip(travel, recordings, strict=True):
        own = path[together[first : first + len(recording.time_s)], i]
        first += len(recording.time_s)
        if len(own) and np.isfinite(own).all():
            moved = max(moved, float(np.ptp(own)))
    if moved < share * _MOVED * noise:
        return None
    return sign * float(np.median(readings[together]))


def blank_saturated(recording: Recording, ranges: Mapping[str, Range], machine: Machine, noise: Array) -> Recording:
    """The recording with the readings at the ends of a range blank."""
    outputs = recording.outputs.copy()
    for channel, (low, high) in ranges.items():
        j = machine.output_channels.index(channel)
        margin = _BAND / 2 * noise[j]
        outputs[(outputs[:, j] > high - margin) | (outputs[:, j] < low + margin), j] = np.nan
    return dataclasses.replace(recording, outputs=outputs)


def range_effects(ranges: Mapping[str, Range], found: Sequence[AppliedEffect] = ()) -> tuple[AppliedEffect, ...]:
    """The effects `sensor_range` of these ranges, each with the nearer ends of one found for the same sensor."""
    effects = []
    for channel, (low, high) in ranges.items():
        for e in found:
            if e.label == f"sensor_range@{channel}":
                low, high = max(low, e.parameters["low"]), min(high, e.parameters["high"])
        effects.append(EFFECTS["sensor_range"].at(channel, low=low, high=high))
    return tuple(effects)
