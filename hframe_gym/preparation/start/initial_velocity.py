"""Estimate the velocity with which a run begins from its first measurements."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...dynamics import simulate_batch
from ...machine import Machine
from ...recordings import Recording, peak_to_peak
from .belt_stretch import vibration_speeds
from .rest import NOISE_TOLERANCE, SPEED_ZERO_ERROR, measurement_noise

# Durations, s, of the first measurements to which parabolas are fitted: short ones for fast changes, long
# ones for much noise. Their smallest number of rows is more than twice that of a parabola's coefficients.
_FITTED_S, _MIN_FITTED_ROWS = (0.005, 0.01, 0.02, 0.04), 8
# s from the first row, in which the simulations from rest and with each velocity are compared.
_COMPARED_S = 0.05
_SIGNIFICANT_SPEED = 5.0  # In standard deviations; noise hardly ever reaches it.
# Of two velocities, one is certainly better if its sum of squared errors is less than this fraction of the
# other's. The sum contains model errors, which do not average out, so no test for independent errors applies.
_CERTAIN_COST_RATIO = 0.5
_MIN_ERROR = 0.2  # Fraction of the speed; vibrating belts and curved motion falsify the slope of a parabola.


class InitialVelocity(NamedTuple):
    """The velocity with which a run begins.

    Attributes:
        mean: Velocities of the coordinates, m/s or rad/s, shape (coordinates,); zero for a run that begins at
            rest.
        deviations: Matrix D of independent errors of the velocities, one per row,
            shape (errors, coordinates); D^T D is the covariance of the velocities. No rows if the run begins
            at rest or no velocity is significant.
    """

    mean: Array
    deviations: Array

    @classmethod
    def at_rest(cls, machine: Machine) -> InitialVelocity:
        """Return the initial velocity of a run that begins at rest: zero without uncertainty.

        Returns:
            Velocities, all zero, shape (coordinates,), and no errors of them, shape (0, coordinates).
        """
        count = len(machine.coordinates)
        return cls(np.zeros(count), np.zeros((0, count)))


def initial_velocity(
    recording: Recording, machine: Machine, rigid: Array, position: Array
) -> InitialVelocity:
    """Estimate the velocity of a run whose first row is not at rest, from its first measurements.

    Parabolas are fitted to each sensor's measurements in the first 5, 10, 20 and 40 ms (at least eight rows,
    half of them measured). For each duration, weighted least squares convert the slopes of the parabolas at
    the first row to velocities of the rigid motions (those that stretch no belt). Zero velocity is a
    candidate as well, because a run that is driven from its first row on has such slopes even if it begins at
    rest. The machine is simulated over 50 ms with each candidate. The one with the smallest sum of squared
    errors is chosen; others with at most twice this sum remain possible. The declared machine may be wrong;
    one that is far too light moves alike from any start. Therefore zero is not chosen where uniform motion at
    one of the velocities, without any machine, leaves less than half of the squared errors of the simulation
    from rest, nor where a sensor of a speed shows motion in the first row, which precedes what the input of
    that row causes.

    Args:
        recording: The run (times, s; voltages, V; measurements, in their units, NaN where there is none).
        rigid: Rigid motions, one per column: displacements of the coordinates, m or rad,
            shape (coordinates, motions).
        position: Position at the first row, m or rad, shape (coordinates,). Forces may depend on it (cogging,
            cables).

    Returns:
        mean: Velocities of the coordinates, m/s or rad/s, shape (coordinates,).
        deviations: D, shape (errors, coordinates); the covariance D^T D is that of the slopes (noise,
            vibration of the belts) plus the square of 20 % of the speed, or of the difference to the farthest
            candidate that is possible if this is larger. Zeros and no errors if only rest is possible, or no
            velocity is significant.
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
    simulated = _errors_of_starts(states, recording, machine, noise)
    uniform = _errors_of_uniform_motion(velocities[1:] @ sensor_of_motion.T, recording, machine, noise)
    costs, shown = _costs(simulated), sensor_of_motion.any(axis=1)
    if _shows_speed(recording, machine, noise):
        costs[0] = np.inf
    moves = _costs(uniform[:, :, shown]).min() < _CERTAIN_COST_RATIO * _costs(simulated[:1, :, shown])[0]
    best = int(np.argmin(costs[1:])) + 1 if moves else int(np.argmin(costs))
    possible = costs <= costs[best] / _CERTAIN_COST_RATIO  # all others are excluded
    if best == 0 and not possible[1:].any():
        return at_rest
    # m per unit of each rigid motion
    travel = np.linalg.norm(machine.travel_per_unit[:, None] * rigid, axis=0)
    distance = np.linalg.norm((velocities[possible] - velocities[best]) * travel, axis=1).max()
    error = max(_MIN_ERROR * float(np.linalg.norm(velocities[best] * travel)), float(distance))  # m/s
    covariance = significant[max(best - 1, 0)][1] + np.diag((error / travel) ** 2)
    return InitialVelocity(rigid @ velocities[best], (rigid @ np.linalg.cholesky(covariance)).T)


def _shows_speed(recording: Recording, machine: Machine, noise: Array) -> bool:
    """Return whether a sensor of a speed shows more in the first row than its noise and zero's error."""
    of_velocity = np.array([sensor.of_velocity for sensor in machine.sensors], np.bool_)
    least = np.maximum(NOISE_TOLERANCE * noise, SPEED_ZERO_ERROR * peak_to_peak(recording.outputs))
    return bool(np.any(of_velocity & (np.abs(recording.outputs[0]) > least)))


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
    """Return the rigid motions' velocities at the first row and their covariance, by parabolas over `rows`.

    Sensors `of_velocity` give the velocity by the value of their parabola; each sensor measures the speed
    `vibration` in addition to the rigid motions. None if the velocities are not significant or not measured.
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


def _errors_of_starts(states: Array, recording: Recording, machine: Machine, noise: Array) -> Array:
    """Return errors of simulations from given states over the first 50 ms, shape (starts, rows, sensors)."""
    rows = _rows_within(recording, _COMPARED_S)
    time_s = recording.time_s[:rows] - recording.time_s[0]
    motion = simulate_batch(machine, time_s, recording.inputs[:rows], start=states, states=False)
    return _first_errors(motion.readings, recording, machine, noise)


def _errors_of_uniform_motion(speeds: Array, recording: Recording, machine: Machine, noise: Array) -> Array:
    """Return errors of sensors that see given speeds (starts, sensors) throughout, as `_errors_of_starts`."""
    rows = _rows_within(recording, _COMPARED_S)
    time_s = recording.time_s[:rows] - recording.time_s[0]
    of_time = np.where(machine.position_sensors, time_s[:, None], 1.0)
    return _first_errors(speeds[:, None] * of_time, recording, machine, noise)


def _first_errors(readings: Array, recording: Recording, machine: Machine, noise: Array) -> Array:
    """Return measured minus predicted first measurements (starts, rows, sensors), in units of the noise.

    Constant errors do not count, because the zeros of encoders are not known yet.
    """
    outputs = recording.outputs[: readings.shape[1]]
    measured = np.isfinite(outputs)
    error = np.where(measured, outputs - readings, 0.0) / noise
    constant = measured & machine.position_sensors
    mean = error.sum(axis=1, keepdims=True) / np.maximum(measured.sum(axis=0), 1)
    return np.asarray(error - np.where(constant, mean, 0.0))


def _costs(errors: Array) -> Array:
    """Return the sum of squares of errors (starts, rows, sensors), infinite where a simulation diverges."""
    cost = np.sum(errors**2, axis=(1, 2))
    return np.where(np.isfinite(cost), cost, np.inf)
