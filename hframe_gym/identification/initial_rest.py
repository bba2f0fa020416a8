"""Find the rest at the beginning of a run: rows in which no voltage is applied and no sensor shows motion.

The inputs alone do not show rest: a machine may still swing when a log begins, and a voltage that is logged late, or
not at all, is 0 while the machine moves. Counted as rest, such motion would become noise and wrong zeros of sensors. A
run that was cut out of a longer log begins in motion: its first measurements show the velocity.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import simulate_batch
from ..machine import Machine, Sensor
from ..recordings import Recording
from .belt_stretch import vibration_speeds
from .sensor_properties import difference_noise, sensor_quantum

Array = NDArray[np.float64]
_MIN_ROWS = 16  # rows without input; fewer do not show whether the machine moves
_BLOCK_S, _MIN_BLOCKS = 0.01, 8  # duration, s, and number of the blocks of rows whose medians are compared
_STILL_BLOCKS = 5  # blocks that show that a run begins at rest, however long no voltage is applied
_STILL_NOISE = 8.0  # standard deviations of the noise by which the median of a block varies at most at rest
_STILL_RANGE = 3.0  # times the range of the still blocks, likewise; slow noise varies by about as much everywhere
_STILL_SPAN = 1e-4  # fraction of a channel's span in the run that counts as rest, whatever its noise
# Fraction of the span that slow noise (of a filtered sensor) may reach; more is motion, even if it never ceases.
_SLOW_NOISE_SPAN = 1e-3
# Durations, s, of the first measurements to which parabolas are fitted for the velocity, and their smallest number of
# rows; duration of the motion that decides which of them, or rest, is right.
_VELOCITY_S, _MIN_VELOCITY_ROWS, _DECISION_S = (0.005, 0.01, 0.02, 0.04), 8, 0.05
_SIGNIFICANT_SPEED = 5.0  # standard deviations
_CERTAIN = 0.5  # a start is certainly better than another if its error is less than this fraction of the other's
_VELOCITY_ERROR = 0.2  # relative; belts that vibrate and curved motion falsify the slope of a parabola


class InitialVelocity(NamedTuple):
    """The velocity with which a run begins.

    Attributes:
        mean: Velocities of the coordinates, m/s or rad/s, shape (coordinates,); zero for a run that begins at rest.
        deviations: Independent errors of these velocities, one per row, each of the size of one standard deviation,
            shape (errors, coordinates); no rows if the run certainly begins at rest.
    """

    mean: Array
    deviations: Array


class InitialRest(NamedTuple):
    """The rest at the beginning of a run.

    Attributes:
        first: First row at rest; larger than 0 if the machine still moves when the run begins and settles before the
            first input.
        rows: Number of rows up to the end of the rest, those before `first` included; 1 if only the first row counts.
        moving: True for each sensor that moves in these rows, shape (sensors,).
        lead_s: Time by which motion begins before the first input at the latest, s; 0 if it does not.
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
    settles, settling = _departure(medians[::-1], quarter, tolerance)  # as seen from the end
    departs, departing = _departure(medians, min(quarter, _STILL_BLOCKS), tolerance)
    moving = settling | departing
    if not moving.any():  # motion that neither begins nor ceases, unless it is so small that it may be slow noise
        moving = peak_to_peak(medians) > np.maximum(tolerance, _SLOW_NOISE_SPAN * span)
        return rest._replace(rows=1, moving=moving) if moving.any() else rest
    driven = rows < len(recording.time_s)
    if settles and (driven or not departs):
        return rest._replace(first=size * (len(medians) - settles + 1), moving=moving)
    if departs:
        still = size * (departs - 1)
        lead = _lead(recording.time_s[:rows], outputs, still, tolerance) if driven else 0.0
        return rest._replace(rows=still, moving=moving, lead_s=lead)
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

    The velocity at the first row is unknown, but the rest that follows gives the initial state. A simulation that
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


def initial_velocity(recording: Recording, machine: Machine, rigid: Array) -> InitialVelocity:
    """Estimate the velocity with which a run begins from its first measurements.

    Parabolas are fitted to the measurements of the first 5 to 40 ms. Their slopes at the first row give velocities of
    the motions that stretch no belt by weighted least squares. A run that begins at rest and is driven from its first
    row on has such slopes as well. Therefore the machine is simulated from rest and with each velocity; the start whose
    simulation is closest to the measurements of the first 50 ms is chosen. The error is the distance to those starts
    that are about as close, at least 20 %.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad, NaN where not measured).
        machine: Machine with the sensors.
        rigid: Basis of the motions that stretch no belt, in the coordinates' units, shape (coordinates, motions).

    Returns:
        Velocities of the coordinates, m/s or rad/s, shape (coordinates,), and their independent errors, shape (errors,
        coordinates); zeros and no errors for a run that begins at rest.
    """
    at_rest = InitialVelocity(np.zeros(len(rigid)), np.zeros((0, len(rigid))))
    if len(recording.time_s) <= _MIN_VELOCITY_ROWS or count_resting_rows(recording, machine) > 1:
        return at_rest
    noise = np.array([_noise(y, y, s) for y, s in zip(recording.outputs.T, machine.sensors, strict=True)])
    vibration = vibration_speeds(machine)
    vibrations = np.array([vibration.get(s.coordinate, 0.0) for s in machine.sensors])
    seen = machine.sensor_matrix @ rigid
    slopes = [_initial_rates(recording, seconds, seen, noise, vibrations) for seconds in _VELOCITY_S]
    significant = [slope for slope in slopes if slope is not None]
    if not significant:
        return at_rest
    # Rates of the rigid motions: at rest, and as fitted.
    rates = np.array([np.zeros(rigid.shape[1]), *(fitted for fitted, _ in significant)])
    costs = _costs_of_starts(rates @ rigid.T, recording, machine, rigid, noise)
    best = int(np.argmin(costs))
    similar = costs <= costs[best] / _CERTAIN  # all others are excluded
    if best == 0 and not similar[1:].any():
        return at_rest
    distance = np.linalg.norm(rates[similar] - rates[best], axis=1).max()
    error = max(_VELOCITY_ERROR * float(np.linalg.norm(rates[best])), float(distance))
    deviations = np.linalg.cholesky(significant[max(best - 1, 0)][1] + error**2 * np.eye(rates.shape[1]))
    return InitialVelocity(rigid @ rates[best], (rigid @ deviations).T)


