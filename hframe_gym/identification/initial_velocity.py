"""Estimate the velocity of a run that begins in motion, for example one that was cut out of a longer log."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import simulate_batch
from ..machine import Machine
from ..recordings import Recording
from .belt_stretch import vibration_speeds
from .initial_rest import measurement_noise

Array = NDArray[np.float64]
# Durations, s, of the first measurements to which parabolas are fitted: short ones for fast changes, long ones for much
# noise. Their smallest number of rows is more than twice that of a parabola's coefficients.
_FITTED_S, _MIN_ROWS = (0.005, 0.01, 0.02, 0.04), 8
_COMPARED_S = 0.05  # s; first part of the run whose simulations decide between the velocities, and rest
_SIGNIFICANT_SPEED = 5.0  # standard deviations, which noise hardly ever reaches
# Of two starts, one is certainly better if its sum of squared errors is less than this fraction of the other's. The sum
# contains model errors, which do not average out, so no test for independent errors applies.
_CERTAIN = 0.5
_MIN_ERROR = 0.2  # of the speed; belts that vibrate and curved motion falsify the slope of a parabola


class InitialVelocity(NamedTuple):
    """The velocity with which a run begins.

    Attributes:
        mean: Velocities of the coordinates, m/s or rad/s, shape (coordinates,); zero for a run that begins at rest.
        deviations: Square root of their covariance: independent errors, one per row, each of the size of one standard
            deviation, shape (errors, coordinates); no rows if the run certainly begins at rest.
    """

    mean: Array
    deviations: Array

    @classmethod
    def at_rest(cls, machine: Machine) -> InitialVelocity:
        """Return the velocity, zero, of a run that begins at rest.

        Args:
            machine: Machine with the coordinates.

        Returns:
            Zeros, shape (coordinates,), without errors.
        """
        count = len(machine.coordinates)
        return cls(np.zeros(count), np.zeros((0, count)))


def initial_velocity(recording: Recording, machine: Machine, rigid: Array) -> InitialVelocity:
    """Estimate the velocity of a run whose first row is not at rest, from its first measurements.

    Parabolas are fitted to the measurements of the first 5 to 40 ms, at least eight rows, of which half must be
    measured. Weighted least squares convert their slopes at the first row to velocities of the rigid motions (those
    that stretch no belt). A run that begins at rest and is driven from its first row on has such slopes as well.
    Therefore the machine is simulated from rest and with each velocity, and the start is chosen whose simulation is
    closest to the first 50 ms of measurements.

    Args:
        recording: The run (times, s; voltages, V; measurements, m or rad, NaN where not measured).
        machine: Machine with the sensors.
        rigid: Basis of the rigid motions, in the coordinates' units, shape (coordinates, motions).

    Returns:
        Velocities of the coordinates, m/s or rad/s, shape (coordinates,), and their independent errors, shape (errors,
        coordinates). The variance is that of the slopes' noise plus the squared distance to the farthest start whose
        sum of squared errors is at most twice the smallest, or plus (20 % of the speed) squared if that is larger.
        Zeros and no errors if rest is certainly the best, or if the first rows do not measure a velocity.
    """
    at_rest = InitialVelocity.at_rest(machine)
    if len(recording.time_s) <= _MIN_ROWS:
        return at_rest
    noise = np.array([measurement_noise(y, y, s) for y, s in zip(recording.outputs.T, machine.sensors, strict=True)])
    speeds = vibration_speeds(machine)
    vibration = np.array([speeds.get(s.coordinate, 0.0) for s in machine.sensors])
    seen = machine.sensor_matrix @ rigid
    counts = sorted({_first_rows(recording, seconds) for seconds in _FITTED_S})
    fits = [_fit_velocity(recording, rows, seen, noise, vibration) for rows in counts]
    significant = [fit for fit in fits if fit is not None]
    if not significant:
        return at_rest
    # Velocities of the rigid motions: at rest, and as fitted.
    velocities = np.array([np.zeros(rigid.shape[1]), *(fitted for fitted, _ in significant)])
    costs = _costs_of_starts(velocities @ rigid.T, recording, machine, rigid, noise)
    best = int(np.argmin(costs))
    possible = costs <= costs[best] / _CERTAIN  # all others are excluded
    if best == 0 and not possible[1:].any():
        return at_rest
    travel = np.linalg.norm(machine.travel_per_unit[:, None] * rigid, axis=0)  # m per unit of each rigid motion
    distance = np.linalg.norm((velocities[possible] - velocities[best]) * travel, axis=1).max()
    error = max(_MIN_ERROR * float(np.linalg.norm(velocities[best] * travel)), float(distance))  # m/s
    covariance = significant[max(best - 1, 0)][1] + np.diag((error / travel) ** 2)
    return InitialVelocity(rigid @ velocities[best], (rigid @ np.linalg.cholesky(covariance)).T)


def _first_rows(recording: Recording, seconds: float) -> int:
    """Return the number of rows within a duration from the first, at least `_MIN_ROWS`."""
    return max(int(np.searchsorted(recording.time_s - recording.time_s[0], seconds)), _MIN_ROWS)


def _fit_velocity(
    recording: Recording, rows: int, seen: Array, noise: Array, vibration: Array
) -> tuple[Array, Array] | None:
    """Return the velocities of the rigid motions at the first row and their covariance, from parabolas.

    Args:
        recording: The run.
        rows: Number of the first rows, to which the parabolas are fitted.
        seen: Measurement per unit of each rigid motion, shape (sensors, motions).
        noise: Standard deviation of each sensor, shape (sensors,).
        vibration: Speed of the vibration that each sensor measures in addition to the rigid motions, shape (sensors,).

    Returns:
        Velocities (motions,) and covariance (motions, motions); None if they are not significant or not measured.
    """
    time_s = recording.time_s - recording.time_s[0]
    slopes, deviations = np.zeros(len(seen)), np.full(len(seen), np.inf)
    for j, values in enumerate(recording.outputs[:rows].T):
        measured = np.flatnonzero(np.isfinite(values))
        if len(measured) >= _MIN_ROWS // 2:
            slope = np.linalg.pinv(np.vander(time_s[measured], 3, increasing=True))[1]
            slopes[j] = slope @ values[measured]
            deviations[j] = np.hypot(noise[j] * np.linalg.norm(slope), vibration[j])
    weighted = seen / deviations[:, None]
    if np.linalg.matrix_rank(weighted) < seen.shape[1]:
        return None
    inverse = np.linalg.pinv(weighted)
    velocities, covariance = inverse @ (slopes / deviations), inverse @ inverse.T
    significant = velocities @ np.linalg.solve(covariance, velocities) > _SIGNIFICANT_SPEED**2
    return (velocities, covariance) if significant else None


def _costs_of_starts(velocities: Array, recording: Recording, machine: Machine, rigid: Array, noise: Array) -> Array:
    """Return the sum of squared errors, in units of the noise, of simulations from the given velocities (starts,).

    Constant errors do not count, because the zeros of encoders are not known yet.
    """
    rows = _first_rows(recording, _COMPARED_S)
    time_s = recording.time_s[:rows] - recording.time_s[0]
    # Only the stiffness of the belts depends on the position at the start, so a rough estimate suffices.
    fixed = np.array([not s.incremental for s in machine.sensors])
    measured_start = np.nan_to_num(recording.outputs[0, fixed])
    position = rigid @ np.linalg.pinv((machine.sensor_matrix @ rigid)[fixed]) @ measured_start
    start = np.hstack([np.tile(position, (len(velocities), 1)), velocities])
    readings = simulate_batch(machine, time_s, recording.inputs[:rows], start=start, states=False).readings
    measured = np.isfinite(recording.outputs[:rows])
    error = np.where(measured, recording.outputs[:rows] - readings, 0.0) / noise
    error -= np.where(measured, error.sum(axis=1, keepdims=True) / np.maximum(measured.sum(axis=0), 1), 0.0)
    cost = np.sum(error**2, axis=(1, 2))
    return np.where(np.isfinite(cost), cost, np.inf)
