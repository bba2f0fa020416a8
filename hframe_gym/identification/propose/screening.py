"""Rank candidate effects by the reduction of the cost that a linearized model predicts, without fitting any.

The cost is chi-squared, the sum of squared residuals in units of the noise. A candidate effect of small size
adds a known force, or a known change of a measurement, along the fitted machine's motion (`perturbations`).
The response of the predicted measurements to it is one column of the linearized residual. After elimination
of the machine's free parameters, the squared correlation of column and residual is the reduction of the cost
that a fit of the candidate would achieve. Effects that cannot have a small size are ranked by `structures`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...dynamics.simulation import Motion
from ...effects.smooth_table import TABLE_FAMILY
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..budget import spender
from ..fit.estimation import Fit
from ..predict.free_parameters import (
    FreeParameter,
    limits_of_theta,
    minimum_within,
    prior_precision,
    second_difference_penalty,
)
from ..predict.linearization import DIFFERENCE_STEP, ResidualModel
from ..predict.normal_equations import NormalEquations
from ..predict.prediction import mechanical_rows_per_block, predict
from .candidates import Candidate
from .perturbations import (
    PerturbedMachine,
    Unperturbed,
    candidate_perturbations,
    perturbed_machines,
)

_COLUMNS_AT_ONCE = 64  # simulated together: their forces stay in the processor's cache, and memory is bounded
# Where this fraction of the square of a candidate's response or less is left by the machine's free
# parameters, these reproduce it entirely.
_REPRODUCED = 1e-6
# Relative to the diagonal of the information; keeps equations solvable where two effects act alike.
_RIDGE = 1e-9


class ScoredCandidate(NamedTuple):
    """A candidate with its predicted benefit.

    Attributes:
        candidate: Effect, site and starting values.
        gain: Predicted reduction of chi-squared, summed over all samples.
        amounts: Weight of each of its basis functions (`Candidate.columns`) with which this reduction is
            reached, dimensionless.
    """

    candidate: Candidate
    gain: float
    amounts: tuple[float, ...]


class Resemblance(NamedTuple):
    """An effect that the recorded runs hardly distinguish from another one.

    Attributes:
        effect: The effect, with the parameters that make it most similar to the other one.
        loss: Increase of chi-squared if it replaces the other one, to first order.
    """

    effect: AppliedEffect
    loss: float


@dataclass(frozen=True)
class Screening:
    """Candidates of a fitted machine, beside the linearized residual that ranks them.

    A candidate is a weighted sum of basis functions, such as sine and cosine; the weights are called its
    amounts. The residual is linearized with respect to amounts and the machine's free parameters, so that the
    best ones follow from a linear equation.

    Attributes:
        fit: Fit of the machine without the candidates; they are evaluated at its observer bandwidth.
        data: Runs that were fitted.
        candidates: Effects, sites (components) and starting values to compare.
        removable: Labels (name@site) of the machine's effects that may be removed.
        compared: Labels of effects of the machine that the candidates may resemble.
        equations: Normal equations of the linearized residual. Besides derivatives by the free parameters,
            they have responses, in this order: the changes by the removal of each effect in `removable`, each
            effect in `compared`, and the basis functions of the candidates.
    """

    fit: Fit
    data: Dataset
    candidates: Sequence[Candidate]
    removable: tuple[str, ...]
    compared: tuple[str, ...]
    equations: NormalEquations

    @classmethod
    def of(
        cls,
        fit: Fit,
        candidates: Sequence[Candidate],
        data: Dataset,
        *,
        without: Mapping[str, Machine] | None = None,
        compared: Sequence[Candidate] = (),
    ) -> Screening:
        """Linearize the residual of a fit with respect to its free parameters and the candidates' amounts.

        Args:
            fit: Fit of the machine without the candidates.
            candidates: Candidates, at least one.
            data: Runs that were fitted.
            without: Machine that was fitted without an effect, by the label of the effect; `in_place_of`
                ranks the candidates for its place. Default: none.
            compared: Effects of the machine that the candidates may resemble, each with its parameters as the
                only basis function. They neither add coordinates nor replace dry friction.
        """
        model, may_go_on, without = screening_model(fit, data), spender(), without or {}
        of_compared = [
            machine._replace(step=_difference_step(effect))
            for effect in compared
            for machine in perturbed_machines(model.machine, [effect])
        ]
        perturbed = [*of_compared, *perturbed_machines(model.machine, candidates)]

        def responses(run: PreparedRecording, motion: Motion) -> Array:
            may_go_on()
            fitted = model.residuals(run, motion.readings)
            of_removals = [_prediction_residual(model, machine, run) - fitted for machine in without.values()]
            return np.vstack([*of_removals, _responses(model, perturbed, run, motion)])

        equations = model.linearize(fit.theta, responses).normal_equations
        labels = tuple(effect.label for effect in compared)
        return cls(fit, data, candidates, tuple(without), labels, equations)

    def ranked(self) -> list[ScoredCandidate]:
        """Rank the candidates by the reduction of chi-squared that the linearized model predicts.

        Returns:
            Candidates with the weights of their basis functions and the reduction of chi-squared (summed over
            all samples, dimensionless), in the order of decreasing reduction. It is 0 if only an amplitude
            outside its bounds would reduce chi-squared, or if the machine's free parameters can represent the
            candidate.
        """
        return self._ranked(self.equations, self.fit.free)[0]

    def in_place_of(self, label: str) -> tuple[list[ScoredCandidate], float]:
        """Rank the candidates for the place of one removable effect, starting from the machine without it.

        Args:
            label: Label of the effect.

        Returns:
            The other effects that do not need this one, as from `ranked`, and the reduction of chi-squared by
            the effect itself; no candidate and infinity if the machine without it diverges.
        """
        equations = self.equations.with_added(self.removable.index(label))
        if not math.isfinite(equations.cost):
            return [], math.inf
        free = self._free_without(label)
        ranked, least_cost = self._ranked(equations, free)
        others = [scored for scored in ranked if not _needs(scored.candidate, label)]
        return others, least_cost - self.equations.cost

    def resembling(self, label: str) -> list[Resemblance]:
        """Rank the candidates by how well they can take the place of one of the compared effects.

        The changes of the predictions by the effect and by each basis function are compared, after removing
        what the machine's free parameters, without those of the effect, can reproduce. The loss is the
        increase of the cost if the candidate takes the place of the effect: what it cannot represent of the
        effect's change. In a motion that is a single sine, for example, position and speed cannot be
        distinguished; at constant speed, position and time cannot.

        Args:
            label: Label of the effect, one of `compared`.

        Returns:
            Each candidate effect and site once, with the starting values of the smallest loss; the smallest
            loss first. Candidates that require the effect (`Effect.requires`), or represent nothing of it,
            are left out. There is no limit of the loss: the caller decides which are alike.
        """
        effect = len(self.removable) + self.compared.index(label)  # its index among the responses
        free = self._free_without(label)
        equations = self.equations.of_some(self._kept(free), np.array([effect, *self._of_candidates()]))
        ridge = np.diag(_RIDGE * np.diag(equations.information))
        products = equations.eliminate_parameters(prior_precision(free) + ridge).response_information
        size, found = float(products[0, 0]), dict[str, Resemblance]()
        for candidate, columns in self._with_columns(1):
            if _needs(candidate, label):
                continue
            information = products[np.ix_(columns, columns)]
            before = np.diag(equations.response_information)[columns]
            if not np.all(np.isfinite(information)) or not np.any(
                np.diag(information) > _REPRODUCED * before
            ):
                continue
            # The gradient of the cost of representing the effect's regressor, as for the residual.
            scored = _score(candidate, information, -products[columns, 0], before, 1.0)
            loss = max(size - scored.gain, 0.0)
            known = found.get(candidate.label)
            if scored.gain > 0.0 and (known is None or loss < known.loss):
                found[candidate.label] = Resemblance(candidate.applied(scored.amounts), loss)
        return sorted(found.values(), key=lambda resemblance: resemblance.loss)

    def _ranked(
        self, equations: NormalEquations, free: Sequence[FreeParameter]
    ) -> tuple[list[ScoredCandidate], float]:
        """Return the ranked candidates, and the cost without any, where only some parameters are free."""
        equations = equations.of_some(self._kept(free), self._of_candidates())
        # The ridge keeps the elimination possible where parameters have the same influence on the
        # measurements.
        precision = prior_precision(free) + np.diag(_RIDGE * np.diag(equations.information))
        names = {f.name for f in free}
        theta = self.fit.theta[[f.name in names for f in self.fit.free]]
        limited = LimitedResidual.where_limits_bind(equations, precision, free, theta)
        if limited is not None:
            chi2 = self.fit.chi2
            scored = [_limited_score(limited, c, columns, chi2) for c, columns in self._with_columns(0)]
            return sorted(scored, key=lambda s: -s.gain), limited.least_cost
        reduced, scored = equations.eliminate_parameters(precision), []
        for candidate, columns in self._with_columns(0):
            # Square of each response before and after the free parameters took what they can reproduce of it.
            before = equations.response_information[columns, columns]
            information = reduced.response_information[np.ix_(columns, columns)]
            gradient = reduced.response_gradient[columns]
            scored.append(_score(candidate, information, gradient, before, self.fit.chi2))
        return sorted(scored, key=lambda s: -s.gain), equations.least_cost(precision)

    def _free_without(self, label: str) -> tuple[FreeParameter, ...]:
        """Return the free parameters without those of an effect."""
        return tuple(f for f in self.fit.free if not f.name.startswith(f"{label}."))

    def _kept(self, free: Sequence[FreeParameter]) -> NDArray[np.bool_]:
        """Return which of the fit's parameters are free, shape (k,)."""
        names = {f.name for f in free}
        return np.array([f.name in names for f in self.fit.free], bool)

    def _of_candidates(self) -> NDArray[np.intp]:
        """Return the indices of the candidates' basis functions among the responses."""
        return np.arange(len(self.removable) + len(self.compared), len(self.equations.response_gradient))

    def _with_columns(self, first: int) -> Iterator[tuple[Candidate, NDArray[np.intp]]]:
        """Yield each candidate with the indices of its basis functions, which begin at the first."""
        for candidate in self.candidates:
            yield candidate, np.arange(first, first + len(candidate.columns))
            first += len(candidate.columns)


