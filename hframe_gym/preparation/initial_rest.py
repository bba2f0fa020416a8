"""Find the rest at the beginning of a run, or the velocity of a run that begins in motion.

At rest are rows in which no voltage is applied and no sensor shows motion. The inputs alone do not show rest: a machine
may still swing when a log begins, and a voltage that is logged late, or not at all, is 0 while the machine moves. If
such motion were taken as rest, it would be counted as noise of the sensors and shift their zeros. A run that was cut
out of a longer log begins in motion: its first measurements show the velocity.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import simulate_batch
from ..machine import Machine, Sensor
from ..recordings import Recording, peak_to_peak
from .belt_stretch import vibration_speeds
from .sensor_properties import difference_noise, sensor_quantum

Array = NDArray[np.float64]
_MIN_ROWS = 16  # Fewer rows are not divided into blocks, and do not show rest after motion.
# Medians of blocks of rows are compared: a median of 10 ms has little noise, and eight of them show a trend.
_BLOCK_S, _MIN_BLOCKS = 0.01, 8
_BLOCKS_AT_REST = 5  # This many blocks show that a run begins at rest, however long no voltage is applied.
# Tolerances: how far the median of a block may depart from the blocks at rest before it counts as motion. They are wide
# because a false motion costs the rest of a run, whereas true motion soon exceeds them.
_NOISE_TOLERANCE = 8.0  # standard deviations of the noise of one sample
_RANGE_TOLERANCE = (
    3.0  # times the range of the medians at rest; slow noise varies by about as much everywhere
)
_SPAN_TOLERANCE = 1e-4  # fraction of the sensor's span in the run, whatever its noise
_SLOW_NOISE_SPAN = 1e-3  # fraction of the span that slow noise of a filtered sensor may reach; more is motion
# Durations, s, of the first measurements to which parabolas are fitted: short ones for fast changes, long ones for much
# noise. Their smallest number of rows is more than twice that of a parabola's coefficients.
_FITTED_S, _MIN_FITTED_ROWS = (0.005, 0.01, 0.02, 0.04), 8
_COMPARED_S = (
    0.05  # s from the first row, in which the simulations from rest and with each velocity are compared
)
_SIGNIFICANT_SPEED = 5.0  # In standard deviations; noise hardly ever reaches it.
# Of two velocities, one is certainly better if its sum of squared errors is less than this fraction of the other's. The
# sum contains model errors, which do not average out, so no test for independent errors applies.
_CERTAIN_COST_RATIO = 0.5
_MIN_ERROR = 0.2  # Fraction of the speed; vibrating belts and curved motion falsify the slope of a parabola.


class InitialVelocity(NamedTuple):
    """The velocity with which a run begins.

    Attributes:
        mean: Velocities of the coordinates, m/s or rad/s, shape (coordinates,); zero for a run that begins at rest.
        deviations: Matrix D of independent errors of the velocities, one per row, shape (errors, coordinates); D^T D is
            the covariance of the velocities. No rows if the run begins at rest or no velocity is significant.
    """

    mean: Array
    deviations: Array

    @classmethod
    def at_rest(cls, machine: Machine) -> InitialVelocity:
        """Return the initial velocity of a run that begins at rest: zero, and certain.

        Args:
            machine: Machine with the coordinates.

        Returns:
            Velocities, all zero, shape (coordinates,), and no errors of them, shape (0, coordinates).
        """
        count = len(machine.coordinates)
        return cls(np.zeros(count), np.zeros((0, count)))


class InitialRest(NamedTuple):
    """The rest at the beginning of a run.

    Attributes:
        first: First row at rest; larger than 0 if the machine still moves when the run begins and settles before the
            first input.
        rows: Number of rows from the beginning of the run to the end of the rest; 1 if the machine moves throughout, so
            that only the first row counts.
        moving: True for each sensor that moves in these rows, shape (sensors,).
        lead_s: Lower bound of the time by which a motion precedes the first input, s; 0 if no motion precedes it.
    """

    first: int
    rows: int
    moving: NDArray[np.bool_]
    lead_s: float = 0.0


def initial_rest(recording: Recording, machine: Machine) -> InitialRest:
    """Find the rest at the beginning of a run by its inputs and its sensors.

    The rows before the first input are divided into blocks, and the medians of each sensor in the blocks are compared.
    Differences that noise and quantization explain do not count. There are three kinds of motion before the input:

    - The last blocks agree, earlier ones differ from them: the machine settles, and the rest begins later than the run.
      At least 16 rows must then be at rest, because neighboring blocks of a slow motion hardly differ.
    - The first blocks agree, later ones differ from them: the machine moves before the input; the rest ends earlier.
    - The blocks differ throughout: the machine moves from beginning to end, and only the first row counts as rest.

    Fewer than 16 rows are not divided: they are rest, or the third kind of motion if a sensor varies too much.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad, NaN where not measured).
        machine: Machine with the sensors.

    Returns:
        First row at rest, number of rows from the beginning of the run to the end of the rest, the sensors that move
        before the first input (mask of shape (sensors,)), and the time by which a motion precedes the input, s.
    """
    rows = _rows_without_input(recording)
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
        # No sensor starts or stops. It may still move throughout, unless the motion is as small as slow noise.
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

    The row in which an input first changes is included, because its measurement still precedes the motion. Rows without
    measurements count as rest, among them those whose measurements `without_moving_start` has removed.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad).
        machine: Machine with the sensors.

    Returns:
        Number of rows, at least 1. It is 1 if an input is not zero in the first row or the run begins in motion.
    """
    rest = initial_rest(recording, machine)
    return 1 if rest.first else rest.rows


