"""Find a quantity that differs between runs, such as a payload or the supply voltage.

Identification assumes one machine for all runs. If a parameter had another value in every run, no effect
explains the runs together, although each of them is explained by itself. Here one quantity at a time has a
separate value in each run, fitted together with the parameters that the runs have in common. The result is a
hint for the user: no machine contains it.

Notation: theta (k,) are the optimizer's variables of the free parameters, as in `linearization`; a (n,) are
the dimensionless amounts by which a quantity differs in the n runs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset
from ..judge import run as judge
from ..judge.criteria import SelectionCriteria
from ..predict.free_parameters import FreeParameter, prior_precision, values_at
from ..predict.linearization import Linearization, ResidualModel
from ..predict.prediction import SEARCH_BANDWIDTH
from .estimation import Fit
from .model_error import continue_fit

_AMOUNT_PRIOR = 0.5  # standard deviation of the amounts
_LARGEST_AMOUNT = 1.5
_CANDIDATES = 3  # quantities that are fitted: those that promise most by the linearized residual
_ITERATIONS = 25
_TOLERANCE = 1e-3  # relative decrease of the cost below which a fit ends
_DAMPINGS = (0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
_LEAST_FACTOR = 0.05  # of a mass that is reduced
_STEP = 1e-6  # of finite differences between optimizer variables, which need no simulation


@dataclass(frozen=True)
class Quantity:
    """A physical quantity that may differ between runs, such as a payload.

    Attributes:
        name: Name of the quantity, for messages.
        exponents: Exponent by full name of a parameter. The parameter of a run is value * exp(exponent *
            amount).
        additions: Addition (SI) by full name of a parameter. The parameter of a run is value + addition *
            amount.
    """

    name: str
    exponents: Mapping[str, float] = field(default_factory=dict)
    additions: Mapping[str, float] = field(default_factory=dict)

    def changed(self, values: Mapping[str, float], amount: float) -> dict[str, float]:
        """Compute the parameters of a run in which the quantity differs by a given amount.

        Args:
            values: Parameters that the runs have in common, SI, by full name.
            amount: Dimensionless amount. With 0, the run has the common parameters.

        Returns:
            Parameters of the run, SI, by full name: value * exp(exponent * amount) for those in `exponents`,
            value + addition * amount (at least 5 % of value) for those in `additions`, and the common value
            for all others.
        """
        changed = dict(values)
        for name, exponent in self.exponents.items():
            changed[name] = values[name] * math.exp(exponent * amount)
        for name, addition in self.additions.items():
            changed[name] = max(values[name] + addition * amount, _LEAST_FACTOR * values[name])
        return changed

    def describe(self, amount: float) -> str:
        """Format the difference of the quantity between two runs.

        Args:
            amount: Amount of one run minus that of the other, dimensionless.

        Returns:
            Ratio exp(amount), such as "1.12"; for a quantity with `additions` (a payload), the difference,
            such as "+0.31 kg".
        """
        if self.additions:
            return f"{amount * next(iter(self.additions.values())):+.2g} kg"
        return f"{math.exp(amount):.3g}"


class RunDifferences(NamedTuple):
    """A quantity with a separate value in each run, and the error with and without these values.

    Attributes:
        quantity: The quantity.
        amounts: Amount of each run minus the smallest amount, dimensionless, by name of the run, in the order
            of the runs' times.
        chi2_before: Chi-squared per sample with one machine for all runs.
        chi2: The same with the differences.
        shared: Smallest amount, dimensionless: a difference from the fitted machine that all runs have in
            common.
        explains: Whether the machine with these values explains the runs; otherwise something else is missing
            as well.
    """

    quantity: Quantity
    amounts: dict[str, float]
    chi2_before: float
    chi2: float
    shared: float = 0.0
    explains: bool = True

    @property
    def differs(self) -> bool:
        """Whether the values of the runs differ; if not, all runs need the same other value."""
        return judge.amounts_differ(list(self.amounts.values()), self.shared)

    @property
    def drifts(self) -> bool:
        """Whether the amounts only rise or only fall, but for steps back of less than 5 % of their range."""
        return judge.amounts_drift(list(self.amounts.values()))

    @property
    def different_run(self) -> str | None:
        """Name of the run, if only one needs another value of the quantity than all others; else None."""
        return judge.different_run(self.amounts)

    def __str__(self) -> str:
        """Return a sentence for the user."""
        chi2 = f"chi-squared per sample {self.chi2:.3g} instead of {self.chi2_before:.3g}"
        if not self.differs:
            amount = self.shared + float(np.mean(list(self.amounts.values())))
            change = self.quantity.describe(amount) + (
                "" if self.quantity.additions else " times the fitted value"
            )
            return (
                f"One machine explains all runs with another value of {self.quantity.name} "
                f"than the fit permits, the same in every run: {change} ({chi2}). "
                "That is no difference between runs but a common factor, such as a wrong unit of a column "
                "or a wrong gain: check the units, the constants of the drives and the gear ratios."
            )
        run = self.different_run
        if run is not None:
            amount = self.amounts[run] - float(
                np.mean([a for name, a in self.amounts.items() if name != run])
            )
            change = self.quantity.describe(amount) + (
                "" if self.quantity.additions else " times that of the others"
            )
            rest = (
                "one machine explains all runs"
                if self.explains
                else "much less is left, though not only noise"
            )
            return (
                f"{run} differs from the other runs in {self.quantity.name}: {change}. "
                f"With this, {rest} ({chi2})."
            )
        runs = ", ".join(f"{run} {self.quantity.describe(amount)}" for run, amount in self.amounts.items())
        kind = (
            "Difference from the lightest run" if self.quantity.additions else "Ratio to the smallest value"
        )
        return (
            f"The runs differ: one machine explains all of them if {self.quantity.name} "
            f"has a value of its own in each run ({chi2}). {kind}: {runs}. "
            "Keep it constant while you record, or identify runs with the same value by themselves."
        )


def find_run_differences(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> RunDifferences | None:
    """Find the quantity, such as a payload, whose separate value in each run explains all runs.

    Args:
        fitted: Machine from whose parameters the fits start, fitted to all runs or to those that agree.
        data: All runs (times, voltages, measurements, SI).
        criteria: Decision thresholds of `judge.run.explains_by_run`.

    Returns:
        The quantity with the smallest remaining error that explains the runs by this rule and differs between
        them. None if there is no such quantity, one machine explains all runs, there are fewer than three
        runs, or the machine diverges.
    """
    found = [each for each in _compared(fitted, data, criteria) if each.explains and each.differs]
    return min(found, key=lambda each: each.chi2, default=None)


class RunDifferencesInWords(NamedTuple):
    """Hint for the user about a quantity that has another value in some runs, or in all.

    Attributes:
        sentences: One sentence; none if there is no such quantity.
        explain: Whether the machine explains all runs with these values, so that nothing else is missing.
    """

    sentences: tuple[str, ...] = ()
    explain: bool = False


def describe_run_differences(
    fitted: Fit, data: Dataset, criteria: SelectionCriteria
) -> RunDifferencesInWords:
    """Describe, as a hint for the user, a quantity with another value in some or all runs.

    Args:
        fitted: Machine from whose parameters the fits start, fitted to all runs or to those that agree.
        data: All runs (times, voltages, measurements, SI).
        criteria: Decision thresholds of `judge.run.explains_by_run`.

    Returns:
        One sentence, about the first of these that exists: a quantity that explains the runs and differs
        between them; one that explains the runs with the same other value, beyond its limits, in all; a
        quantity of which a single run needs another value, if one value for all leaves more than ten times
        the error (`judge.run.run_that_differs_alone`). Otherwise no sentence, as with fewer than three runs.
    """
    found = _compared(fitted, data, criteria)
    explaining = [each for each in found if each.explains]
    if explaining:
        best = min(explaining, key=lambda each: (not each.differs, each.chi2))
        return RunDifferencesInWords((str(best),), explain=True)
    nearest = min(found, key=lambda each: each.chi2, default=None)
    alone = nearest and judge.run_that_differs_alone(nearest.different_run, nearest.chi2, nearest.chi2_before)
    return RunDifferencesInWords((str(nearest),) if alone else ())


def best_by_run(fitted: Fit, data: Dataset) -> RunDifferences | None:
    """Return the quantity whose separate value in each run leaves the smallest error.

    It need not explain the runs completely.

    Args:
        fitted: Machine from whose parameters the fits start.
        data: Its runs, two or more (times, voltages, measurements, SI).

    Returns:
        The quantity with its values; None if the machine diverges.
    """
    found = (each for each in _fits_by_run(fitted, data, fitted.chi2) if math.isfinite(each.chi2))
    return min(found, key=lambda each: each.chi2, default=None)


def _compared(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> list[RunDifferences]:
    """Return the most promising quantities with values of their own in each run, equal or different."""
    if len(data.runs) < judge.MIN_RUNS_COMPARED:
        return []
    common = continue_fit(fitted, data, SEARCH_BANDWIDTH)
    if judge.explains_all_runs(common.chi2, common.floor, criteria):
        return []

    def explains(each: RunDifferences) -> bool:
        by_run = dataclasses.replace(common.error, cost=each.chi2 * data.count)
        return judge.explains_by_run(by_run, common.error, criteria)

    # From the machine of the runs that agree: thresholds of effects may be lost in a compromise with a
    # different run.
    return [each._replace(explains=explains(each)) for each in _fits_by_run(fitted, data, common.chi2)]


def _fits_by_run(fitted: Fit, data: Dataset, chi2_before: float) -> Iterator[RunDifferences]:
    """Yield the most promising quantities, each fitted with a value in each run."""
    model = _ModelByRun(fitted, data)
    start = model.linearize(model.start, Quantity("nothing"))
    if not math.isfinite(start.cost):
        return
    promising = sorted(
        _quantities(fitted.machine, model.free), key=lambda quantity: model.promise(start, quantity)
    )
    for quantity in promising[:_CANDIDATES]:
        cost, amounts = model.fit(start, quantity)
        relative = (amounts - amounts.min()).tolist()
        in_time = sorted(zip(data.runs, relative, strict=True), key=lambda pair: float(pair[0].time_s[0]))
        by_run = {run.name: amount for run, amount in in_time}
        yield RunDifferences(quantity, by_run, chi2_before, cost / data.count, float(amounts.min()))


def _quantities(machine: Machine, free: Sequence[FreeParameter]) -> list[Quantity]:
    """Return everything whose difference between runs is tried."""
    names = [f.name for f in free if f.center != 0.0]
    drives = [drive.name for drive in machine.drives]
    found = [Quantity(name, {name: 1.0}) for name in names if name not in [f"{drive}.Kt" for drive in drives]]
    groups = {"dry friction": ".coulomb", "viscous friction": ".viscous", "stiffness of all belts": ".EA"}
    for text, ending in groups.items():
        members = [name for name in names if name.endswith(ending)]
        if len(members) > 1:
            found.append(Quantity(f"the {text}", dict.fromkeys(members, 1.0)))
    for some in [[drive] for drive in drives] + [drives] * (len(drives) > 1):
        of = "all drives" if len(some) > 1 else some[0]
        # Less voltage acts like a smaller torque constant with the same product of torque and back-EMF
        # constant, and larger voltages of effects, such as a dead band; a larger resistance like a smaller
        # torque constant.
        torque, emf = ({name: 1.0 for d in some if (name := f"{d}.{key}") in names} for key in ("Kt", "Ke"))
        if torque:
            inverse = [*emf, *_voltages_of_effects(machine, some, names)]
            found.append(Quantity(f"the voltage of {of}", torque | dict.fromkeys(inverse, -1.0)))
            found.append(Quantity(f"the conductance (1 / winding resistance) of {of}", torque))
    axes = [f"{c.name}.mass" for c in machine.coordinates if c.kind == "linear" and f"{c.name}.mass" in names]
    if len(axes) > 1:
        found.append(Quantity("the payload", additions=dict.fromkeys(axes, 1.0)))
    return found


def _voltages_of_effects(machine: Machine, drives: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return those of some parameters that are voltages of effects on some drives and on no other."""
    return [
        name
        for effect in machine.effects
        for p in effect.definition.parameters
        if p.unit == "V" and (name := f"{effect.label}.{p.name}") in names
        if effect.site in drives or (effect.site == "drives" and len(drives) == len(machine.drives))
    ]


