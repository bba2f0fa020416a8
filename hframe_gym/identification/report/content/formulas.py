"""Formulas that can take the place of a table in an identified machine.

A table is an effect that interpolates a force or a friction level linearly between values at KNOTS positions,
speeds or times (the knots). It shows what an unknown effect does, but not its cause. Sparse regression
proposes formulas for the values of a table. To compare them, each formula in turn takes the place of the
table, all parameters of the machine are fitted again to the fitted runs (the recordings that identification
used), and the machine simulates the held-out runs (the recordings that it did not use).

The recommended formula is the simplest one whose error is at most 1.1 times the smallest. This error is that
of the machine on the fitted runs. A formula that was fitted only to the values of the table is judged by its
error at knots that were left out of the fit, in standard deviations of the values, and all errors below one
count as equal. The errors on the held-out runs are reported and select nothing.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ....effects.formulas import Formula, FormulaEffect, curve_of_table, fit_formulas, terms_of_table
from ....effects.smooth_table import KNOTS, TABLE_FAMILY
from ....errors import InputError
from ....line_log import LineLog
from ....machine import AppliedEffect, Machine
from ...fit.channel_errors import channel_errors
from ...fit.estimation import Fit, fit, prediction_cost
from ...fit.start_estimation import refine_dataset
from ...judge.table import recommended_formula
from ...predict.free_parameters import FreeParameter, default_free_parameters
from ...predict.prediction import POLISH_STEP, SEARCH_BANDWIDTH, SEARCH_STEP, SIMULATION
from ...propose.candidates import effect_parameters
from ...propose.typical_scales import typical_scales
from . import document
from .result import IdentificationResult

_NAME = "proposed"  # Name of a formula as an effect until the user chooses one.
_MAX_FORMULAS = 3  # per table
_ITERATIONS = 12  # of Levenberg-Marquardt; a formula starts close to its table.


@dataclass(frozen=True)
class ProposedFormula:
    """A formula that can take the place of a table.

    Attributes:
        effect: The formula as an effect named "proposed", with its fitted parameters.
        fitted: Error of the machine with the formula on the fitted runs, in units of the sensor noise (root
            of chi-squared per sample); None if the formula was fitted only to the values of the table.
        held_out: Root-mean-square error of the simulated held-out runs by channel, in units of the sensor
            noise; empty if the formula was fitted only to the values of the table.
        recommended: Whether it is the simplest formula whose error is at most 1.1 times the smallest one.
    """

    effect: FormulaEffect
    fitted: float | None = None
    held_out: dict[str, float] = dataclasses.field(default_factory=dict)
    recommended: bool = False

    @property
    def mean_noise_ratio(self) -> float:
        """Mean over the channels of rms error / sensor noise on the held-out runs, dimensionless.

        It is NaN if the errors are not computed. `PredictionErrors.noise_ratio` is the root mean square over
        the channels instead.
        """
        return mean_error(self.held_out)

    def as_entry(self) -> document.Formula:
        """Return the formula as an entry of `proposed_formulas` in report.json."""
        effect, formula = self.effect, self.effect.formula
        return document.Formula(
            table=effect.table.label,
            terms=[term.name for term in formula.terms],
            formula=effect.text,
            parameters=effect.values,
            complexity=formula.complexity,
            curve_error=formula.error,
            fitted=self.fitted,
            held_out=self.held_out,
            recommended=self.recommended,
        )

    @classmethod
    def from_entry(cls, entry: document.Formula, machine: Machine, table: AppliedEffect) -> ProposedFormula:
        """Create a formula from the entry that `as_entry` returned.

        Args:
            entry: One of the `formulas` of `proposed_formulas` in report.json; its parameters are in the
                order of the terms.
            machine: Identified machine with the table.
            table: Table (force or friction level interpolated over one variable) that the formula can
                replace.

        Returns:
            The formula with its parameters and errors; its effect has a provisional name.

        Raises:
            InputError: If a term is unknown or the number of parameters does not fit the terms.
        """
        known = {term.name: term for term in terms_of_table(table)}
        terms = tuple(known[name] for name in entry.terms if name in known)
        formula = Formula(terms, (), (), entry.curve_error)
        if len(terms) != len(entry.terms) or formula.complexity != len(entry.parameters):
            raise InputError(
                f"report.json: proposed_formulas: {table.label}: the formula {entry.formula!r} has "
                "an unknown term or lacks parameters; run `hframe identify` again to write the folder anew"
            )
        effect = FormulaEffect(_NAME, formula.with_values(entry.parameters.values()), table, machine)
        return cls(effect, entry.fitted, entry.held_out, entry.recommended)

    def with_name(self, name: str, table_error: float) -> ProposedFormula:
        """Return a copy whose effect has a given name, and a note that states the accuracy of the formula.

        The note becomes a paragraph in the file that defines the effect. It compares the error of the machine
        with the formula to that with the table.

        Args:
            name: Name of the effect, a Python identifier in lower case.
            table_error: Error of the machine with the table on the held-out runs, dimensionless: mean over
                the channels of rms error / sensor noise. Ignored if the formula was fitted only to the values
                of the table.

        Returns:
            Copy with the name and the note; its parameters and errors are unchanged.

        Raises:
            InputError: If the name is not such an identifier.
        """
        if self.fitted is None:
            note = (
                "It was fitted to the table alone; "
                "identify the machine with it to see its error on held-out runs."
            )
        else:
            note = (
                f"Error on the held-out runs: {self.mean_noise_ratio:.3g} "
                f"times the sensor noise with this formula of {self.effect.formula.complexity} parameters, "
                f"{table_error:.3g} with the table of {KNOTS} values."
            )
        try:
            effect = dataclasses.replace(self.effect, name=name, notes=(note,))
        except ValueError as error:
            raise InputError(str(error)) from None
        return dataclasses.replace(self, effect=effect)


@dataclass(frozen=True)
class TableComparison:
    """A table and the formulas that can take its place, compared by the machines with them.

    Attributes:
        table: The table.
        fitted: Error of the machine with the table on the fitted runs, in units of the sensor noise (root of
            chi-squared per sample).
        held_out: Root-mean-square error of the held-out runs that the machine with the table simulates, by
            channel, in units of the sensor noise. Channels that are not measured, or whose simulation
            diverges, are left out.
        formulas: Formulas by increasing number of parameters, with their errors.
    """

    table: AppliedEffect
    fitted: float
    held_out: dict[str, float]
    formulas: tuple[ProposedFormula, ...]

    @property
    def mean_noise_ratio(self) -> float:
        """Mean over `held_out` of the errors with the table, in units of the noise; NaN if it is empty."""
        return mean_error(self.held_out)

    def as_entry(self) -> document.TableOfFormulas:
        """Return the table with its formulas as an entry of `proposed_formulas` in report.json."""
        return document.TableOfFormulas(
            table=self.table.label,
            complexity=KNOTS,
            fitted=self.fitted,
            held_out=self.held_out,
            formulas=[formula.as_entry() for formula in self.formulas],
        )


def tables_of(machine: Machine) -> tuple[AppliedEffect, ...]:
    """Return the tables (forces or friction levels over one variable) among a machine's effects."""
    return tuple(e for e in machine.effects if e.definition.family == TABLE_FAMILY)


