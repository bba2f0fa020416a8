"""Find the rest at the beginning of a run.

At rest are rows in which no voltage is applied and no sensor shows motion. The inputs alone do not show rest:
a machine may still swing when a log begins, and a voltage that is logged late, or not at all, is 0 while the
machine moves. If such motion were taken as rest, it would be counted as noise of the sensors and shift their
zeros.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...machine import Machine, Sensor
from ...recordings import Recording, peak_to_peak
from ..sensors.noise import scatter_noise, sensor_noise, sensor_quantum

_MIN_ROWS = 16  # Fewer rows are not divided into blocks, and do not show rest after motion.
# Medians of blocks of rows are compared: a median of 10 ms has little noise, and eight of them show a trend.
_BLOCK_S, _MIN_BLOCKS = 0.01, 8
_BLOCKS_AT_REST = 5  # This many blocks show that a run begins at rest, however long no voltage is applied.
# Tolerances: how far the median of a block may depart from the blocks at rest before it counts as motion.
# They are wide because a false motion costs the rest of a run, whereas true motion soon exceeds them.
NOISE_TOLERANCE = 8.0  # standard deviations of the noise of one sample
# Multiple of the range of the medians at rest; slow noise varies by about as much everywhere.
_RANGE_TOLERANCE = 3.0
_SPAN_TOLERANCE = 1e-4  # fraction of the sensor's span in the run, whatever its noise
_SLOW_NOISE_SPAN = 1e-3  # fraction of the span that slow noise of a filtered sensor may reach; more is motion
# Fraction of its span in the run that a sensor of a speed may show at rest. Zeros of analog tachometers err
# by up to 2 % of their range; more is motion.
SPEED_ZERO_ERROR = 0.02


class InitialRest(NamedTuple):
    """The rest at the beginning of a run.

    Attributes:
        first: First row at rest; larger than 0 if the machine still moves when the run begins and settles
            before the first input.
        rows: Number of rows from the beginning of the run to the end of the rest; 1 if the machine moves
            throughout, so that only the first row counts.
        moving: True for each sensor that shows motion before the first input, shape (sensors,).
        lead_s: Lower bound of the time by which a motion precedes the first input, s; 0 if no motion precedes
            it.
    """

    first: int
    rows: int
    moving: NDArray[np.bool_]
    lead_s: float = 0.0


def initial_rest(recording: Recording, machine: Machine) -> InitialRest:
    """Find the rest at the beginning of a run by its inputs and its sensors.

    The rows before the first input are divided into blocks, and the medians of each sensor in the blocks are
    compared. Differences that noise and quantization explain do not count. There are three kinds of motion
    before the input:

    - The last blocks agree, earlier ones differ from them: the machine settles, and the rest begins later
      than the run. At least 16 rows must then be at rest, because neighboring blocks of a slow motion hardly
      differ.
    - The first blocks agree, later ones differ from them: the machine moves before the input; the rest ends
      earlier.
    - The blocks differ throughout: the machine moves from beginning to end, and only the first row counts as
      rest.

    Fewer than 16 rows are not divided: they are rest, or the third kind of motion if a sensor varies too
    much. A speed that is constant but not zero is the third kind as well, where no sensor shows the position
    of the coordinate.

    Args:
        recording: The run (times, s; voltages, V; measurements, in their units, NaN where there is none).

    Returns:
        First row at rest, number of rows from the beginning of the run to the end of the rest, the sensors
        that move before the first input (mask of shape (sensors,)), and the time by which a motion precedes
        the input, s.
    """
    rest = _constant_rows(recording, machine)
    coasting = _coasting(recording, machine, rest)
    return InitialRest(0, 1, rest.moving | coasting) if coasting.any() else rest


def _coasting(recording: Recording, machine: Machine, rest: InitialRest) -> NDArray[np.bool_]:
    """Return which sensors (sensors,) show a constant speed other than 0, where none shows the position."""
    located = {s.coordinate for s in machine.sensors if s.of_position}
    alone = np.array([s.of_velocity and s.coordinate not in located for s in machine.sensors], np.bool_)
    if rest.rows == 1 or not alone.any():
        return np.zeros(len(alone), np.bool_)
    tolerance, span = _tolerances(recording, rest.rows, machine)
    level = np.abs(_medians(recording.outputs[rest.first : rest.rows]))
    return np.asarray(alone & (level > np.maximum(tolerance, SPEED_ZERO_ERROR * span)))


def _constant_rows(recording: Recording, machine: Machine) -> InitialRest:
    """Find the rows before the first input in which all measurements are constant, speeds too."""
    rows = _rows_without_input(recording)
    if rows > _MIN_ROWS and _moves_in_last(
        recording.outputs[:rows], _tolerances(recording, rows - 1, machine)[0]
    ):
        rows -= 1
    outputs = recording.outputs[:rows]
    rest = InitialRest(0, rows, np.zeros(outputs.shape[1], np.bool_))
    tolerance, span = _tolerances(recording, rows, machine)
    if rows < _MIN_ROWS:
        moving = peak_to_peak(outputs) > tolerance
        return rest._replace(rows=1, moving=moving) if moving.any() else rest
    size = max(2, min(round(_BLOCK_S / float(np.median(np.diff(recording.time_s)))), rows // _MIN_BLOCKS))
    medians = _block_medians(outputs, size)
    quarter, limit = max(2, len(medians) // 4), np.maximum(tolerance, _SLOW_NOISE_SPAN * span)
    settled_blocks, settling = _departure(medians[::-1], quarter, tolerance, limit)  # as seen from the end
    resting_blocks, departing = _departure(medians, min(quarter, _BLOCKS_AT_REST), tolerance, np.inf)
    moving = settling | departing
    if not moving.any():
        # No sensor starts or stops. It may still move throughout, unless the motion is as small as slow
        # noise.
        moving = peak_to_peak(medians) > limit
        return rest._replace(rows=1, moving=moving) if moving.any() else rest
    driven = rows < len(recording.time_s)
    # One block of margin: motion of less than the tolerance begins before it shows, and ceases later.
    first, resting_rows = size * (len(medians) - settled_blocks + 1), size * (resting_blocks - 1)
    if size * settled_blocks >= _MIN_ROWS and (driven or not resting_blocks):
        return rest._replace(first=first, moving=moving)
    if resting_blocks and (
        resting_rows >= _MIN_ROWS or not np.any(peak_to_peak(outputs[:resting_rows]) > tolerance)
    ):
        lead = _lead(recording.time_s[:rows], outputs, resting_rows, tolerance) if driven else 0.0
        return rest._replace(rows=resting_rows, moving=moving, lead_s=lead)
    return rest._replace(rows=1, moving=moving)


def count_resting_rows(recording: Recording, machine: Machine) -> int:
    """Count the rows at the beginning of a run in which the machine is at rest.

    The row in which an input first changes is included, because its measurement still precedes the motion; it
    is not if it shows that a controller faster than the log moved the machine earlier. Rows without
    measurements count as rest, also those whose measurements `without_moving_start` has removed.

    Returns:
        Number of rows, at least 1. It is 1 if an input is not zero in the first row or the run begins in
        motion.
    """
    rest = initial_rest(recording, machine)
    return 1 if rest.first else rest.rows


def without_moving_start(
    recording: Recording, machine: Machine, rest: InitialRest | None = None
) -> Recording:
    """Copy a recording that begins in motion, without the measurements before the machine comes to rest.

    The following rest gives the initial state. A simulation from this state stays at rest until the first
    input, so that times and inputs are kept.

    Args:
        rest: Rest at the beginning of the run. Default: `initial_rest` finds it.

    Returns:
        Copy whose measurements are NaN before the rest. The same object if the run begins at rest or the
        machine does not come to rest before the first input.
    """
    first = (rest or initial_rest(recording, machine)).first
    if not first:
        return recording
    outputs = recording.outputs.copy()
    outputs[:first] = np.nan
    return dataclasses.replace(recording, outputs=outputs)


def _rows_without_input(recording: Recording) -> int:
    """Return the number of rows up to an input's first change; 1 if an input begins nonzero."""
    changes = np.flatnonzero(np.any(recording.inputs != recording.inputs[0], axis=1))
    if np.any(recording.inputs[0]):
        return 1  # The machine is driven from its first row on; only that row is certainly at rest.
    return int(changes[0]) + 1 if len(changes) else len(recording.time_s)


