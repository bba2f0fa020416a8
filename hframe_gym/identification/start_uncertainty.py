"""Remove from residuals what an uncertain initial state explains, and estimate that state from a run.

The motion after the start of a run depends on unknowns of its initial state (`start_displacements`). A fit removes the
response to them from its residual (variable projection); a simulation over a recording starts from the most probable
state.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simulation import Motion, parameter_batch
from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .initial_state import refine_encoder_zeros
from .lost_voltages import estimate_lost_voltages
from .prediction import POLISH_STEP, SEARCH_STEP, SIMULATION, map_runs, predict, residuals
from .rest_measurement import InitialState
from .start_displacements import UncertainStart, effect_state_spreads, start_displacements, uncertain_starts

Array = NDArray[np.float64]
# Iterations of `most_probable_start`, fractions of a step that it tries, and its differences in standard deviations.
_ITERATIONS, _FRACTIONS, _DIFFERENCE = 4, np.array([1.0, 0.5, 0.25, 0.1]), 0.3
_SMALLEST_DECREASE = 0.01  # of the cost per iteration, below which `most_probable_start` ends


@dataclass(frozen=True)
class InitialStateProjection:
    """Projection that removes from residuals what an uncertain initial state, such as a belt stretch, explains.

    The squared norm of a projected residual r is the minimum over w of |r - C w|^2 + |w|^2, where the columns of C are
    the changes of r by displacements of the initial state, each of the size of one standard deviation (variable
    projection). A fit therefore need not estimate the displacements w.

    Attributes:
        directions: Orthonormal basis of the s columns of C, shape (rows, s).
        weights: Fraction of the residual along each direction that is removed, 0 (the prior determines the
            displacement) to 1 (the data determine it), shape (s,).

    References:
        Golub and Pereyra (1973), variable projection.
    """

    directions: Array
    weights: Array

    @classmethod
    def from_displaced(cls, residual: Array, displaced: Array) -> InitialStateProjection | None:
        """Build the projection from the residuals of predictions that start from displaced states.

        Args:
            residual: Residual of the prediction from the state as it is, in units of the noise, shape (rows,).
            displaced: Residuals of predictions from `UncertainStart.displaced_states`, shape (displacements, rows).

        Returns:
            Projection for residuals of shape (batch, rows); None without displacements, or if a prediction diverges.
        """
        columns = (displaced - residual).T
        if not columns.shape[1] or not np.all(np.isfinite(columns)):
            return None
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        return cls(directions, 1.0 - 1.0 / np.hypot(1.0, sizes))  # no overflow close to divergence

    def __call__(self, residual: Array) -> Array:
        """Remove the part of residuals that the optimal displacement of the initial state explains, given its prior.

        Args:
            residual: Residuals of a batch of predictions, in units of the noise, shape (batch, rows).

        Returns:
            Projected residuals, same shape; their sum of squares is the cost at the optimal displacement.
        """
        return residual - (residual @ self.directions) * self.weights @ self.directions.T


def projected(residuals_of_predictions: Array, displacements: int) -> tuple[Array, InitialStateProjection | None]:
    """Remove from residuals what an uncertain initial state explains.

    Args:
        residuals_of_predictions: Residuals in units of the noise, shape (batch + displacements, rows). The first one is
            that of the prediction around which the initial state is displaced; the last ones are those of the displaced
            states, from `predict_with_displaced_starts`.
        displacements: Number of displaced states.

    Returns:
        residuals: Projected residuals, without those of the displaced states, shape (batch, rows).
        projection: Projection for further residuals, shape (batch, rows). None if nothing is uncertain or a prediction
            diverges.
    """
    batch, displaced = np.split(residuals_of_predictions, [len(residuals_of_predictions) - displacements])
    projection = InitialStateProjection.from_displaced(batch[0], displaced)
    return (batch if projection is None else projection(batch)), projection


def predict_with_displaced_starts(
    machine: Machine,
    run: PreparedRecording,
    bandwidth: float,
    start: UncertainStart,
    *,
    period: float,
    parameters: Array | None = None,
    longest_step: float = SEARCH_STEP,
    states: bool = False,
) -> Motion:
    """Predict a run for several sets of parameters, and from displaced initial states, as one batch.

    Args:
        machine: Machine that predicts.
        run: Run to predict, n samples.
        bandwidth: Bandwidth of the observer that corrects the prediction by the measurements, rad/s; 0 for none.
        start: State from which the run is predicted, with s displacements.
        period: Sampling period, s.
        parameters: Parameters, SI, as in `Machine.parameters`, shape (batch, parameters); the first set is also that
            for the displaced states. Default: those of the machine, a batch of one.
        longest_step: Maximum integration step, s.
        states: Whether to return positions and velocities too.

    Returns:
        Motion as from `predict`, shape (batch + s, n, ...): first the sets of parameters, then the displaced states.
    """
    table = parameter_batch(machine) if parameters is None else parameters
    displaced = start.displaced_states
    rows = np.vstack([table, np.repeat(table[:1], len(displaced), axis=0)])
    initial_states = np.vstack([np.tile(start.state, (len(table), 1)), displaced])
    return predict(
        machine,
        run,
        bandwidth,
        period=period,
        parameters=rows,
        initial_state=initial_states,
        extra_measurement=_displaced_zeros(machine, run, initial_states) if bandwidth else None,
        longest_step=longest_step,
        states=states,
    )


def _displaced_zeros(machine: Machine, run: PreparedRecording, initial_states: Array) -> Array | None:
    """Return the changes of the encoders' zeros that displaced initial states imply, shape (batch, 1, sensors).

    An encoder without a known zero counts from the state at the start. If that state is displaced, all of its
    measurements are, which an observer feeds back throughout the run. None if there is no such encoder.
    """
    unknown = np.array([sensor.incremental for sensor in machine.sensors]) & ~run.initial.resolves_stretch
    positions = initial_states[:, : len(machine.coordinates)]
    changes = np.where(unknown, (positions - positions[0]) @ machine.sensor_matrix.T, 0.0)  # (batch, sensors)
    return -changes[:, None] if np.any(changes) else None


def prediction_residuals(
    machine: Machine,
    run: PreparedRecording,
    data: Dataset,
    bandwidth: float,
    *,
    start: UncertainStart | None = None,
    longest_step: float = SEARCH_STEP,
) -> Array:
    """Return a machine's prediction errors over a run, each divided by the standard deviation of the sensor's noise.

    The part of the errors that an unknown initial stretch of the belts (or another unknown part of the initial state)
    can explain is removed, as in a fit.

    Args:
        machine: Machine that predicts.
        run: Run to predict (times, voltages, measurements, SI), n samples.
        data: Data set of the run.
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.
        start: State from which the run is predicted. Default: that of `uncertain_starts`.
        longest_step: Maximum integration step, s.

    Returns:
        Residuals, dimensionless, shape (n * sensors,), 0 where not measured; not finite if the prediction diverges.
    """
    start = start or uncertain_starts(machine, [run])[run.name]
    motion = predict_with_displaced_starts(
        machine, run, bandwidth, start, period=data.period, longest_step=longest_step
    )
    residual, _ = projected(residuals(run, data, motion.readings), len(start.displacements))
    return residual[0]


def most_probable_initial_state(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Return the state from which a run most probably began, given all of its measurements.

    It is the state of maximum posterior density: it fits the measurements and is near the state measured at rest.
    An effect is a deviation from the nominal model. Some effects, such as hysteresis and bristle friction, have states
    of their own, which remember motion before the run.

    Args:
        machine: Machine to simulate, with its effects.
        run: Run as `prepare` returns it: times, voltages, measurements minus the sensors' zeros, initial state.
        data: Data set of the run, for the sampling period and the sensors' quantization steps.

    Returns:
        Positions (m, rad), velocities (m/s, rad/s) and states of the effects (SI), shape (2 * coordinates + effect
        states,).
    """

    def errors(states: Array) -> Array:
        motion = predict(machine, run, SIMULATION, period=data.period, initial_state=states, longest_step=POLISH_STEP)
        return residuals(run, data, motion.readings, fitted=False)  # as `recording_simulation` does for a single run

    # Only positions and velocities are passed: the effects' states are estimated anew, starting from 0.
    state = run.initial_state(machine)[: 2 * len(machine.coordinates)]
    return most_probable_start(machine, run.initial, state, errors)