class LimitedResidual:
    """Linearized residual of a fit whose free parameters stay within their limits.

    Without limits, a parameter that is at its limit could move beyond it and reproduce what a candidate
    explains: a negative back-EMF, for example, would replace a bridge that lets its motor coast.

    Args:
        equations: Normal equations with k free parameters; the basis functions of candidates are the
            responses.
        precision: Inverse covariance of the parameters' prior, dimensionless, shape (k, k).
        low: Smallest permitted changes of theta, dimensionless, shape (k,).
        high: Largest permitted changes.

    Attributes:
        least_cost: Cost with the best parameters within their limits, dimensionless.
    """

    def __init__(self, equations: NormalEquations, precision: Array, low: Array, high: Array) -> None:
        self._equations, self._hessian = equations, equations.information + precision
        self._low, self._high = low, high
        step = minimum_within(self._hessian, equations.gradient, low, high)
        self.least_cost, self._least = equations.cost_after(step), self._change(equations.gradient, step)

    @classmethod
    def where_limits_bind(
        cls, equations: NormalEquations, precision: Array, free: Sequence[FreeParameter], theta: Array
    ) -> LimitedResidual | None:
        """Return the linearized residual with limits, or None if the limits make no difference.

        They make none if the best step of the linear model, computed without limits, ends within the limits
        of all parameters. The result is also None if the equations are not finite, because a simulation
        diverges.

        Args:
            equations: Normal equations with k free parameters.
            precision: Inverse covariance of the parameters' prior, dimensionless, shape (k, k).
            free: These parameters.
            theta: Their values in the fit, dimensionless, shape (k,).
        """
        if not equations.finite:
            return None
        low, high = limits_of_theta(free)
        step = -np.linalg.solve(equations.information + precision, equations.gradient)
        if np.all((low <= theta + step) & (theta + step <= high)):
            return None
        return cls(equations, precision, low - theta, high - theta)

    def _change(self, gradient: Array, step: Array) -> float:
        """Return the change of the cost, with the prior's penalty, by a change of theta of shape (k,)."""
        return float(2.0 * step @ gradient + step @ self._hessian @ step)

    def gain_of(self, column: int) -> float:
        """Return the reduction of the cost, dimensionless, by a unit amount of one response.

        The free parameters adapt within their limits, without the response and with it.

        Args:
            column: Index of the response.
        """
        equations = self._equations
        of_parameters = equations.gradient + equations.cross_products[:, column]
        step = minimum_within(self._hessian, of_parameters, self._low, self._high)
        square = float(equations.response_information[column, column])
        change = 2.0 * float(equations.response_gradient[column]) + square
        return self._least - change - self._change(of_parameters, step)

    def gain_of_positive(self, column: int) -> float:
        """Return the reduction of the cost, dimensionless, by the best positive amount of one response.

        It is 0 if every positive amount increases the cost, or if the response diverges.

        Args:
            column: Index of the response.
        """
        columns = np.array([column])
        information = self.information(columns)
        if not information[0, 0] > 0.0 or not self.finite(columns):
            return 0.0
        _, gain = self.best_amounts(columns, _RIDGE * information, np.zeros(1), np.full(1, np.inf))
        return max(gain, 0.0)

    def best_amounts(
        self, columns: NDArray[np.intp], ridge: Array, low: Array, high: Array
    ) -> tuple[Array, float]:
        """Return the amounts of b responses, shape (b,), that reduce the cost most, and the reduction.

        The free parameters adapt within their limits, without the responses and with them.

        Args:
            columns: Indices of the responses, shape (b,).
            ridge: Regularization matrix, added to the inner products of the responses, dimensionless, shape
                (b, b).
            low: Smallest amounts, dimensionless, shape (b,).
            high: Largest amounts, dimensionless, shape (b,).

        Returns:
            Amounts and reduction, both dimensionless.
        """
        cross = self._equations.cross_products[:, columns]
        information = self.information(columns)
        both = np.block([[self._hessian, cross], [cross.T, information + ridge]])
        slope = np.concatenate([self._equations.gradient, self._equations.response_gradient[columns]])
        limits = np.concatenate([self._low, low]), np.concatenate([self._high, high])
        step = minimum_within(both, slope, *limits)
        return step[len(self._low) :], self._least - float(2.0 * step @ slope + step @ both @ step)

    def information(self, columns: NDArray[np.intp]) -> Array:
        """Return the inner products of b responses, dimensionless, shape (b, b).

        Args:
            columns: Indices of the responses, shape (b,).
        """
        return self._equations.response_information[np.ix_(columns, columns)]

    def finite(self, columns: NDArray[np.intp]) -> bool:
        """Return whether the products of responses are finite; not if a simulation of one diverges.

        Args:
            columns: Indices of the responses, shape (b,).
        """
        cross = self._equations.cross_products[:, columns]
        return bool(np.isfinite(self.information(columns)).all() and np.isfinite(cross).all())


