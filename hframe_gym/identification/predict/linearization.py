"""Linearize the prediction residual of a data set around a machine's free parameters.

All perturbed machines of a run are simulated in one batch, one SIMD lane per free parameter. The part of the
residual that an unknown initial stretch of the belts explains is removed by projection.

Notation: theta (k,) are the optimizer's variables of the free parameters, r(theta) is the residual in units
of the sensors' noise, J = dr/dtheta at the expansion point. E (m columns) are the changes of r by m
perturbations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ...arrays import Array
from ...dynamics.simulation import Motion
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from .free_parameters import FreeParameter, parameter_table, values_at
from .normal_equations import NormalEquations
from .prediction import SEARCH_STEP, map_runs, predict, residuals, whitened
from .start_uncertainty import (
    InitialStateProjection,
    UncertainStart,
    predict_with_displaced_starts,
    projected,
    uncertain_starts,
)

# Forward difference in units of theta: far above rounding, far below the scale on which the residual is
# nonlinear.
DIFFERENCE_STEP = 1e-4
# Where parts collide, the residual is a rugged function of all parameters; this shows its general slope.
_IMPACT_DIFFERENCE_STEP = 0.01
# Of a threshold, on which measurements depend in steps: wide enough for several recorded voltages to lie
# within.
_SWITCH_DIFFERENCE_STEP = 0.02


def has_impacts(machine: Machine) -> bool:
    """Check whether parts of a machine collide, so that residuals are not smooth functions of parameters.

    Args:
        machine: Machine with its effects, for example play.
    """
    return any(e.definition.impacts for e in machine.effects)


def forward_differences(values: Array, step: float | Array) -> Array:
    """Approximate the derivatives of values with respect to k variables by forward differences.

    Args:
        values: Values, any unit, shape (k + 1, ...): first at the expansion point, then with one variable
            after another increased by `step`.
        step: Increment of each variable, in its unit; one for all, or shape (k,).

    Returns:
        Derivatives, in the unit of the values per unit of the variable, shape (k, ...).
    """
    differences = values[1:] - values[0]
    differences /= np.reshape(step, (-1, *[1] * (values.ndim - 1)))
    return np.asarray(differences)


@dataclass(frozen=True)
class RunLinearization:
    """Linearized residual of one run in units of the noise; an error of the start is projected out.

    Attributes:
        jacobian: Derivatives with respect to k parameters, shape (k, rows).
        responses: Changes by m perturbations, shape (m, rows), or None.
        residual: Residual at the expansion point, shape (rows,).
        projection: The projection that removed what an error of the initial state explains; None if there is
            nothing to remove.
    """

    jacobian: Array
    responses: Array | None
    residual: Array
    projection: InitialStateProjection | None


# Function from a run and its motion at the expansion point (batch of one) to the responses E^T,
# shape (m, rows).
Responses = Callable[[PreparedRecording, Motion], Array]


@dataclass(frozen=True)
class ResidualModel:
    """Residual of a data set as a function of a machine's free parameters.

    Attributes:
        machine: Machine that supplies everything but the free parameters.
        free: Free parameters.
        data: Runs to predict.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.
        longest_step: Maximum integration step, s.
        rows_per_block: How many samples are combined into one row (sum / square root of the number).
        difference_step: Change of theta over which derivatives are computed. Default: 1e-4; 0.01 where parts
            collide (`has_impacts`); 0.02 for a threshold (`FreeParameter.switch`).
    """

    machine: Machine
    free: tuple[FreeParameter, ...]
    data: Dataset
    bandwidth: float
    longest_step: float = SEARCH_STEP
    rows_per_block: int = 1
    difference_step: float | None = None

    def machine_at(self, theta: Array) -> Machine:
        """Return the machine with the parameter values that the optimizer's variables theta describe.

        Args:
            theta: Dimensionless variables of the k free parameters, shape (k,); 0 gives the central values.
        """
        return self.machine.replace(values_at(self.free, theta))

    def residuals(self, run: PreparedRecording, predicted: Array) -> Array:
        """Compare a batch of predictions of a run with its measurements.

        The residual of a sample is (measured - predicted) / standard deviation of the measurement's noise,
        after subtraction of the constant error that a wrong zero of the sensor causes. At rest, a quantized
        sensor repeats one rounding error: N such samples have the weight of one (factor 1 / sqrt(N) each).
        The residuals of `rows_per_block` successive samples form a block with one value per sensor: their sum
        / sqrt(rows_per_block).

        Args:
            run: Measured run of n samples.
            predicted: Predicted measurements of a batch, in the sensors' units, shape (batch, n, sensors).

        Returns:
            Residuals, dimensionless, shape (batch, rows): one row per block and sensor, all sensors of a
            block before the next block; 0 where not measured.
        """
        if self.rows_per_block > 1:
            return residuals(run, self.data, predicted, self.rows_per_block)
        return whitened(residuals(run, self.data, predicted), run, self.bandwidth)

    def at(self, theta: Array) -> ExpansionPoint:
        """Prepare the linearization of the residual at given values of the free parameters.

        Args:
            theta: Dimensionless variables of the k free parameters, shape (k,).

        Returns:
            The machine with these values and, for each run, the state from which it is predicted, shape (2 *
            coordinates + effect states,).
        """
        machine = self.machine_at(theta)
        return ExpansionPoint(self, theta, machine, uncertain_starts(machine, self.data.runs))

    def parameters(self, thetas: Array) -> Array:
        """Convert a batch of theta to complete parameter vectors of the machine.

        Args:
            thetas: Dimensionless variables of the k free parameters, shape (batch, k).

        Returns:
            Parameters in the order of `Machine.parameters`, SI, shape (batch, parameters).
        """
        return parameter_table(self.machine, self.free, thetas)

    def linearize(self, theta: Array, responses: Responses | None = None) -> Linearization:
        """Linearize the residual (prediction error / noise) of all runs as a function of the free parameters.

        Args:
            theta: Dimensionless variables of the k free parameters at the expansion point, shape (k,).
            responses: Function of a run and its motion that returns the changes of the residual by m further
                perturbations, such as other voltages, shape (m, rows). Default: none.

        Returns:
            Normal equations (J^T J, shape (k, k), and J^T r, shape (k,), of Jacobian J and residual r) and
            the projection that removes an uncertain initial state, of each run.
        """
        point = self.at(theta)

        def of_run(run: PreparedRecording) -> tuple[NormalEquations, InitialStateProjection | None]:
            rows = point.linearize_run(run, responses)
            equations = NormalEquations.from_rows(
                rows.jacobian, rows.residual, rows.responses, count=run.count
            )
            return equations, rows.projection

        parts = list(map_runs(of_run, self.data))
        projections = {
            run.name: projection for run, (_, projection) in zip(self.data.runs, parts, strict=True)
        }
        return Linearization(point, tuple(equations for equations, _ in parts), projections)

    @property
    def difference_steps(self) -> Array:
        """Change of each theta over which its derivative is computed, dimensionless, shape (k,).

        It is the attribute `difference_step` if that is given; otherwise 0.02 for a threshold
        (`FreeParameter.switch`), and for others 1e-4, or 0.01 where parts collide.
        """
        if self.difference_step is not None:
            return np.full(len(self.free), self.difference_step)
        step = _IMPACT_DIFFERENCE_STEP if has_impacts(self.machine) else DIFFERENCE_STEP
        return np.array([_SWITCH_DIFFERENCE_STEP if f.switch else step for f in self.free])


@dataclass(frozen=True)
class ExpansionPoint:
    """Values of the free parameters at which a residual is linearized.

    Attributes:
        model: Residual as a function of theta.
        theta: Dimensionless variables of the k free parameters, shape (k,).
        machine: Machine with these values.
        starts: State from which each run is predicted, and its uncertainty, by name of the run.
    """

    model: ResidualModel
    theta: Array
    machine: Machine
    starts: Mapping[str, UncertainStart]

    def linearize_run(self, run: PreparedRecording, responses: Responses | None = None) -> RunLinearization:
        """Linearize the residual (prediction error / noise) of one run as a function of the free parameters.

        Args:
            run: Run to predict, one of the data set.
            responses: Function of the run and its motion that returns the residual's changes by m
                perturbations, shape (m, rows). Default: none.

        Returns:
            Residual, shape (rows,), its derivatives, shape (k, rows), and the responses, shape (m, rows), all
            without the part that an error of the initial state can explain.
        """
        steps = self.model.difference_steps
        residual, projection, motion = self.residuals(run, np.diag(steps), states=responses is not None)
        extra = None if responses is None else responses(run, Motion(*(part[:1] for part in motion)))
        if extra is not None and projection is not None:
            extra = projection(extra)
        return RunLinearization(forward_differences(residual, steps), extra, residual[0], projection)

    def residuals(
        self, run: PreparedRecording, changes: Array, *, states: bool = False
    ) -> tuple[Array, InitialStateProjection | None, Motion]:
        """Predict one run with the parameters of this point and with changed ones; return the residuals.

        Args:
            run: Run to predict, one of the data set.
            changes: Changes of theta, dimensionless, shape (m, k).
            states: Whether the returned motion includes positions and velocities.

        Returns:
            Residuals, unchanged parameters first, shape (1 + m, rows); the projection that removed what an
            error of the initial state can explain, None if there is nothing to remove; the predicted motions,
            followed by those from displaced initial states.
        """
        model, start = self.model, self.starts[run.name]
        motion = predict_with_displaced_starts(
            self.machine,
            run,
            model.bandwidth,
            start,
            period=model.data.period,
            parameters=model.parameters(np.vstack([self.theta, self.theta + changes])),
            longest_step=model.longest_step,
            states=states,
        )
        residual, projection = projected(model.residuals(run, motion.readings), start.differences)
        return residual, projection, motion


@dataclass(frozen=True)
class Linearization:
    """Linearized residual of a data set.

    Attributes:
        point: Values of the free parameters at which it is linearized.
        by_run: Products of each run's linearized residual, in the order of the runs.
        projections: For each run, by its name, what removes from residuals the part that an error of the
            initial state explains; None if such an error explains nothing.
    """

    point: ExpansionPoint
    by_run: tuple[NormalEquations, ...]
    projections: Mapping[str, InitialStateProjection | None]

    @property
    def normal_equations(self) -> NormalEquations:
        """Normal equations of all runs: J^T J, shape (k, k), J^T r, shape (k,), with the Jacobian J."""
        return NormalEquations.total(self.by_run)

    def costs(self, thetas: Array) -> Array:
        """Compute the costs of trial parameters by new predictions instead of the linear model.

        The initial states, and the projection that removes what their errors explain, are those of the
        expansion point.

        Args:
            thetas: Dimensionless variables of the k free parameters for each trial of a batch,
                shape (batch, k).

        Returns:
            Sums of squared residuals in units of the noise, dimensionless, without the prior, shape (batch,);
            infinite where a prediction diverges.
        """
        model, machine = self.point.model, self.point.machine
        parameters = model.parameters(thetas)

        def of_run(run: PreparedRecording) -> Array:
            motion = predict(
                machine,
                run,
                model.bandwidth,
                period=model.data.period,
                parameters=parameters,
                initial_state=self.point.starts[run.name].state,
                longest_step=model.longest_step,
            )
            residual, projection = model.residuals(run, motion.readings), self.projections[run.name]
            if projection is None:
                return np.asarray(np.einsum("bi,bi->b", residual, residual))
            return projection.costs(residual)

        total = np.sum(list(map_runs(of_run, model.data)), axis=0)
        return np.where(np.isfinite(total), total, np.inf)
