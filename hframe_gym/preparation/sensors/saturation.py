"""Find sensors that saturate, blank their measurements there, and describe their ranges as effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from ...arrays import Array, SensorNoise
from ...effects import EFFECTS
from ...effects.sensor_range import UNLIMITED
from ...machine import AppliedEffect, Machine
from ...recordings import Recording

Range = tuple[float, float]

# Fraction of all rows that are near a sensor's largest (or smallest) measurement if its range ends there.
_MIN_FRACTION = 0.01
# Standard deviations of the noise that the encoders move in these rows: more than belts can stretch.
_MIN_TRAVEL = 300.0
_BAND = 8.0  # standard deviations of the noise: largest distance of measurements near the largest one
_SECOND_END = 0.2  # factor of both minima at the other end of a sensor that saturates at one


def saturation_ranges(
    recordings: Sequence[Recording], machine: Machine, noise: SensorNoise
) -> dict[str, Range]:
    """Find the lasers that saturate: they stay at the end of their measuring range while the machine moves.

    A laser is a sensor with a fixed zero. It saturates at its largest (or smallest) measurement if two
    conditions hold: at least 1 % of all rows are within 8 standard deviations of the noise from this
    measurement, and by the encoders, the laser's coordinate moves in these rows by at least 300 standard
    deviations of the laser's noise. Without belts or encoders, nothing is found.

    Args:
        recordings: All runs of the rig.
        machine: Machine as declared.

    Returns:
        Lower and upper end of the measuring range, m or rad, by channel of each saturating laser. For an end
        that the laser never reached, -10 or +10 times the largest magnitude of its measurements. Empty if
        none saturates.
    """
    ranges: dict[str, Range] = {}
    positions_by_run = [_positions_from_encoders(r, machine) for r in recordings]
    for j, sensor in enumerate(machine.sensors):
        if not sensor.fixed:
            continue
        i = machine.coordinate_names.index(sensor.coordinate)
        channel = [r.outputs[:, j] for r in recordings]
        motion = [positions[:, i] for positions in positions_by_run]
        ends = [_end(channel, motion, float(noise[j]), sign, 1.0) for sign in (-1.0, 1.0)]
        # A sensor that saturates at one end probably does so at the other as well; less evidence suffices
        # there.
        if any(end is not None for end in ends):
            ends = [_end(channel, motion, float(noise[j]), sign, _SECOND_END) for sign in (-1.0, 1.0)]
            far = UNLIMITED * max(float(np.nanmax(np.abs(values), initial=0.0)) for values in channel)
            low, high = (
                sign * far if end is None else end for sign, end in zip((-1.0, 1.0), ends, strict=True)
            )
            ranges[sensor.channel] = (low, high)
    return ranges


def _positions_from_encoders(recording: Recording, machine: Machine) -> Array:
    """Return the displacements (n, coordinates) since the first row by encoders, with unstretched belts."""
    encoders = [j for j, sensor in enumerate(machine.sensors) if sensor.incremental]
    count = len(machine.coordinates)
    if not encoders or not machine.belts:
        return np.full((len(recording.time_s), count), np.nan)
    extension = machine.belt_matrix
    rows = np.vstack([machine.sensor_matrix[encoders], extension])
    angles = recording.outputs[:, encoders] - recording.outputs[0, encoders]
    measured = np.hstack([angles, np.zeros((len(angles), len(extension)))])
    return np.asarray(np.linalg.lstsq(rows, measured.T, rcond=None)[0].T)


def _end(
    channel: Sequence[Array], motion: Sequence[Array], noise: float, sign: float, factor: float
) -> float | None:
    """Return where a sensor saturates at the upper (1) or lower end (-1), or None; `factor` scales limits."""
    outward = sign * np.concatenate(channel)
    if not np.isfinite(outward).any():
        return None
    outermost = outward > float(np.nanmax(outward)) - _BAND * noise
    if outermost.mean() < factor * _MIN_FRACTION:
        return None
    distance, first = 0.0, 0
    for positions in motion:
        saturated = positions[outermost[first : first + len(positions)]]
        first += len(positions)
        if len(saturated) and np.isfinite(saturated).all():
            distance = max(distance, float(np.ptp(saturated)))
    if distance < factor * _MIN_TRAVEL * noise:
        return None
    return sign * float(np.median(outward[outermost]))


def blank_saturated(
    recording: Recording, ranges: Mapping[str, Range], machine: Machine, noise: SensorNoise
) -> Recording:
    """Copy a recording, with NaN in place of saturated measurements.

    A measurement is saturated if it lies beyond an end of the sensor's range, or inside the range but closer
    to an end than 4 standard deviations of the noise. Beside a saturated row, 8 count instead of 4: of many
    saturated measurements, noise puts some further inside the range.

    Args:
        ranges: Lower and upper end of the measuring range by channel name, m or rad. Other channels are
            unchanged.
    """
    outputs = recording.outputs.copy()
    for channel, (low, high) in ranges.items():
        j = machine.output_channels.index(channel)
        band = _BAND * noise[j]
        # Distance from the nearer end, m; NaN: missing.
        inside = np.minimum(high - outputs[:, j], outputs[:, j] - low)
        saturated = inside < band / 2
        beside = np.append(saturated[1:], False) | np.insert(saturated[:-1], 0, False)
        outputs[saturated | (beside & (inside < band)), j] = np.nan
    return dataclasses.replace(recording, outputs=outputs)


def range_effects(
    ranges: Mapping[str, Range], selected: Sequence[AppliedEffect] = ()
) -> tuple[AppliedEffect, ...]:
    """Convert the ranges of saturated sensors to effects ``sensor_range``, which limit measurements.

    Args:
        ranges: Lower and upper end of the measuring range by channel name, m or rad.
        selected: Effects that the search selected. If one of them is the ``sensor_range`` of the same sensor,
            the intersection of both ranges is used; if it is empty, `high` is `low`.

    Returns:
        One effect per channel in `ranges`, with the parameters `low` and `high`, m or rad.
    """
    effects = []
    for channel, (low, high) in ranges.items():
        for e in selected:
            if e.site == channel and (limits := e.measuring_range):
                low, high = max(low, limits[0]), min(high, limits[1])
        # Ranges may be disjoint.
        effects.append(EFFECTS["sensor_range"].at(channel, low=low, high=max(low, high)))
    return tuple(effects)


def without_saturated(
    recordings: Sequence[Recording], machine: Machine, noise: SensorNoise
) -> tuple[list[Recording], dict[str, Range]]:
    """Remove measurements at the end of a sensor's range.

    The machine's measuring ranges define where a sensor saturates; other sensors are examined
    (`saturation_ranges`).

    Args:
        recordings: Runs of one rig.

    Returns:
        Copies of the runs, and the ranges found, m or rad, by channel.
    """
    found = saturation_ranges(recordings, machine, noise)
    ends = found | machine.measuring_ranges
    return [blank_saturated(r, ends, machine, noise) for r in recordings], found
