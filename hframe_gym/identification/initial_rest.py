"""Find the rest at the beginning of a run: rows in which no voltage is applied and no sensor shows motion.

The inputs alone do not show rest: a machine may still swing when a log begins, and a voltage that is logged late, or
not at all, is 0 while the machine moves. If such motion were taken as rest, it would be counted as noise of the sensors
and shift their zeros. The velocity of a run that begins in motion is estimated in `initial_velocity`.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, Sensor
from ..recordings import Recording
from .sensor_properties import difference_noise, sensor_quantum

Array = NDArray[np.float64]
_MIN_ROWS = 16  # rows without input; fewer do not show whether the machine moves
# Medians of blocks of rows are compared: a median of 10 ms has little noise, and eight of them show a trend.
_BLOCK_S, _MIN_BLOCKS = 0.01, 8
_BLOCKS_AT_REST = 5  # blocks that show that a run begins at rest, however long no voltage is applied
# Tolerances: how far the median of a block may depart from the blocks at rest before it counts as motion. They are wide
# because a false motion costs the rest of a run, whereas true motion soon exceeds them.
_NOISE_TOLERANCE = 8.0  # standard deviations of the noise of one sample
_RANGE_TOLERANCE = 3.0  # times the range of the medians at rest; slow noise varies by about as much everywhere
_SPAN_TOLERANCE = 1e-4  # fraction of the sensor's span in the run, whatever its noise
# Fraction of the span that slow noise of a filtered sensor may reach if no sensor starts or stops; more is motion
# throughout.
_SLOW_NOISE_SPAN = 1e-3


class InitialRest(NamedTuple):
    """The rest at the beginning of a run.

    Attributes:
        first: First row at rest; larger than 0 if the machine still moves when the run begins and settles before the
            first input.
        rows: Number of rows from the beginning of the run to the end of the rest; 1 if the machine moves throughout, so
            that only the first row counts.
        moving: True for each sensor that moves in these rows, shape (sensors,).
        lead_s: Time by which motion begins before the first input, at least, s; 0 if it does not.
    """

    first: int
    rows: int
    moving: NDArray[np.bool_]
    lead_s: float = 0.0


def initial_rest(recording: Recording, machine: Machine) -> InitialRest:
    """Find the rest at the beginning of a run by its inputs and its sensors.

    The inputs alone do not show rest: the machine may still swing when the run begins, or move before a voltage is
    logged. The rows before the first input are therefore divided into blocks, and the medians of each sensor are
    compared. A sensor moves where its median departs from those of the last blocks (then the machine settles first) or
    of the first blocks (then it moves before the input) by more than noise and quantization explain. If the machine
    moves from beginning to end, only its first row counts as rest. Fewer than 16 rows are taken as rest.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad, NaN where not measured).
        machine: Machine with the sensors.

    Returns:
        First row at rest and number of rows to the end of the rest, the sensors that move before the first input (mask
        of shape (sensors,)), and the time by which a motion precedes the input, s.
    """
    rows = _rows_without_input(recording)
    rest = InitialRest(0, rows, np.zeros(recording.outputs.shape[1], np.bool_))
    if rows < _MIN_ROWS:
        return rest
    outputs = recording.outputs[:rows]
    tolerance, span = _tolerances(recording, rows, machine)
    period = float(np.median(np.diff(recording.time_s)))
    size = max(2, min(round(_BLOCK_S / period), rows // _MIN_BLOCKS))
    medians = _block_medians(outputs, size)
    quarter = max(2, len(medians) // 4)
    settled_blocks, settling = _departure(medians[::-1], quarter, tolerance)  # as seen from the end
    resting_blocks, departing = _departure(medians, min(quarter, _BLOCKS_AT_REST), tolerance)
    moving = settling | departing
    if not moving.any():
        # No sensor starts or stops. It may still move throughout, unless the motion is as small as slow noise.
        moving = peak_to_peak(medians) > np.maximum(tolerance, _SLOW_NOISE_SPAN * span)
        return rest._replace(rows=1, moving=moving) if moving.any() else rest
    driven = rows < len(recording.time_s)
    # One block of margin: motion of less than the tolerance begins before it shows, and ceases later.
    if settled_blocks and (driven or not resting_blocks):
        return rest._replace(first=size * (len(medians) - settled_blocks + 1), moving=moving)
    if resting_blocks:
        resting_rows = size * (resting_blocks - 1)
        lead = _lead(recording.time_s[:rows], outputs, resting_rows, tolerance) if driven else 0.0
        return rest._replace(rows=resting_rows, moving=moving, lead_s=lead)
    return rest._replace(rows=1, moving=moving)


def count_resting_rows(recording: Recording, machine: Machine) -> int:
    """Count the rows at the beginning of a run in which the machine is at rest.

    The row in which an input first changes is included, because its measurement still precedes the motion. Rows without
    measurement count as at rest, so that motion which `without_moving_start` has removed does not count.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad).
        machine: Machine with the sensors.

    Returns:
        Number of rows, at least 1; 1 if an input is not zero in the first row or a measurement there shows motion.
    """
    rest = initial_rest(recording, machine)
    return 1 if rest.first else rest.rows


def without_moving_start(recording: Recording, machine: Machine) -> Recording:
    """Remove the measurements before the machine comes to rest, if it still moves when the run begins.

    The rest that follows gives the initial state. A simulation that
    begins with this state and without input remains at rest until the first input, so times and inputs are kept.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad).
        machine: Machine with the sensors.

    Returns:
        Copy in which these measurements, m or rad, shape (n, sensors), are NaN; the same object if the run begins at
        rest or the machine does not come to rest before the first input.
    """
    first = initial_rest(recording, machine).first
    if not first:
        return recording
    outputs = recording.outputs.copy()
    outputs[:first] = np.nan
    return dataclasses.replace(recording, outputs=outputs)


def _rows_without_input(recording: Recording) -> int:
    """Return the number of rows up to the first change of an input, at least 1; 1 if an input is not zero at first."""
    changes = np.flatnonzero(np.any(recording.inputs != recording.inputs[0], axis=1))
    if np.any(recording.inputs[0]):
        return 1  # The machine is driven from its first row on; only that row is certainly at rest.
    return int(changes[0]) + 1 if len(changes) else len(recording.time_s)


def _tolerances(recording: Recording, rows: int, machine: Machine) -> tuple[Array, Array]:
    """Return by how much each sensor varies at rest, and its span in the run, in its unit, shape (sensors,) each."""
    spans = peak_to_peak(recording.outputs)
    noise = [
        measurement_noise(values[:rows], values, sensor)
        for values, sensor in zip(recording.outputs.T, machine.sensors, strict=True)
    ]
    return np.maximum(_NOISE_TOLERANCE * np.array(noise), _SPAN_TOLERANCE * spans), spans


def measurement_noise(values: Array, run_values: Array, sensor: Sensor) -> float:
    """Estimate the noise of some measurements: the measured, the declared or that of quantization, the largest.

    Args:
        values: The measurements, in the sensor's unit, NaN where there is none, shape (rows,).
        run_values: All measurements of the run, which show the quantization step, shape (n,).
        sensor: The sensor with its declared noise and resolution.

    Returns:
        Standard deviation, in the sensor's unit.
    """
    rounding = sensor_quantum([run_values], sensor.resolution) / np.sqrt(12)
    return max(difference_noise([values]), rounding, sensor.noise)


def _block_medians(outputs: Array, size: int) -> Array:
    """Return the medians of blocks of rows, shape (blocks, sensors), NaN where nothing was measured."""
    blocks = outputs[: len(outputs) // size * size].reshape(-1, size, outputs.shape[1])
    medians = np.full((len(blocks), outputs.shape[1]), np.nan)
    measured = np.isfinite(blocks).any(axis=1)
    for k, j in np.argwhere(measured):
        medians[k, j] = np.nanmedian(blocks[k, :, j])
    return medians


def _departure(medians: Array, count: int, tolerance: Array) -> tuple[int, NDArray[np.bool_]]:
    """Return after how many blocks a channel that is still in the first ones departs, and which channels do.

    Args:
        medians: Medians of the blocks, shape (blocks, sensors).
        count: Number of the first blocks, in which all channels must be still.
        tolerance: Largest variation at rest, shape (sensors,).

    Returns:
        Number of blocks before the first departure, 0 if there is none or a channel moves in the first ones already,
        and a mask of the channels that depart, shape (sensors,).
    """
    reference = medians[:count]
    variation = peak_to_peak(reference)
    quiet = variation <= tolerance
    center = np.fmin.reduce(reference) / 2 + np.fmax.reduce(reference) / 2
    departed = np.abs(medians - center) > np.maximum(tolerance, _RANGE_TOLERANCE * variation)  # NaN: not departed
    departing = departed.any(axis=0) & quiet
    first = int(np.argmax(departed[:, departing].any(axis=1))) if departing.any() and quiet.all() else 0
    return first, departing


def _lead(time_s: Array, outputs: Array, resting_rows: int, tolerance: Array) -> float:
    """Return the time, s, from the last row in which all channels are as in the resting rows to the last row."""
    middle = np.array([np.nanmedian(c) if np.isfinite(c).any() else np.nan for c in outputs[:resting_rows].T])
    departed = (np.abs(outputs - middle) > tolerance / 2).any(axis=1)
    return float(time_s[-1] - time_s[np.flatnonzero(~departed)[-1]])


def peak_to_peak(outputs: Array) -> Array:
    """Compute the difference between the largest and the smallest measurement of each channel.

    Args:
        outputs: Measurements, in the sensors' units, NaN where not measured, shape (n, sensors), or (n,) of one sensor.

    Returns:
        Differences in the same units, 0 where nothing was measured, shape (sensors,), or a scalar for one sensor.
    """
    return np.nan_to_num(np.fmax.reduce(outputs) - np.fmin.reduce(outputs))