def without_moving_start(
    recording: Recording, machine: Machine, rest: InitialRest | None = None
) -> Recording:
    """Copy a recording that begins in motion, without the measurements before the machine comes to rest.

    The rest that follows gives the initial state. A simulation that begins with this state and without input remains at
    rest until the first input, so times and inputs are kept.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad).
        machine: Machine with the sensors.
        rest: Rest at the beginning of the run. Default: `initial_rest` finds it.

    Returns:
        Copy whose measurements, m or rad, shape (n, sensors), are NaN before the rest. The same object if the run
        begins at rest or the machine does not come to rest before the first input.
    """
    first = (rest or initial_rest(recording, machine)).first
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
    of_noise = rows if rows >= _MIN_ROWS else None  # Few rows do not show the noise; the entire run does.
    noise = [
        measurement_noise(values[:of_noise], values, sensor)
        for values, sensor in zip(recording.outputs.T, machine.sensors, strict=True)
    ]
    return np.maximum(_NOISE_TOLERANCE * np.array(noise), _SPAN_TOLERANCE * spans), spans


def measurement_noise(values: Array, run_values: Array, sensor: Sensor) -> float:
    """Estimate the noise of a sensor: the largest of measured scatter, declared noise and rounding error.

    Args:
        values: Measurements whose scatter counts, m or rad, NaN where there is none, shape (rows,).
        run_values: All measurements in the run, m or rad, shape (n,), for the quantization step and its rounding error.
        sensor: The sensor with its declared noise and resolution.

    Returns:
        Standard deviation of the noise, m or rad.
    """
    rounding = sensor_quantum([run_values], sensor.resolution) / np.sqrt(12)
    return max(difference_noise([values]), rounding, sensor.noise)