def _moves_in_last(outputs: Array, tolerance: Array) -> bool:
    """Return whether a sensor moves in the last row alone: a controller faster than the log began before."""
    if not np.isfinite(outputs[:-1]).any(axis=0).all():
        return False
    rest = outputs[:-1]
    still = peak_to_peak(rest) <= tolerance
    return bool(np.any(still & (np.abs(outputs[-1] - np.nanmedian(rest, axis=0)) > tolerance)))


def _tolerances(recording: Recording, rows: int, machine: Machine) -> tuple[Array, Array]:
    """Return how much each sensor varies at rest, and its span in the run, in its unit, (sensors,) each."""
    spans = peak_to_peak(recording.outputs)
    of_noise = rows if rows >= _MIN_ROWS else None  # Few rows do not show the noise; the entire run does.
    noise = [
        measurement_noise(values[:of_noise], values, sensor)
        for values, sensor in zip(recording.outputs.T, machine.sensors, strict=True)
    ]
    return np.maximum(NOISE_TOLERANCE * np.array(noise), _SPAN_TOLERANCE * spans), spans


def measurement_noise(values: Array, run_values: Array, sensor: Sensor) -> float:
    """Estimate the noise of a sensor: the largest of measured scatter, declared noise and rounding error.

    Args:
        values: Measurements whose scatter counts, in the sensor's unit, NaN if missing, shape (rows,).
        run_values: All measurements in the run, in the sensor's unit, shape (n,), for the quantization step
            and its rounding error.
        sensor: The sensor with its declared noise and resolution.

    Returns:
        Standard deviation of the noise, in the sensor's unit.
    """
    quantum = sensor_quantum([run_values], sensor.resolution)
    # A position passes through its steps, where a speed stays between two of them.
    scatter = scatter_noise(values, quantum if sensor.of_velocity else 0.0)
    return max(scatter, quantum / np.sqrt(12), sensor.noise)