def _limited_score(
    limited: LimitedResidual, candidate: Candidate, columns: NDArray[np.intp], chi2: float
) -> ScoredCandidate:
    """Return a candidate with the cost reduction by its best amounts, all parameters within limits.

    Args:
        limited: Linearized residual; the candidate's b basis functions are among its responses.
        columns: Their indices, shape (b,).
        chi2: Chi-squared per sample of the fit, in whose units tables are required to be smooth.
    """
    nothing = ScoredCandidate(candidate, 0.0, (0.0,) * len(columns))
    if not limited.finite(columns):
        return nothing
    if candidate.has_no_amplitude:
        amounts, gain = np.ones(1), limited.gain_of(int(columns[0]))
    else:
        information = limited.information(columns)
        amounts, gain = limited.best_amounts(
            columns, _ridge(candidate, information, chi2), *_limits_of_amounts(candidate)
        )
    return ScoredCandidate(candidate, gain, tuple(amounts.tolist())) if gain > 0.0 else nothing


def _needs(candidate: Candidate, label: str) -> bool:
    """Return whether a candidate requires the effect so labeled."""
    return f"{candidate.effect.requires}@{candidate.site}" == label


def screen(fit: Fit, candidates: Sequence[Candidate], data: Dataset) -> list[ScoredCandidate]:
    """Rank candidates by the reduction of chi-squared that a linearized model predicts, without fits.

    Args:
        fit: Fit of the machine without the candidates.
        candidates: Effects, sites (components) and starting values to compare.
        data: Runs that were fitted.

    Returns:
        The candidates in the order of decreasing reduction, see `Screening.ranked`.
    """
    return Screening.of(fit, candidates, data).ranked() if candidates else []