def refine_dataset(data: Dataset, machine: Machine, reference: Dataset | None = None) -> Dataset:
    """Copy a data set, with the values corrected that were estimated from the recordings without a fitted machine.

    - Zeros of encoders (measurements at position 0): forces that stretch the belts at rest falsify their estimate.
    - Voltages in rows that the logger dropped, which were interpolated: see `estimate_lost_voltages`.
    - Initial states of effects that remember motion before the recording, such as hysteresis. They must be close to the
      true ones, because a fit linearizes the influence of their uncertainty.

    Args:
        data: Data set to correct (times, voltages, measurements, SI).
        machine: Fitted machine with its effects (deviations from the nominal model).
        reference: Data set to which the machine was fitted; the errors of the zeros are estimated from it.
            Default: `data`.

    Returns:
        Copy with corrected initial states, voltages, V, shape (n, drives), and measurements minus the corrected zeros,
        m or rad, shape (n, sensors), of each run; `data` itself if there is nothing to correct.
    """
    data = estimate_lost_voltages(refine_encoder_zeros(data, machine, reference), machine)
    if not np.any(effect_state_spreads(machine) > 0.0):
        return data

    def refined(run: PreparedRecording) -> PreparedRecording:
        start = most_probable_initial_state(machine, run, data)
        states = run.initial.with_start(machine, start).effect_states
        return dataclasses.replace(run, initial=dataclasses.replace(run.initial, effect_states=states))

    return dataclasses.replace(data, runs=tuple(map_runs(refined, data)))


