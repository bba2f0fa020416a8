"""Remove from residuals what an uncertain initial state explains (variable projection).

The motion after the start of a run depends on unknowns of its initial state (`start_displacements`). A fit removes the
response to them from its residual; a simulation over a recording starts from the most probable state
(`start_estimation`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simulation import Motion, parameter_batch
from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .prediction import SEARCH_STEP, predict, residuals
from .start_displacements import UncertainStart, uncertain_starts

Array = NDArray[np.float64]


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