def screening_model(fit: Fit, data: Dataset) -> ResidualModel:
    """Return the residual of a fit as a function of its free parameters, as screening linearizes it.

    The rows within 4 ms are combined to one (`mechanical_rows_per_block`), to save time.

    Args:
        fit: Fit with its machine, free parameters and observer.
        data: Runs that were fitted.
    """
    return ResidualModel(
        fit.machine, fit.free, data, fit.bandwidth, rows_per_block=mechanical_rows_per_block(data)
    )


def _difference_step(compared: Candidate) -> float:
    """Return the fraction of an effect of the machine that is added to find its response by differences.

    The added part has the same size as that of a candidate, which is a fraction of the typical size. Friction
    that sticks and slips limits how accurately smaller changes are known: to an error of an encoder of 4 % of
    the typical one, the computed response was 3.5 times the true one.
    """
    ratios = [
        abs(parameter.scale * compared.scales.get(parameter.unit, 1.0) / value)
        for parameter in compared.effect.parameters
        if parameter.amplitude and (value := compared.columns[0][parameter.name])
    ]
    return DIFFERENCE_STEP * min(ratios, default=1.0)


def _prediction_residual(model: ResidualModel, machine: Machine, run: PreparedRecording) -> Array:
    """Return the residual of a run that another machine predicts, shape (1, rows)."""
    predicted = predict(
        machine, run, model.bandwidth, period=model.data.period, longest_step=model.longest_step
    )
    return model.residuals(run, predicted.readings)