def most_probable_start(
    machine: Machine, initial: InitialState, state: Array, errors: Callable[[Array], Array]
) -> Array:
    """Return the state from which a run most probably began, given all of its measurements.

    It is the state of maximum posterior density. It minimizes the sum of squared simulation errors in units of the
    noise plus the sum of squared displacements from the measured state in units of their standard deviations. The
    squared errors of an inaccurate model are first divided by their mean if it exceeds 1.

    Args:
        machine: Machine to simulate. Its effects (deviations from the nominal model) may have states that remember
            earlier motion, such as hysteresis.
        initial: Measured initial state of the run.
        state: Positions (m, rad), then velocities (m/s, rad/s), by the measurements at rest, shape (2 * coordinates,).
        errors: Function that simulates from states, shape (B, 2 * coordinates + effect states), and returns measured
            minus simulated values in units of the noise, shape (B, values), not finite where the simulation diverges.

    Returns:
        Positions (m, rad), velocities (m/s, rad/s) and effect states (SI), shape (2 * coordinates + effect
        states,). If nothing is uncertain or the simulation diverges: `state` itself, with effect states of zero.

    References:
        Nocedal and Wright (2006), "Numerical optimization", chapter 10 (Gauss-Newton method with a line search).
    """
    (displacements,) = start_displacements(machine, [initial])
    count = len(displacements)
    state = np.pad(state, (0, displacements.shape[1] - len(state)))
    best = np.zeros(count)  # displacements in units of their standard deviations
    differences = _DIFFERENCE * np.vstack([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    for _ in range(_ITERATIONS if count else 0):
        error = errors(state + (best + differences) @ displacements)
        if not np.isfinite(error).all():
            break
        now = error[0]
        response = (error[1 : count + 1] - error[count + 1 :]) / (2.0 * _DIFFERENCE)  # (displacements, values)
        excess = max(1.0, float(np.mean(now**2)))  # mean square error in units of the noise
        weight = 1.0 / np.sqrt(excess)
        # Of full rank by the identity, however large the response is; the normal equations would lose it.
        step = np.linalg.lstsq(
            np.vstack([weight * response.T, np.eye(count)]), np.concatenate([weight * now, best]), rcond=None
        )[0]
        trials = best - _FRACTIONS[:, None] * step
        with np.errstate(invalid="ignore", over="ignore"):
            costs = np.sum(errors(state + trials @ displacements) ** 2, axis=1) / excess + np.sum(trials**2, axis=1)
        cost = float(now @ now) / excess + float(best @ best)
        lowest = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
        if not costs[lowest] < cost:
            break
        best = trials[lowest]
        if cost - costs[lowest] < _SMALLEST_DECREASE * cost:
            break
    return np.asarray(state + best @ displacements)