def propose_formulas(machine: Machine, table: AppliedEffect) -> tuple[ProposedFormula, ...]:
    """Fit formulas to the values of a table (a force or friction level interpolated over one variable).

    Args:
        machine: Identified machine with the table. The covariance of its parameters weights the values;
            without it, all values have the same weight.
        table: Effect of the machine that is such a table.

    Returns:
        At most three formulas by increasing number of parameters; one is recommended. Their errors on runs
        are not computed: `fitted` is None and `held_out` is empty.

    Raises:
        ImportError: If scikit-learn is not installed; the message names the extra `formulas`.
    """
    formulas = fit_formulas(curve_of_table(table, machine), terms_of_table(table), _MAX_FORMULAS)
    return _with_recommendation([ProposedFormula(FormulaEffect(_NAME, f, table, machine)) for f in formulas])


def compare_formulas(
    result: IdentificationResult, log: LineLog = lambda line: None
) -> tuple[TableComparison, ...]:
    """Propose formulas for each table of an identified machine and compare their errors with the table's.

    A table is a force or friction level interpolated over one variable. Each formula takes its place, and all
    parameters of the machine are fitted again. A formula with which the machine diverges is left out.

    Args:
        result: Result of an identification: machines, selected effects and fitted runs.
        log: Called with a line of text for every table and formula.

    Returns:
        One comparison for each table of the identified machine, in the order of the machine's effects.

    Raises:
        ImportError: If the machine has a table and scikit-learn is not installed; the message names the extra
            `formulas`.
    """
    machine = result.after.machine
    tables = tables_of(machine)
    if not tables:
        return ()
    runs = _Runs(result)
    error, held_out = runs.error(machine), runs.held_out(machine)
    comparisons = []
    for table in tables:
        log(f"formulas for {table.label}; error on the held-out runs in units of the sensor noise:")
        log(f"  table of {KNOTS} values: {mean_error(held_out):.4g}")
        formulas = []
        for proposal in propose_formulas(machine, table):
            formula = _refitted(proposal.effect, machine, runs, table_error=error)
            form = proposal.effect.formula
            errors = f"{formula.mean_noise_ratio:.4g}" if formula else "the simulation diverges"
            log(f"  {form.name}, {form.complexity} parameters: {errors}")
            formulas += [formula] if formula else []
        comparisons.append(TableComparison(table, error, held_out, _with_recommendation(formulas)))
    return tuple(comparisons)


