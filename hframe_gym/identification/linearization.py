"""Linearize the prediction residual of a data set around a machine's free parameters.

Everything in identification that needs a Jacobian calls this module: estimation, screening of candidates, covariance
and experiment design.  All perturbed machines of a run are simulated in one batch, one SIMD lane per free parameter,
and the products of the Jacobian's columns are summed over runs.  In simulation mode the unknown initial stretch of the
belts is projected out of the residual and of every column.

Notation: theta (k,) are the free parameters, r(theta) is the residual in units of the sensors' noise, J = dr/dtheta and
E (m columns) are optional responses to perturbations that no free parameter describes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simulation import Motion
from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .free_parameters import FreeParameter, parameter_table, values_at
from .prediction import SEARCH_STEP, Mode, has_feedback, initial_state_of_run, map_runs, predict, residuals

Array = NDArray[np.float64]

# Forward difference in units of theta: far above rounding, far below the scale on which the residual bends.
DIFFERENCE_STEP = 1e-4
# Fraction of the motors' Coulomb friction that typically remains as belt tension when the stage has come to rest.
_HELD_FRICTION = 0.1
_SMALLEST_HELD_ANGLE = 1e-6  # rad; keeps the column of a motor without friction away from zero


def forward_differences(values: Array, step: float = DIFFERENCE_STEP) -> Array:
    """Return the differences of values (k + 1, ...) from the first one, per unit step, shape (k, ...)."""
    differences: Array = (values[1:] - values[0]) / step
    return differences


@dataclass(frozen=True)
class NormalEquations:
    """Products of the linearized residual r + J dtheta + E amounts, summed over rows and runs.

    Attributes:
        information: J^T J, shape (k, k); the Fisher information for white noise.
        gradient: J^T r, shape (k,); half the gradient of the cost.
        cost: r^T r, the sum of squares in units of the noise.
        count: Number of measured values behind the cost.
        cross_products: J^T E, shape (k, m).
        response_information: E^T E, shape (m, m).
        response_gradient: E^T r, shape (m,).
    """

    information: Array
    gradient: Array
    cost: float
    count: int
    cross_products: Array
    response_information: Array
    response_gradient: Array

    @classmethod
    def from_rows(
        cls, jacobian: Array, residual: Array, responses: Array | None = None, *, count: int | None = None
    ) -> NormalEquations:
        """Multiply out one run's linearized residual.

        Args:
            jacobian: J transposed, shape (k, rows).
            residual: r, shape (rows,).
            responses: E transposed, shape (m, rows); default: none.
            count: Number of measured values (default: the number of rows).
        """
        parts = [jacobian, residual[None]] if responses is None else [jacobian, responses, residual[None]]
        stacked = np.vstack(parts)
        products = stacked @ stacked.T
        k = len(jacobian)
        return cls(
            information=products[:k, :k],
            gradient=products[:k, -1],
            cost=float(products[-1, -1]),
            count=residual.size if count is None else count,
            cross_products=products[:k, k:-1],
            response_information=products[k:-1, k:-1],
            response_gradient=products[k:-1, -1],
        )

    @classmethod
    def total(cls, parts: Iterable[NormalEquations]) -> NormalEquations:
        """Sum the normal equations of several runs, of which there must be at least one."""
        fields = [list(values) for values in zip(*(vars(part).values() for part in parts), strict=True)]
        return cls(*(sum(values[1:], start=values[0]) for values in fields))

    @property
    def chi2(self) -> float:
        """Cost per measured value: one when only the sensors' noise remains."""
        return self.cost / self.count

    def eliminate_parameters(self, precision: Array) -> NormalEquations:
        """Return the normal equations of the responses alone, with theta at its optimum for every amount of them.

        Args:
            precision: Prior precision of theta, shape (k, k).

        Returns:
            The Schur complement: no free parameters, response products less what the parameters can mimic.
        """
        hessian = self.information + precision
        right_side = np.column_stack([self.cross_products, self.gradient])
        mimicked = self.cross_products.T @ np.linalg.solve(hessian, right_side)  # (m, m + 1)
        return NormalEquations(
            information=np.zeros((0, 0)),
            gradient=np.zeros(0),
            cost=self.cost,
            count=self.count,
            cross_products=np.zeros((0, len(self.response_gradient))),
            response_information=self.response_information - mimicked[:, :-1],
            response_gradient=self.response_gradient - mimicked[:, -1],
        )


