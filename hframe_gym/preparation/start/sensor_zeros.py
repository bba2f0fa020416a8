"""Errors of the sensors' zeros, which a comparison of measurement and simulation may correct."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, Quanta
from ...machine import SENSOR_KINDS, Machine
from .belt_stretch import stretch_angles
from .encoder_zeros import EncoderZeros, zero_tolerance
from .measured_state import InitialState, settled_rows

_FIRST_ROWS = 5  # rows from which the zero of a noisy sensor is estimated if only one row is at rest
_MOVING_STRETCH = 4.0  # times the typical stretch of the belts at the start of a run that begins in motion


def sensor_zero_error(
    error: Array, weights: Array, resting_rows: int, max_mean: Array, quanta: Quanta
) -> Array:
    """Estimate the errors of the sensors' zeros from prediction errors.

    The estimate is the mean error over the complete run, limited to the range +-`max_mean` around the mean
    error over the later half of the rows at rest. The limit is needed because a constant force may also cause
    a mean error. For a sensor without quantization, the first five rows of the run replace a single row at
    rest, which has the noise of one measurement.

    Args:
        error: Measured minus predicted values over n samples, in the sensors' units, 0 if not measured,
            shape (batch, n, sensors).
        weights: Weights of the measurements in the means, dimensionless, 0 where not measured,
            shape (n, sensors).
        resting_rows: Number of rows at rest at the beginning of the run, at least 1.
        max_mean: Largest difference between estimate and mean error at rest, in the sensors' units,
            shape (sensors,); infinite for no limit.

    Returns:
        Errors of the zeros, in the sensors' units, shape (batch, 1, sensors), to be subtracted from `error`.
    """

    def mean(rows: slice) -> Array:
        # An eighth of the time of a product and a sum.
        sums = np.einsum("bns,sn->bs", error[:, rows], np.ascontiguousarray(weights[rows].T))
        return np.asarray(sums / np.maximum(weights[rows].sum(axis=0), 1e-12))

    return zeros_from_means(mean, error.shape[1], resting_rows, max_mean, quanta)[:, None, :]


def zeros_from_means(
    mean: Callable[[slice], Array], rows: int, resting_rows: int, max_mean: Array, quanta: Quanta
) -> Array:
    """Estimate the errors of the sensors' zeros as `sensor_zero_error`, from a function for mean errors.

    Args:
        mean: Function that returns the mean error over rows, in the sensors' units, shape (batch, sensors).
        rows: Number of rows of the run.
        resting_rows: Number of rows at rest at the beginning of the run, at least 1.
        max_mean: Largest difference between estimate and mean error at rest, in the sensors' units,
            shape (sensors,); infinite for no limit.

    Returns:
        Errors of the zeros, in the sensors' units, shape (batch, sensors).
    """
    resting_rows = min(resting_rows, rows)  # the beginning of a run may end before its rest
    at_rest, of_run = mean(settled_rows(resting_rows)), mean(slice(0, rows))
    if resting_rows == 1:
        at_rest = np.where(quanta > 0.0, at_rest, mean(slice(0, min(_FIRST_ROWS, rows))))
    return np.asarray(at_rest + np.clip(of_run - at_rest, -max_mean, max_mean))


def max_zero_means(free: NDArray[np.bool_], quanta: Quanta) -> Array:
    """Return by how much the zero of each sensor may differ from its estimate by the rows at rest.

    The rows at rest determine a zero only to within the quantization. They do not determine that of an
    encoder behind belts, because friction holds an unknown stretch of the belts at rest, nor the offset of a
    sensor such as an accelerometer. Up to these limits, `sensor_zero_error` counts the mean prediction error
    over a run as an error of the zero.

    Args:
        free: True for sensors whose zero the rows at rest do not determine, as from `free_zeros`,
            shape (sensors,).

    Returns:
        Limits, in the sensors' units, shape (sensors,): infinite where `free`, otherwise half a quantization
        step.
    """
    return np.where(free, np.inf, quanta / 2)


def max_reported_zero_means(machine: Machine, initial: InitialState, quanta: Quanta) -> Array:
    """Return by how much the zero of each sensor may differ, in a report, from its estimate at rest.

    The limits replace those of `max_zero_means`, by which a search compares machines and which are infinite
    for encoders behind belts. In a report, the zero of such an encoder accounts only for the stretch of the
    belts that is possible at the start: the rest of the mean error over the run is an error of the model.

    Args:
        machine: Machine whose error is reported.
        initial: Initial state of the run.

    Returns:
        Limits, in the sensors' units, shape (sensors,). For an encoder behind belts, what `zero_tolerance`
        permits; in a run that begins in motion, four times the stretch that the drives typically cause is
        added. Infinite for sensors with an offset, such as accelerometers; otherwise half a quantization
        step.
    """
    behind = behind_belts(machine)
    limits = max_zero_means(free_zeros(machine) & ~behind, quanta)
    if not behind.any():
        return limits
    stretched = zero_tolerance(machine, EncoderZeros.of_machine(machine), quanta)
    if initial.velocity.any():
        angles = stretch_angles(machine, moving=True)
        stretched = stretched + _MOVING_STRETCH * np.array(
            [angles.get(s.coordinate, 0.0) for s in machine.sensors]
        )
    return np.where(behind, stretched, limits)


def behind_belts(machine: Machine) -> NDArray[np.bool_]:
    """Return which sensors are encoders on pulleys, which elastic belts separate from the tool.

    Returns:
        True for such an encoder, shape (sensors,).
    """
    pulleys = [s.incremental and machine.coordinate(s.coordinate).kind == "rotary" for s in machine.sensors]
    return np.array(pulleys) & bool(machine.belts)


def free_zeros(machine: Machine) -> NDArray[np.bool_]:
    """Return which sensors have a zero that the rows at rest do not determine, shape (sensors,).

    These are encoders on pulleys behind belts, and sensors with an offset, such as accelerometers.
    """
    return behind_belts(machine) | np.array([SENSOR_KINDS.get(s.kind).has_offset for s in machine.sensors])


def has_zero(machine: Machine) -> NDArray[np.bool_]:
    """Return which sensors have a zero to estimate, shape (sensors,): for positions or with an offset."""
    return machine.position_sensors | free_zeros(machine)