def _responses(
    model: ResidualModel, perturbed: Sequence[PerturbedMachine], run: PreparedRecording, motion: Motion
) -> Array:
    """Return the derivatives of a run's residual by the columns of candidates, shape (columns, rows)."""
    start = run.initial_state(model.machine)

    def residual(force: Array, measurement: Array | None) -> Array:
        moved = predict(
            model.machine,
            run,
            model.bandwidth,
            period=model.data.period,
            initial_state=start,
            extra_force=force,
            extra_measurement=measurement,
            longest_step=model.longest_step,
        )
        return model.residuals(run, moved.readings)

    # The unperturbed residual comes from the same kernel, the one that takes extra forces.
    unperturbed = residual(np.zeros((1, *motion.positions.shape[1:])), None)
    columns, along = [], Unperturbed(model.machine, run, motion)
    for part in _parts(perturbed):
        force, measurement = candidate_perturbations(along, part)
        step = np.repeat([each.step for each in part], [each.columns for each in part])
        by_column = step[:, None, None]
        force *= by_column
        changed = residual(force, None if measurement is None else by_column * measurement)
        changed -= unperturbed
        columns.append(changed / step[:, None])
    return np.vstack(columns)


def _parts(perturbed: Sequence[PerturbedMachine]) -> Iterator[list[PerturbedMachine]]:
    """Divide perturbed machines, in their order, into parts of few columns."""
    part: list[PerturbedMachine] = []
    for each in perturbed:
        if part and sum(other.columns for other in (*part, each)) > _COLUMNS_AT_ONCE:
            yield part
            part = []
        part.append(each)
    yield part


def _score(
    candidate: Candidate, information: Array, gradient: Array, before: Array, chi2: float
) -> ScoredCandidate:
    """Return a candidate with the reduction of the cost by its best amounts within their bounds.

    Args:
        candidate: Candidate of b basis functions.
        information: Products of their responses, less what the free parameters reproduce of them,
            shape (b, b).
        gradient: Half of the derivative of the cost by the amounts at 0, likewise, shape (b,).
        before: Squares of the complete responses, shape (b,).
        chi2: Chi-squared per sample of the fit, in whose units tables are required to be smooth.
    """
    nothing = ScoredCandidate(candidate, 0.0, (0.0,) * len(gradient))
    if not np.all(np.isfinite(information)) or not np.any(np.diag(information) > _REPRODUCED * before):
        return nothing
    if candidate.has_no_amplitude:
        amounts: Array = np.ones_like(gradient)
    else:
        least = -np.linalg.solve(information + _ridge(candidate, information, chi2), gradient)
        amounts = np.array(np.clip(least, *_limits_of_amounts(candidate)), float)
    gain = float(-2 * amounts @ gradient - amounts @ information @ amounts)
    if not gain > 0.0:
        return nothing
    return ScoredCandidate(candidate, gain, tuple(amounts.tolist()))


def _ridge(candidate: Candidate, information: Array, chi2: float) -> Array:
    """Return what to add to products of a candidate's responses: amounts exist, and tables are smooth."""
    ridge: Array = _RIDGE * np.diag(np.maximum(np.diag(information), 1e-300))
    if candidate.effect.family == TABLE_FAMILY:
        ridge += chi2 * second_difference_penalty(len(information))
    return ridge


def _limits_of_amounts(candidate: Candidate) -> tuple[Array, Array]:
    """Return the smallest and largest amounts of a candidate's basis functions, shape (b,) each.

    A single amplitude stays within its bounds; those of several are clipped with the phase or each for
    itself.
    """
    count = len(candidate.columns)
    if count > 1:
        return np.full(count, -np.inf), np.full(count, np.inf)
    amplitude = candidate.effect.parameter(candidate.effect.amplitudes[0])
    unit = candidate.columns[0][amplitude.name]
    return np.array([amplitude.lower / unit]), np.array([amplitude.upper / unit])