def _block_medians(outputs: Array, size: int) -> Array:
    """Return the medians of blocks of rows, shape (blocks, sensors), NaN where nothing was measured."""
    blocks = np.sort(
        outputs[: len(outputs) // size * size].reshape(-1, size, outputs.shape[1]), axis=1
    )  # NaN last
    count = np.count_nonzero(~np.isnan(blocks), axis=1, keepdims=True)
    lower = np.take_along_axis(blocks, np.maximum(count - 1, 0) // 2, axis=1)
    upper = np.take_along_axis(blocks, np.minimum(count // 2, size - 1), axis=1)
    return np.asarray((lower + upper)[:, 0] / 2)


def _departure(
    medians: Array, count: int, tolerance: Array, limit: Array | float
) -> tuple[int, NDArray[np.bool_]]:
    """Return after how many blocks a channel that is still in the first ones departs, and which channels do.

    Args:
        medians: Medians of the blocks, shape (blocks, sensors).
        count: Number of the first blocks, in which all channels must be still.
        tolerance: Largest variation at rest, shape (sensors,).
        limit: Largest range before the departure, with slow noise; a channel that leaves it departs, shape (sensors,).

    Returns:
        Number of blocks before the first departure, 0 if there is none or a channel moves in the first ones already,
        and a mask of the channels that depart, shape (sensors,).
    """
    reference = medians[:count]
    variation = peak_to_peak(reference)
    quiet = variation <= tolerance
    center = np.fmin.reduce(reference) / 2 + np.fmax.reduce(reference) / 2
    departed = np.abs(medians - center) > np.maximum(
        tolerance, _RANGE_TOLERANCE * variation
    )  # NaN: not departed
    departing = departed.any(axis=0) & quiet
    departed |= np.fmax.accumulate(medians) - np.fmin.accumulate(medians) > limit
    first = int(np.argmax(departed[:, departing].any(axis=1))) if departing.any() and quiet.all() else 0
    return first, departing


def _lead(time_s: Array, outputs: Array, resting_rows: int, tolerance: Array) -> float:
    """Return the time, s, from the last row in which all channels are as in the resting rows to the last row."""
    middle = np.array([np.nanmedian(c) if np.isfinite(c).any() else np.nan for c in outputs[:resting_rows].T])
    departed = (np.abs(outputs - middle) > tolerance / 2).any(axis=1)
    return float(time_s[-1] - time_s[np.flatnonzero(~departed)[-1]])


def initial_velocity(
    recording: Recording, machine: Machine, rigid: Array, position: Array
) -> InitialVelocity:
    """Estimate the velocity of a run whose first row is not at rest, from its first measurements.

    Parabolas are fitted to each sensor's measurements in the first 5, 10, 20 and 40 ms (at least eight rows, half of
    them measured). For each duration, weighted least squares convert the slopes of the parabolas at the first row to
    velocities of the rigid motions (those that stretch no belt). Zero velocity is a candidate as well, because a run
    that is driven from its first row on has such slopes even if it begins at rest. The machine is simulated over 50 ms
    with each candidate. The one with the smallest sum of squared errors is chosen; others with at most twice this sum
    remain possible.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad, NaN where not measured).
        machine: Machine with the sensors.
        rigid: Rigid motions, one per column: displacements of the coordinates, m or rad, shape (coordinates, motions).
        position: Position at the first row, m or rad, shape (coordinates,). Forces may depend on it (cogging, cables).

    Returns:
        mean: Velocities of the coordinates, m/s or rad/s, shape (coordinates,).
        deviations: D, shape (errors, coordinates); the covariance D^T D is that of the slopes (noise, vibration of the
            belts) plus the square of 20 % of the speed, or of the difference to the farthest candidate that is possible
            if this is larger. Zeros and no errors if only rest is possible, or no velocity is significant.
    """
    at_rest = InitialVelocity.at_rest(machine)
    if len(recording.time_s) <= _MIN_FITTED_ROWS:
        return at_rest
    noise = np.array(
        [measurement_noise(y, y, s) for y, s in zip(recording.outputs.T, machine.sensors, strict=True)]
    )
    speeds = vibration_speeds(machine)
    vibration = np.array([speeds.get(s.coordinate, 0.0) for s in machine.sensors])
    of_velocity = np.array([s.of_velocity for s in machine.sensors])
    rows = [
        machine.coefficients(s.row) if s.of_position or s.of_velocity else 0.0 * rigid[:, 0]
        for s in machine.sensors
    ]
    sensor_of_motion = np.array(rows) @ rigid
    counts = sorted({_rows_within(recording, seconds) for seconds in _FITTED_S})
    fits = [
        _fit_velocity(recording, rows, sensor_of_motion, noise, vibration, of_velocity) for rows in counts
    ]
    significant = [fit for fit in fits if fit is not None]
    if not significant:
        return at_rest
    # Velocities of the rigid motions: at rest, and as fitted.
    velocities = np.array([np.zeros(rigid.shape[1]), *(fitted for fitted, _ in significant)])
    states = np.hstack([np.tile(position, (len(velocities), 1)), velocities @ rigid.T])
    costs = _costs_of_starts(states, recording, machine, noise)
    best = int(np.argmin(costs))
    possible = costs <= costs[best] / _CERTAIN_COST_RATIO  # all others are excluded
    if best == 0 and not possible[1:].any():
        return at_rest
    travel = np.linalg.norm(
        machine.travel_per_unit[:, None] * rigid, axis=0
    )  # m per unit of each rigid motion
    distance = np.linalg.norm((velocities[possible] - velocities[best]) * travel, axis=1).max()
    error = max(_MIN_ERROR * float(np.linalg.norm(velocities[best] * travel)), float(distance))  # m/s
    covariance = significant[max(best - 1, 0)][1] + np.diag((error / travel) ** 2)
    return InitialVelocity(rigid @ velocities[best], (rigid @ np.linalg.cholesky(covariance)).T)


def _rows_within(recording: Recording, seconds: float) -> int:
    """Return the number of rows within a duration from the first, at least `_MIN_FITTED_ROWS`."""
    return max(int(np.searchsorted(recording.time_s - recording.time_s[0], seconds)), _MIN_FITTED_ROWS)


def _fit_velocity(
    recording: Recording,
    rows: int,
    sensor_of_motion: Array,
    noise: Array,
    vibration: Array,
    of_velocity: NDArray[np.bool_],
) -> tuple[Array, Array] | None:
    """Return the velocities of the rigid motions at the first row and their covariance, from parabolas.

    Args:
        recording: The run.
        rows: Number of the first rows, to which the parabolas are fitted.
        sensor_of_motion: Measurement per unit of each rigid motion, shape (sensors, motions).
        noise: Standard deviation of each sensor, shape (sensors,).
        vibration: Speed of the vibration that each sensor measures in addition to the rigid motions, shape (sensors,).
        of_velocity: True for sensors of velocities, whose parabolas give the velocity by their value, shape (sensors,).

    Returns:
        Velocities (motions,) and covariance (motions, motions); None if they are not significant or not measured.
    """
    time_s = recording.time_s - recording.time_s[0]
    slopes, deviations = np.zeros(len(noise)), np.full(len(noise), np.inf)
    for j, values in enumerate(recording.outputs[:rows].T):
        measured = np.flatnonzero(np.isfinite(values))
        if len(measured) >= _MIN_FITTED_ROWS // 2:
            parabola = np.linalg.pinv(np.vander(time_s[measured], 3, increasing=True))
            slope = parabola[0 if of_velocity[j] else 1]
            slopes[j] = slope @ values[measured]
            deviations[j] = np.hypot(noise[j] * np.linalg.norm(slope), vibration[j])
    weighted = sensor_of_motion / deviations[:, None]
    if np.linalg.matrix_rank(weighted) < weighted.shape[1]:
        return None
    inverse = np.linalg.pinv(weighted)
    velocities, covariance = inverse @ (slopes / deviations), inverse @ inverse.T
    significant = velocities @ np.linalg.solve(covariance, velocities) > _SIGNIFICANT_SPEED**2
    return (velocities, covariance) if significant else None


def _costs_of_starts(states: Array, recording: Recording, machine: Machine, noise: Array) -> Array:
    """Return the sum of squared errors, in units of the noise, of simulations from the given states (starts,).

    Constant errors do not count, because the zeros of encoders are not known yet.
    """
    rows = _rows_within(recording, _COMPARED_S)
    time_s = recording.time_s[:rows] - recording.time_s[0]
    readings = simulate_batch(machine, time_s, recording.inputs[:rows], start=states, states=False).readings
    measured = np.isfinite(recording.outputs[:rows])
    error = np.where(measured, recording.outputs[:rows] - readings, 0.0) / noise
    constant = measured & machine.position_sensors
    error -= np.where(constant, error.sum(axis=1, keepdims=True) / np.maximum(measured.sum(axis=0), 1), 0.0)
    cost = np.sum(error**2, axis=(1, 2))
    return np.where(np.isfinite(cost), cost, np.inf)