def mean_error(errors: Mapping[str, float]) -> float:
    """Return the mean of `errors` by channel, in units of the noise, dimensionless; NaN if there is none."""
    return float(np.mean(list(errors.values()))) if errors else math.nan


def _with_recommendation(formulas: Sequence[ProposedFormula]) -> tuple[ProposedFormula, ...]:
    """Return the formulas with the recommended one marked (see the module's docstring)."""
    errors = [max(1.0, p.effect.formula.error) if p.fitted is None else p.fitted for p in formulas]
    recommended = recommended_formula(errors)
    return tuple(dataclasses.replace(p, recommended=i == recommended) for i, p in enumerate(formulas))


class _Runs:
    """Fitted and held-out runs of a result of `identify`, for machines fitted and compared in one way."""

    def __init__(self, result: IdentificationResult) -> None:
        self._result = result
        machine = result.after.machine
        self._data = refine_dataset(result.fitted, machine)
        self._bandwidth = self._observer_bandwidth(machine)
        self._step = POLISH_STEP if self._bandwidth == SIMULATION else SEARCH_STEP
        without_parameters = Fit(machine, (), np.zeros(0), 0.0, 1, self._bandwidth, np.zeros((0, 0)))
        self._scales = typical_scales(without_parameters, self._data)

    def _observer_bandwidth(self, machine: Machine) -> float:
        """Return the bandwidth of the simulation, or that of an observer if the simulation drifts away."""
        errors = channel_errors(machine, self._data)
        outputs = np.concatenate([run.outputs for run in self._data.runs])
        rmse = np.array([errors[c].rmse or 0.0 for c in machine.output_channels])
        drift = rmse / np.maximum(np.nanstd(outputs, axis=0), 1e-12)
        return SIMULATION if drift.max() < self._result.criteria.max_drift else SEARCH_BANDWIDTH

    def error(self, machine: Machine) -> float:
        """Return the error of a machine on the fitted runs, in units of the sensor noise."""
        cost = prediction_cost(machine, self._data, self._bandwidth, longest_step=self._step)
        return math.sqrt(cost / self._data.count)

    def held_out(self, machine: Machine) -> dict[str, float]:
        """Return the error of the simulated held-out runs by channel, in units of the sensor noise."""
        errors = channel_errors(machine, refine_dataset(self._result.held_out, machine, self._result.fitted))
        return {channel: e.noise_ratio for channel, e in errors.items() if e.noise_ratio is not None}

    def fit(self, machine: Machine, target_chi2: float) -> Fit:
        """Fit all parameters of a machine and its effects, starting from their values.

        A fit in simulation needs a close start. If it ends above `target_chi2` (chi-squared per sample), it
        is repeated from the fit with an observer, and the better fit is returned.
        """
        free = self._free_parameters(machine)
        values = machine.parameters
        theta = np.array([f.theta(values[f.name]) for f in free])
        fit_machine = partial(fit, machine, free, self._data, iterations=_ITERATIONS)
        best = fit_machine(self._bandwidth, theta=theta, longest_step=self._step)
        if self._bandwidth == SIMULATION and best.chi2 > target_chi2:
            start = fit_machine(SEARCH_BANDWIDTH, theta=theta, longest_step=SEARCH_STEP)
            repeated = fit_machine(self._bandwidth, theta=start.theta, longest_step=self._step)
            best = min(best, repeated, key=lambda fitted: fitted.cost)
        return best

    def _free_parameters(self, machine: Machine) -> tuple[FreeParameter, ...]:
        """Return free parameters of a machine and its effects; declared values limit the former."""
        declared = {f.name: f for f in default_free_parameters(self._result.declared.machine, effects=False)}
        free = [declared.get(f.name, f) for f in default_free_parameters(machine, effects=False)]
        for effect in machine.effects:
            free += effect_parameters(effect, machine, self._scales)
        return tuple(free)


def _refitted(
    effect: FormulaEffect, machine: Machine, runs: _Runs, *, table_error: float
) -> ProposedFormula | None:
    """Fit a machine with a formula in the place of its table; None if the machine diverges."""
    applied = effect.applied()
    effects = tuple(applied if e.label == effect.table.label else e for e in machine.effects)
    fitted = runs.fit(machine.replace(effects=effects, uncertainty=None), target_chi2=table_error**2)
    held_out = runs.held_out(fitted.machine)
    if not np.isfinite([fitted.chi2, *held_out.values()]).all():
        return None
    parameters = next(e.parameters for e in fitted.machine.effects if e.name == applied.name)
    formula = effect.formula.with_values(parameters.values())
    return ProposedFormula(dataclasses.replace(effect, formula=formula), math.sqrt(fitted.chi2), held_out)