class _Expansion(NamedTuple):
    """Linearized residual of all runs at one point.

    Attributes:
        point: Theta and the amounts, z, shape (k + n,).
        runs: Linearized residual of each run with respect to all K parameters.
        cost: Sum of squared residuals in units of the noise.
    """

    point: Array
    runs: tuple[Linearization, ...]
    cost: float


class _ModelByRun:
    """Residual of runs whose machines differ in one quantity.

    The unknowns z (k + n,) are theta of the k common parameters and the amounts of the n runs. A run is
    simulated with K parameters: torque constants that fits leave as declared, such as that of the first
    drive, may differ as well.

    Args:
        fitted: Machine from which the fits start, with its free parameters.

    Attributes:
        free: The K parameters.
        start: z of the machine from which the fits start.
    """

    def __init__(self, fitted: Fit, data: Dataset) -> None:
        machine, n = fitted.machine, len(data.runs)
        not_fixed = {*(f.name for f in fitted.free), *machine.ties}
        gains = {f"{d.name}.Kt": d.Kt for d in machine.drives if not d.law}
        self._fixed = tuple(
            FreeParameter(name, Kt, 1.0) for name, Kt in gains.items() if name not in not_fixed
        )
        self.free = (*fitted.free, *self._fixed)
        self.start = np.concatenate([fitted.theta, np.zeros(n)])
        self._k, self._count = len(fitted.free), data.count
        self._models = [
            ResidualModel(machine, self.free, run, SEARCH_BANDWIDTH) for run in data.single_runs()
        ]
        self._precision = np.diag(np.full(self._k + n, _AMOUNT_PRIOR**-2))
        self._precision[: self._k, : self._k] = prior_precision(fitted.free)
        low, high = np.array([f.theta_limits for f in fitted.free]).reshape(-1, 2).T
        self._low = np.concatenate([low, np.full(n, -_LARGEST_AMOUNT)])
        self._high = np.concatenate([high, np.full(n, _LARGEST_AMOUNT)])

    def _theta_of_run(self, z: Array, run: int, quantity: Quantity) -> Array:
        """Return the optimizer's variables of the parameters of a run, shape (K,)."""
        theta = np.append(z[: self._k], np.zeros(len(self._fixed)))
        differing = self._differing(quantity)
        values = values_at([self.free[j] for j in differing], theta[differing])
        changed = quantity.changed(values, float(z[self._k + run]))
        theta[differing] = [self.free[j].theta(changed[self.free[j].name]) for j in differing]
        return theta

    def _differing(self, quantity: Quantity) -> list[int]:
        """Return the indices of the parameters that a quantity changes."""
        names = {*quantity.exponents, *quantity.additions}
        return [j for j, f in enumerate(self.free) if f.name in names]

    def _derivatives(self, z: Array, run: int, quantity: Quantity) -> Array:
        """Return the derivatives of `_theta_of_run` with respect to z, shape (K, k + n)."""
        derivatives, steps = np.eye(len(self.free), len(z)), np.eye(len(z)) * _STEP
        derivatives[:, self._k :] = 0.0  # amounts of other runs do not affect this one
        for j in (*(j for j in self._differing(quantity) if j < self._k), self._k + run):
            ends = [self._theta_of_run(z + sign * steps[j], run, quantity) for sign in (1.0, -1.0)]
            derivatives[:, j] = (ends[0] - ends[1]) / (2.0 * _STEP)
        return derivatives

    def linearize(self, z: Array, quantity: Quantity) -> _Expansion:
        """Simulate all runs and linearize their residuals at z, shape (k + n,)."""
        thetas = (self._theta_of_run(z, run, quantity) for run in range(len(self._models)))
        runs = tuple(model.linearize(theta) for model, theta in zip(self._models, thetas, strict=True))
        finite = all(run.normal_equations.finite for run in runs)
        return _Expansion(z, runs, sum(run.normal_equations.cost for run in runs) if finite else math.inf)

    def _equations(self, expansion: _Expansion, quantity: Quantity) -> tuple[Array, Array, Array]:
        """Return Hessian, gradient and precision of the prior with respect to z."""
        z = expansion.point
        hessian, gradient = np.zeros((len(z), len(z))), np.zeros(len(z))
        for i, run in enumerate(expansion.runs):
            equations, derivatives = run.normal_equations, self._derivatives(z, i, quantity)
            hessian += derivatives.T @ equations.information @ derivatives
            gradient += derivatives.T @ equations.gradient
        # The prior keeps its weight relative to the data, as in `estimation.fit`.
        precision = self._precision * max(1.0, expansion.cost / self._count)
        return hessian + precision, gradient + precision @ z, precision

    def promise(self, start: _Expansion, quantity: Quantity) -> float:
        """Return the change of the cost by a difference of a quantity, to first order."""
        hessian, gradient, _ = self._equations(start, quantity)
        return -float(gradient @ np.linalg.solve(hessian, gradient))

    def fit(self, start: _Expansion, quantity: Quantity) -> tuple[float, Array]:
        """Fit theta and the amounts by the Levenberg-Marquardt method.

        Args:
            start: Expansion at `self.start`, where no quantity differs.
            quantity: The quantity with an amount in each run.

        Returns:
            Cost without the prior, and the amounts, dimensionless, shape (n,).
        """
        z, cost, expansion = self.start, math.inf, start
        for iteration in range(_ITERATIONS):
            if iteration:
                expansion = self.linearize(z, quantity)
            if not math.isfinite(expansion.cost):
                break
            hessian, gradient, precision = self._equations(expansion, quantity)
            cost, penalty = expansion.cost, float(z @ precision @ z)
            scaling = np.diag(np.diag(hessian))
            steps = np.array([np.linalg.solve(hessian + d * scaling, -gradient) for d in _DAMPINGS])
            trials = np.clip(z + steps, self._low, self._high)
            costs = np.zeros(len(trials))
            for i, run in enumerate(expansion.runs):
                costs += run.costs(np.array([self._theta_of_run(trial, i, quantity) for trial in trials]))
            totals = costs + np.einsum("bi,ij,bj->b", trials, precision, trials)
            best = int(np.argmin(totals))
            if not totals[best] < (1.0 - _TOLERANCE) * (cost + penalty):
                break
            z, cost = trials[best], float(costs[best])
        return cost, z[self._k :]
