"""Normal equations of a linearized residual: the inner products from which a fit computes its steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array


@dataclass(frozen=True)
class NormalEquations:
    """Inner products of r, J and E in the linearized residual r + J dtheta + E a, summed over rows and runs.

    r: residual in units of the noise. J: derivatives of r with respect to k parameters theta. dtheta: change
    of theta, shape (k,). E: changes of r by a unit amount of each of m perturbations, such as forces of
    candidate effects. a: amounts of the perturbations, shape (m,). All are dimensionless.

    Attributes:
        information: J^T J, shape (k, k); Fisher information of the parameters theta for white noise.
        gradient: J^T r, shape (k,); half the gradient of the cost.
        cost: r^T r, the sum of squares in units of the noise.
        count: Number of independent measured values behind the cost.
        cross_products: J^T E, shape (k, m).
        response_information: E^T E, shape (m, m).
        response_gradient: E^T r, shape (m,).
    """

    information: Array
    gradient: Array
    cost: float
    count: float
    cross_products: Array
    response_information: Array
    response_gradient: Array

    @classmethod
    def from_rows(
        cls, jacobian: Array, residual: Array, responses: Array | None = None, *, count: float | None = None
    ) -> NormalEquations:
        """Form the normal equations of one run's linearized residual r + J dtheta + E a.

        dtheta (k,) is a change of the dimensionless parameters theta; a (m,) are the amounts of m
        perturbations, such as forces of candidate effects, in multiples of a unit amount.

        Args:
            jacobian: J transposed: derivatives of r with respect to theta, dimensionless, shape (k, rows).
            residual: Residual r = (measured - predicted) / noise, dimensionless, shape (rows,).
            responses: E transposed: change of r by a unit amount of each perturbation, dimensionless,
                shape (m, rows). Default: none; then m = 0 and the products with E are empty.
            count: Number of independent measured values, dimensionless. Default: the number of rows.

        Returns:
            J^T J, shape (k, k), J^T r (k,), r^T r, J^T E (k, m), E^T E (m, m), E^T r (m,), dimensionless;
            `count`.
        """
        parts = [jacobian, residual[None]] if responses is None else [jacobian, responses, residual[None]]
        stacked = np.vstack(parts)
        with np.errstate(over="ignore", invalid="ignore"):  # a machine that diverges has an infinite cost
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
    def of_pieces(cls, jacobian: Array, residual: Array, count: float, pieces: int) -> list[NormalEquations]:
        """Form the normal equations of successive pieces of one run, which differ by at most one row.

        Args:
            jacobian: J transposed, dimensionless, shape (k, rows).
            residual: Residual r, dimensionless, shape (rows,).
            count: Number of independent measured values of the run, dimensionless; each piece gets an equal
                part of it.
            pieces: Number of pieces.
        """
        parts = zip(np.array_split(jacobian, pieces, 1), np.array_split(residual, pieces), strict=True)
        return [cls.from_rows(*part, count=count / pieces) for part in parts]

    @classmethod
    def total(cls, parts: Iterable[NormalEquations]) -> NormalEquations:
        """Add up the normal equations (products of Jacobian and residual) of runs that are fitted together.

        Args:
            parts: Normal equations of at least one run.
        """
        fields = [list(values) for values in zip(*(vars(part).values() for part in parts), strict=True)]
        return cls(*(sum(values[1:], start=values[0]) for values in fields))

    @property
    def chi2(self) -> float:
        """Chi-squared per sample (mean squared residual / noise variance), 1 if only sensor noise remains."""
        return self.cost / self.count

    @property
    def finite(self) -> bool:
        """Whether cost, J^T r and J^T J are finite; they are not if a simulation diverges."""
        return bool(
            np.isfinite(self.cost)
            and np.isfinite(self.gradient).all()
            and np.isfinite(self.information).all()
        )

    def with_added(self, response: int) -> NormalEquations:
        """Return the normal equations after a unit amount of one perturbation is added to the residual.

        Args:
            response: Index of the perturbation, from 0 to m - 1.
        """
        information, gradient = self.response_information[:, response], self.response_gradient
        return dataclasses.replace(
            self,
            gradient=self.gradient + self.cross_products[:, response],
            cost=self.cost + float(2.0 * gradient[response] + information[response]),
            response_gradient=gradient + information,
        )

    def of_some(self, parameters: NDArray[np.bool_], responses: NDArray[np.intp]) -> NormalEquations:
        """Return the normal equations for a subset of the parameters and perturbations.

        The others stay fixed; the cost is the same.

        Args:
            parameters: True for the parameters of the subset, shape (k,).
            responses: Indices of the perturbations of the subset, in their new order, shape (subset,).
        """
        return dataclasses.replace(
            self,
            information=self.information[np.ix_(parameters, parameters)],
            gradient=self.gradient[parameters],
            cross_products=self.cross_products[np.ix_(parameters, responses)],
            response_information=self.response_information[np.ix_(responses, responses)],
            response_gradient=self.response_gradient[responses],
        )

    def cost_after(self, step: Array) -> float:
        """Return the cost of the linear model after a change of theta, dimensionless.

        Args:
            step: Change of theta, dimensionless, shape (k,).
        """
        return self.cost + float(2.0 * step @ self.gradient + step @ self.information @ step)

    def least_cost(self, precision: Array) -> float:
        """Return the cost of the linear model, dimensionless, after the best change of theta.

        The best change minimizes the cost plus the penalty of the prior; the returned cost is without it.

        Args:
            precision: Inverse covariance of the prior of the change, dimensionless, shape (k, k).
        """
        step = np.linalg.solve(self.information + precision, self.gradient)
        return self.cost_after(np.negative(step, dtype=float))

    def eliminate_parameters(self, precision: Array) -> NormalEquations:
        """Eliminate the k parameters theta (Schur complement), so that only the amounts a remain unknown.

        For every a, theta takes its optimal value. With H = J^T J + precision, the products become
        E^T E - E^T J H^-1 J^T E and E^T r - E^T J H^-1 J^T r.

        Args:
            precision: Inverse covariance of the parameters' prior, dimensionless, shape (k, k).

        Returns:
            Copy with k = 0 and the new `response_information`, shape (m, m), and `response_gradient`,
            shape (m,). The cost r^T r is unchanged.
        """
        hessian = self.information + precision
        right_side = np.column_stack([self.cross_products, self.gradient])
        reproduced = self.cross_products.T @ np.linalg.solve(hessian, right_side)  # (m, m + 1)
        return NormalEquations(
            information=np.zeros((0, 0)),
            gradient=np.zeros(0),
            cost=self.cost,
            count=self.count,
            cross_products=np.zeros((0, len(self.response_gradient))),
            response_information=self.response_information - reproduced[:, :-1],
            response_gradient=self.response_gradient - reproduced[:, -1],
        )