@dataclass(frozen=True)
class InitialStateProjection:
    """Projection that removes the unknown initial stretch of the belts from residuals.

    Attributes:
        directions: Orthonormal responses of the residual to the initial state, shape (rows, s).
        weights: Fraction of each that is removed, between 0 (known by the prior) and 1 (unknown), shape (s,).
    """

    directions: Array
    weights: Array

    def __call__(self, residual: Array) -> Array:
        """Project residuals (batch, rows), so that their squares are the costs at the optimal initial state."""
        return residual - (residual @ self.directions) * self.weights @ self.directions.T


def held_belt_angles(machine: Machine) -> dict[str, float]:
    """Return, by motor coordinate with a sensor, the angle that friction typically holds in the belts at rest, rad."""
    if not machine.belts:
        return {}
    stiffness = float(np.mean([b.EA / b.rest_length for b in machine.belts]))
    measured = {s.coordinate for s in machine.sensors}
    return {
        c.name: max(_HELD_FRICTION * c.coulomb / c.radius**2 / stiffness, _SMALLEST_HELD_ANGLE)
        for c in machine.coordinates
        if c.kind == "rotary" and c.name in measured and c.name not in machine.sprung
    }


@dataclass(frozen=True)
class RunLinearization:
    """Linearized residual of one run, with the initial state projected out.

    Attributes:
        jacobian: J transposed, shape (k, rows).
        responses: E transposed, shape (m, rows), or None.
        residual: r, shape (rows,).
        projection: Projection that was applied; None where the initial state does not matter.
    """

    jacobian: Array
    responses: Array | None
    residual: Array
    projection: InitialStateProjection | None


# Responses (m, rows) of the residual of a run to perturbations along the motion (batch of one) of the expansion point.
Responses = Callable[[PreparedRecording, Motion], Array]


