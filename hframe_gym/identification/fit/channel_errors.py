"""Errors of a simulated machine by output channel: rms relative to noise and motion, and whiteness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..predict.prediction import POLISH_STEP, SIMULATION, map_runs, predict, prediction_error
from .start_estimation import most_probable_initial_state

_WHITENESS_BLOCK_S = 0.02
_WHITE = 0.6  # standard deviation of block means, in units of the noise
_MOVES = 3.0  # rms motion over noise beyond which a channel moves


class ChannelError(NamedTuple):
    """Simulation error of one output channel; both values are None where the channel was never measured.

    Attributes:
        rmse: Root mean square error, in the channel's unit.
        noise_ratio: `rmse` divided by the standard deviation of the sensor's noise.
        motion_ratio: `rmse` divided by the rms motion, the deviation of the measurements from their mean in
            each run; None also if nothing moves.
    """

    rmse: float | None
    noise_ratio: float | None
    motion_ratio: float | None = None


def simulation_error(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Simulate a run; return measured minus simulated values, without constant errors of uncertain zeros.

    A zero is the measurement at position 0. Its error is estimated from the rows at rest and, within limits,
    from the complete run.

    Args:
        machine: Machine, simulated without feedback from its most probable initial state in this run.
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period and the sensors' quantization steps.

    Returns:
        Errors, in the sensors' units, NaN where not measured, shape (n, sensors).
    """
    start = most_probable_initial_state(machine, run, data)
    motion = predict(
        machine, run, SIMULATION, period=data.period, initial_state=start, longest_step=POLISH_STEP
    )
    error = prediction_error(run, data, motion.readings)[0]
    return np.where(np.isfinite(run.outputs), error, np.nan)


def channel_errors(machine: Machine, data: Dataset) -> dict[str, ChannelError]:
    """Simulate a machine over all runs and return the root mean square error of every output channel.

    Args:
        machine: Machine to simulate, without feedback of the measurements, from its most probable initial
            states.

    Returns:
        By name of the output channel: root mean square error `rmse`, in the channel's unit, and
        `noise_ratio`, dimensionless, the same divided by the standard deviation of the sensor's noise. Both
        are None for a channel without finite errors: it was not measured, or the simulation diverges.
    """
    return errors_by_channel(
        list(map_runs(lambda run: simulation_error(machine, run, data), data)), machine, data.noise
    )


def errors_by_channel(
    by_run: Sequence[Array], machine: Machine, noise: Array, measured: Sequence[Array] = ()
) -> dict[str, ChannelError]:
    """Return the root mean square of given simulation errors over all runs, for every output channel.

    Args:
        by_run: Errors by run, in the sensors' units, NaN where not measured, shape (n, sensors) each.
        noise: Standard deviations of the sensors' noise, in the sensors' units, shape (sensors,).
        measured: Measurements of the same runs, in the sensors' units, shape (n, sensors) each, for the ratio
            of error and motion. Default: without this ratio.

    Returns:
        Errors by name of the output channel, in its unit, and dimensionless relative to noise and motion;
        None for a channel without finite errors. The ratio to the motion is also None if the channel rests.
    """
    error = np.concatenate(by_run)
    motions = (
        np.concatenate([_motion(*run) for run in zip(measured, by_run, strict=True)]) if measured else None
    )
    errors = {}
    for j, channel in enumerate(machine.output_channels):
        column = error[:, j][np.isfinite(error[:, j])]
        if len(column) == 0:
            errors[channel] = ChannelError(None, None)
            continue
        rmse = float(np.sqrt(np.mean(column**2)))
        motion = 0.0 if motions is None else float(np.sqrt(np.nanmean(motions[:, j] ** 2)))
        # A channel that rests measures its noise alone.
        ratio = rmse / motion if motion > _MOVES * float(noise[j]) else None
        errors[channel] = ChannelError(rmse, rmse / float(noise[j]), ratio)
    return errors


def _motion(outputs: Array, error: Array) -> Array:
    """Return the deviations of the measurements (n, sensors) from their mean, NaN where there is no error."""
    values = np.where(np.isfinite(error), outputs, np.nan)
    known = np.isfinite(values)
    return np.asarray(values - np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def white_sensors(machine: Machine, data: Dataset) -> NDArray[np.bool_]:
    """Test whether each sensor's simulation error is white noise with the standard deviation of its noise.

    The test evaluates means over blocks of n measurements (20 ms if none is missing), minus the mean over the
    run. The standard deviation of such a mean is 1 / sqrt(n) of that of a sample if the error is white noise,
    but hardly smaller if it is correlated in time. The repeated rounding error of a sensor at rest counts
    once (`run.weights`).

    Returns:
        True where the standard deviation of the block means is at most 0.6 times that of the noise, or no
        block has been measured, shape (sensors,); False where the simulation diverges.
    """
    rows = max(2, round(_WHITENESS_BLOCK_S / data.period))
    squares, count = np.zeros(len(machine.sensors)), np.zeros(len(machine.sensors))
    for run in data.runs:
        measured, error = np.isfinite(run.outputs), simulation_error(machine, run, data)
        for j in range(len(machine.sensors)):
            values, weights = error[measured[:, j], j], run.weights[measured[:, j], j]
            if not np.isfinite(values).all():
                squares[j] = np.inf
            elif len(values) >= rows:
                means, weights = (
                    v[: len(v) // rows * rows].reshape(-1, rows).mean(axis=1) for v in (values, weights)
                )
                squares[j] += np.sum(weights * (means - np.average(means, weights=weights)) ** 2)
                count[j] += weights.sum()
    return np.asarray(np.sqrt(squares / np.where(count > 0.0, count, 1.0)) <= _WHITE * data.noise)