def _initial_rates(
    recording: Recording, seconds: float, seen: Array, noise: Array, vibrations: Array
) -> tuple[Array, Array] | None:
    """Return the rates of the rigid motions at the first row and their covariance, from parabolas.

    Args:
        recording: The run.
        seconds: Duration of the measurements that are used.
        seen: Measurement per unit of each rigid motion, shape (sensors, motions).
        noise: Standard deviation of each sensor, shape (sensors,).
        vibrations: Speed of the vibration that each sensor measures beside the rigid motions, shape (sensors,).

    Returns:
        Rates (motions,) and covariance (motions, motions); None if they are not significant or not measured.
    """
    time_s = recording.time_s - recording.time_s[0]
    last = max(int(np.searchsorted(time_s, seconds)), _MIN_VELOCITY_ROWS)
    slopes, deviations = np.zeros(len(seen)), np.full(len(seen), np.inf)
    for j, values in enumerate(recording.outputs[:last].T):
        rows = np.flatnonzero(np.isfinite(values))
        if len(rows) >= _MIN_VELOCITY_ROWS // 2:
            slope = np.linalg.pinv(np.vander(time_s[rows], 3, increasing=True))[1]
            slopes[j] = slope @ values[rows]
            deviations[j] = np.hypot(noise[j] * np.linalg.norm(slope), vibrations[j])
    weighted = seen / deviations[:, None]
    if np.linalg.matrix_rank(weighted) < seen.shape[1]:
        return None
    inverse = np.linalg.pinv(weighted)
    rates, covariance = inverse @ (slopes / deviations), inverse @ inverse.T
    significant = rates @ np.linalg.solve(covariance, rates) > _SIGNIFICANT_SPEED**2
    return (rates, covariance) if significant else None


def _costs_of_starts(velocities: Array, recording: Recording, machine: Machine, rigid: Array, noise: Array) -> Array:
    """Return the sum of squared errors, in units of the noise, of simulations from the given velocities (starts,).

    Constant errors do not count, because the zeros of encoders are not known yet.
    """
    time_s = recording.time_s - recording.time_s[0]
    rows = max(int(np.searchsorted(time_s, _DECISION_S)), _MIN_VELOCITY_ROWS)
    # Where the run begins matters little: the stiffness of the belts depends on it.
    fixed = np.array([not s.incremental for s in machine.sensors])
    position = (
        rigid @ np.linalg.pinv((machine.sensor_matrix @ rigid)[fixed]) @ np.nan_to_num(recording.outputs[0, fixed])
    )
    start = np.hstack([np.tile(position, (len(velocities), 1)), velocities])
    readings = simulate_batch(machine, time_s[:rows], recording.inputs[:rows], start=start, states=False).readings
    measured = np.isfinite(recording.outputs[:rows])
    error = np.where(measured, recording.outputs[:rows] - readings, 0.0) / noise
    error -= np.where(measured, error.sum(axis=1, keepdims=True) / np.maximum(measured.sum(axis=0), 1), 0.0)
    cost = np.sum(error**2, axis=(1, 2))
    return np.where(np.isfinite(cost), cost, np.inf)


def _rows_without_input(recording: Recording) -> int:
    """Return the number of rows up to the first change of an input, at least 1; 1 if an input is not zero at first."""
    changes = np.flatnonzero(np.any(recording.inputs != recording.inputs[0], axis=1))
    if np.any(recording.inputs[0]):
        return 1  # The machine is driven from its first row on; only that row is certainly at rest.
    return int(changes[0]) + 1 if len(changes) else len(recording.time_s)


def _tolerances(recording: Recording, rows: int, machine: Machine) -> tuple[Array, Array]:
    """Return by how much each sensor varies at rest, and its span in the run, in its unit, shape (sensors,) each."""
    tolerances, spans = [], []
    for values, sensor in zip(recording.outputs.T, machine.sensors, strict=True):
        measured = values[np.isfinite(values)]
        span = float(np.ptp(measured)) if len(measured) else 0.0
        tolerances.append(max(_STILL_NOISE * _noise(values[:rows], values, sensor), _STILL_SPAN * span))
        spans.append(span)
    return np.array(tolerances), np.array(spans)


def _noise(values: Array, of_run: Array, sensor: Sensor) -> float:
    """Return the standard deviation of some measurements: measured, declared or of the rounding error, the largest."""
    return max(difference_noise([values]), sensor_quantum([of_run], sensor.resolution) / np.sqrt(12), sensor.noise)


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
    departed = np.abs(medians - center) > np.maximum(tolerance, _STILL_RANGE * variation)  # NaN: not departed
    departing = departed.any(axis=0) & quiet
    first = int(np.argmax(departed[:, departing].any(axis=1))) if departing.any() and quiet.all() else 0
    return first, departing


def _lead(time_s: Array, outputs: Array, still: int, tolerance: Array) -> float:
    """Return the time, s, from the last row in which all channels are as in the first `still` rows to the last row."""
    middle = np.array([np.nanmedian(c) if np.isfinite(c).any() else np.nan for c in outputs[:still].T])
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