@dataclass(frozen=True)
class ResidualModel:
    """Residual of a data set as a function of a machine's free parameters.

    Attributes:
        machine: Machine that supplies everything but the free parameters.
        free: Free parameters.
        data: Runs to predict.
        mode: "one_step" or "simulation".
        longest_step: Maximum integration step, s.
        rows_per_block: How many rows are averaged into one, see `prediction.residuals`.
    """

    machine: Machine
    free: tuple[FreeParameter, ...]
    data: Dataset
    mode: Mode
    longest_step: float = SEARCH_STEP
    rows_per_block: int = 1

    def machine_at(self, theta: Array) -> Machine:
        """Return the machine with the parameters theta (k,)."""
        return self.machine.replace(values_at(self.free, theta))

    def residuals(self, run: PreparedRecording, measurements: Array) -> Array:
        """Return residuals (batch, rows) of predicted measurements (batch, n, sensors)."""
        return residuals(run, self.data, measurements, self.rows_per_block)

    def linearize_run(
        self, run: PreparedRecording, theta: Array, responses: Responses | None = None
    ) -> RunLinearization:
        """Linearize the residual of one run.

        Args:
            run: Run to predict.
            theta: Expansion point, shape (k,).
            responses: Function that returns additional columns.

        Returns:
            Jacobian, additional columns and residual, all with the initial state projected out.
        """
        machine = self.machine_at(theta)
        thetas = np.vstack([theta, theta + DIFFERENCE_STEP * np.eye(len(self.free))])
        motion = self._predict(machine, run, thetas, states=responses is not None)
        residual = self.residuals(run, motion.readings)  # (k + 1, rows)
        expansion_motion = Motion(*(part[:1] for part in motion))
        extra = None if responses is None else responses(run, expansion_motion)
        projection = self.initial_state_projection(machine, run)
        if projection is not None:
            residual = projection(residual)
            extra = None if extra is None else projection(extra)
        return RunLinearization(forward_differences(residual), extra, residual[0], projection)

    def linearize(self, theta: Array, responses: Responses | None = None) -> Linearization:
        """Linearize the residual of all runs and sum their normal equations.

        Args:
            theta: Expansion point, shape (k,).
            responses: Function that returns additional columns of a run.
        """

        def of_run(run: PreparedRecording) -> tuple[NormalEquations, InitialStateProjection | None]:
            rows = self.linearize_run(run, theta, responses)
            equations = NormalEquations.from_rows(rows.jacobian, rows.residual, rows.responses, count=run.count)
            return equations, rows.projection

        parts = list(map_runs(of_run, self.data))
        projections = {run.name: projection for run, (_, projection) in zip(self.data.runs, parts, strict=True)}
        equations = NormalEquations.total(equations for equations, _ in parts)
        return Linearization(self, self.machine_at(theta), equations, projections)

    def initial_state_projection(self, machine: Machine, run: PreparedRecording) -> InitialStateProjection | None:
        """Return the projection that removes the unknown initial belt stretch of a run.

        Static friction holds an unknown stretch in the belts when a run begins, which encoders behind belts do not
        resolve.  Its effect on the measurements is one column per motor and run; with a Gaussian prior of the size that
        friction can hold, the column is eliminated from residual and Jacobian alike (variable projection).

        Args:
            machine: Machine at the expansion point.
            run: Run to predict.

        Returns:
            The projection, or None in one-step mode (feedback forgets the initial state) and without belts.

        References:
            Golub and Pereyra (1973), variable projection.
        """
        held_angles = {} if has_feedback(self.mode) else held_belt_angles(machine)
        if not held_angles:
            return None
        initial_state = initial_state_of_run(machine, run)
        initial_states = np.tile(initial_state, (len(held_angles) + 1, 1))
        for k, (name, angle) in enumerate(held_angles.items(), start=1):
            initial_states[k, machine.coordinate_names.index(name)] += angle
        motion = predict(
            machine,
            run,
            self.mode,
            period=self.data.period,
            initial_state=initial_states,
            longest_step=self.longest_step,
        )
        residual = self.residuals(run, motion.readings)
        columns = (residual[1:] - residual[0]).T  # (rows, motors), in units of the prior's standard deviation
        if not np.all(np.isfinite(columns)):
            return None
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        return InitialStateProjection(directions, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))

    def _predict(self, machine: Machine, run: PreparedRecording, thetas: Array, *, states: bool = False) -> Motion:
        """Predict a run for a batch of theta; `machine` determines where the run starts."""
        table = parameter_table(self.machine, self.free, thetas)
        return predict(
            machine,
            run,
            self.mode,
            period=self.data.period,
            parameters=table,
            longest_step=self.longest_step,
            states=states,
        )


@dataclass(frozen=True)
class Linearization:
    """Linearized residual of a data set.

    Attributes:
        model: Residual as a function of theta.
        machine: Machine at the expansion point.
        normal_equations: Products of the linearized residual, summed over runs.
        projections: Initial-state projection at the expansion point, by run name.
    """

    model: ResidualModel
    machine: Machine
    normal_equations: NormalEquations
    projections: Mapping[str, InitialStateProjection | None]

    def costs(self, thetas: Array) -> Array:
        """Return the exact costs of trial parameters, with the initial states of the expansion point.

        Args:
            thetas: Trial parameters, shape (batch, k).

        Returns:
            Sums of squares without the prior, shape (batch,); infinite where a simulation diverges.
        """

        def of_run(run: PreparedRecording) -> Array:
            motion = self.model._predict(self.machine, run, thetas)
            residual = self.model.residuals(run, motion.readings)
            projection = self.projections[run.name]
            residual = residual if projection is None else projection(residual)
            squares: Array = np.einsum("bi,bi->b", residual, residual)
            return squares

        total = np.sum(list(map_runs(of_run, self.model.data)), axis=0)
        return np.where(np.isfinite(total), total, np.inf)