def _medians(outputs: Array) -> Array:
    """Return the median of each sensor, shape (sensors,), NaN where nothing was measured."""
    return np.array([np.nanmedian(c) if np.isfinite(c).any() else np.nan for c in outputs.T])


def _block_medians(outputs: Array, size: int) -> Array:
    """Return the medians of blocks of rows, shape (blocks, sensors), NaN where nothing was measured."""
    # NaN last.
    blocks = np.sort(outputs[: len(outputs) // size * size].reshape(-1, size, outputs.shape[1]), axis=1)
    count = np.count_nonzero(~np.isnan(blocks), axis=1, keepdims=True)
    lower = np.take_along_axis(blocks, np.maximum(count - 1, 0) // 2, axis=1)
    upper = np.take_along_axis(blocks, np.minimum(count // 2, size - 1), axis=1)
    return np.asarray((lower + upper)[:, 0] / 2)


def _departure(
    medians: Array, count: int, tolerance: Array, limit: Array | float
) -> tuple[int, NDArray[np.bool_]]:
    """Return after how many blocks a channel at rest in the first `count` departs, and which channels do.

    A channel departs if it leaves `limit`, its largest range with slow noise. The number is 0 if none departs
    or a channel moves in the first blocks already.
    """
    reference = medians[:count]
    variation = peak_to_peak(reference)
    quiet = variation <= tolerance
    center = np.fmin.reduce(reference) / 2 + np.fmax.reduce(reference) / 2
    # NaN: not departed.
    departed = np.abs(medians - center) > np.maximum(tolerance, _RANGE_TOLERANCE * variation)
    departing = departed.any(axis=0) & quiet
    departed |= np.fmax.accumulate(medians) - np.fmin.accumulate(medians) > limit
    first = int(np.argmax(departed[:, departing].any(axis=1))) if departing.any() and quiet.all() else 0
    return first, departing


def _lead(time_s: Array, outputs: Array, resting_rows: int, tolerance: Array) -> float:
    """Return the time, s, from the last row in which all channels are as in the resting rows to the end."""
    middle = _medians(outputs[:resting_rows])
    departed = (np.abs(outputs - middle) > tolerance / 2).any(axis=1)
    return float(time_s[-1] - time_s[np.flatnonzero(~departed)[-1]])


def rest_and_noise(recording: Recording, machine: Machine) -> tuple[int, Array, Array]:
    """Estimate rows at rest, quantization steps and noise of the sensors from one run.

    Args:
        recording: Run without gaps.

    Returns:
        Number of rows at rest; quantization steps and noise of the sensors, in the sensors' units,
        shape (sensors,) each.
    """
    rows = count_resting_rows(recording, machine)
    channels = recording.outputs.T
    quanta = np.array(
        [sensor_quantum([c], s.resolution) for c, s in zip(channels, machine.sensors, strict=True)]
    )
    noise = np.array(
        [
            sensor_noise([c], [rows], q, s.noise)
            for c, q, s in zip(channels, quanta, machine.sensors, strict=True)
        ]
    )
    return rows, quanta, noise
