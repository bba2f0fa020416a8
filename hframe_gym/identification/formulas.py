"""Formulas for the tables of an identified machine, compared with the tables on the held-out runs.

A table (a force or friction level that is interpolated between knots of one variable) names no cause. Sparse regression
proposes closed forms for it. Each form then takes the place of the table, and all parameters of the machine are fitted
again, so that a formula is compared by the error of the simulated machine and not only by the shape of the curve.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..effects.formulas import Curve, Formula, FormulaEffect, fit_formulas, terms_of
from ..effects.smooth_table import KNOTS, TABLE_FAMILY
from ..errors import InputError
from ..machine import AppliedEffect, Machine
from .candidates import effect_parameters
from .dataset import TypicalScales
from .estimation import Fit, fit, prediction_cost
from .free_parameters import FreeParameter, default_free_parameters
from .prediction import POLISH_STEP, SEARCH_BANDWIDTH, SEARCH_STEP, SIMULATION
from .residual import channel_errors
from .result import IdentificationResult
from .saved_result import SavedResult, load_result
from .start_uncertainty import refine_starts
from .trial_fits import typical_scales

Array = NDArray[np.float64]
NAME = "proposed"
_MAX_FORMULAS = 3
_ITERATIONS = 12
_CLOSE = 1.1  # A simpler formula is recommended if its error on the fitted runs is below this times the smallest.


@dataclass(frozen=True)
class ProposedFormula:
    """A formula that can take the place of a table.

    Attributes:
        effect: The formula as an effect named "proposed", with the parameters of the last fit.
        fitted: Error on the fitted runs in units of the noise, the root of chi-squared per sample; None if the formula
            was fitted to the table alone.
        held_out: Root-mean-square error on the held-out runs in units of the sensor's noise by channel; empty if the
            formula was fitted to the table alone.
        recommended: Whether it is the simplest formula whose error on the fitted runs is close to the smallest.
    """

    effect: FormulaEffect
    fitted: float | None = None
    held_out: dict[str, float] = dataclasses.field(default_factory=dict)
    recommended: bool = False

    @property
    def noise_ratio(self) -> float:
        """Error on held-out (not fitted) runs / sensor noise, mean over channels, dimensionless; NaN without runs."""
        return float(np.mean(list(self.held_out.values()))) if self.held_out else math.nan

    def as_json(self) -> dict[str, Any]:
        """Convert the formula to an entry of `proposed_formulas` in report.json.

        Returns:
            "table": label of the table; "terms": names of the terms; "formula": the equation as text; "parameters":
            values by name, SI; "complexity": number of parameters; "curve_error": see `Formula.error`; "fitted",
            "held_out" and "recommended": the attributes of these names.
        """
        effect, formula = self.effect, self.effect.formula
        return {
            "table": effect.table.label,
            "terms": [term.name for term in formula.terms],
            "formula": effect.text,
            "parameters": effect.values,
            "complexity": formula.complexity,
            "curve_error": formula.error,
            "fitted": self.fitted,
            "held_out": self.held_out,
            "recommended": self.recommended,
        }


def tables_of(machine: Machine) -> tuple[AppliedEffect, ...]:
    """Return the tables (forces or friction levels interpolated over one variable) among a machine's effects.

    Args:
        machine: Identified machine with its effects (deviations from the nominal model).

    Returns:
        Tables with their site and values, in the order of the machine's effects.
    """
    return tuple(e for e in machine.effects if e.definition.family == TABLE_FAMILY)


def propose_formulas(machine: Machine, table: AppliedEffect) -> tuple[ProposedFormula, ...]:
    """Propose formulas for a table (force interpolated over one variable) from its values and their covariance.

    Args:
        machine: Identified machine with the table and, if known, the covariance of its parameters.
        table: One of `tables_of(machine)`.

    Returns:
        Formulas by increasing complexity. The recommended one is the simplest that predicts left-out knots of the table
        with an error below one standard deviation, or with an error close to the smallest.

    Raises:
        ImportError: If scikit-learn is not installed; the message names the extra `formulas`.
    """
    variable = table.definition.against.partition(" of ")[0]
    terms = terms_of(variable, force=table.name.startswith("smooth_force"))
    formulas = fit_formulas(_curve(machine, table), terms, _MAX_FORMULAS)
    limit = max(1.0, _CLOSE * min(formula.error for formula in formulas))
    simplest = next(formula for formula in formulas if formula.error <= limit)
    return tuple(ProposedFormula(FormulaEffect(NAME, f, table, machine), recommended=f is simplest) for f in formulas)


def _curve(machine: Machine, table: AppliedEffect) -> Curve:
    """Return the values of a table with their covariance."""
    knots = np.array([table.parameters[f"k{i:02d}"] for i in range(KNOTS)])
    values = np.array([table.parameters[f"f{i:02d}"] for i in range(KNOTS)])
    covariance = np.zeros((KNOTS, KNOTS))
    uncertainty = machine.uncertainty
    names = [f"{table.label}.f{i:02d}" for i in range(KNOTS)]
    if uncertainty is not None and set(names) <= set(uncertainty.names):
        index = [uncertainty.names.index(name) for name in names]
        covariance = uncertainty.covariance[np.ix_(index, index)]
    return Curve(knots, values, covariance, _absorbed(table, knots))


def _absorbed(table: AppliedEffect, knots: Array) -> Array:
    """Return the curves that the coordinate's Coulomb and viscous friction can represent, shape (knots, curves)."""
    of_speed = table.definition.against == f"velocity of {table.site}"
    if table.name.startswith("smooth_friction"):
        return np.stack([np.ones_like(knots), *([np.abs(knots)] if of_speed else [])], axis=1)
    return np.stack([knots], axis=1) if of_speed else np.zeros((len(knots), 0))


def formulas_of_folder(folder: Path, name: str, table: str = "") -> tuple[ProposedFormula, ...]:
    """Return formulas that can replace a table (force interpolated over one variable) of a saved identification.

    They are the ones that `hframe identify` compared on held-out runs (not fitted). If it compared none, formulas are
    fitted to the table alone and have no errors on runs.

    Args:
        folder: Folder that `write_result` wrote.
        name: Name to give to the formulas as effects, a Python identifier in lower case that no effect has.
        table: Label of the table, for example "smooth_force[position of x]@x". Default: the first one.

    Returns:
        Formulas with parameters and errors by increasing complexity; exactly one is recommended.

    Raises:
        InputError: If the folder has no result or no such table, or the name cannot be used.
        ImportError: If the formulas must be fitted and scikit-learn is not installed.
    """
    saved = load_result(folder)
    tables = {e.label: e for e in tables_of(saved.machine)}
    if not tables:
        raise InputError(f"{folder}: the identified machine has no table for which a formula could be proposed")
    label = table or next(iter(tables))
    if label not in tables:
        raise InputError(f"--table {label}: no such table; the identified machine has {', '.join(tables)}")
    if name in EFFECTS:
        raise InputError(f"{name}: an effect of this name exists; choose another name")
    entries = [e for t in saved.report["proposed_formulas"] if t["table"] == label for e in t["formulas"]]
    if entries:
        proposed = tuple(_from_json(entry, saved.machine, tables[label]) for entry in entries)
    else:
        proposed = propose_formulas(saved.machine, tables[label])
    renamed = []
    for p in proposed:
        try:
            effect = dataclasses.replace(p.effect, name=name, notes=_notes(p, saved, label))
        except ValueError as error:
            raise InputError(str(error)) from None
        renamed.append(dataclasses.replace(p, effect=effect))
    return tuple(renamed)


def _from_json(entry: dict[str, Any], machine: Machine, table: AppliedEffect) -> ProposedFormula:
    """Return a formula from its entry in report.json."""
    variable = table.definition.against.partition(" of ")[0]
    terms = {term.name: term for term in terms_of(variable, force=True)}
    chosen = tuple(terms[name] for name in entry["terms"] if name in terms)
    formula = Formula(chosen, (), (), entry["curve_error"])
    if len(chosen) != len(entry["terms"]) or formula.complexity != len(entry["parameters"]):
        raise InputError("report.json: a formula of proposed_formulas has an unknown term or lacks parameters")
    formula = formula.with_values(entry["parameters"].values())
    effect = FormulaEffect(NAME, formula, table, machine)
    return ProposedFormula(effect, entry["fitted"], entry["held_out"], entry["recommended"])


def _notes(proposed: ProposedFormula, saved: SavedResult, label: str) -> tuple[str, ...]:
    """Return what the file of an effect says about its accuracy."""
    if not proposed.held_out:
        return ("It was fitted to the table alone; identify the machine with it to see its error on held-out runs.",)
    entry = next(t for t in saved.report["proposed_formulas"] if t["table"] == label)
    table_error = float(np.mean(list(entry["held_out"].values())))
    return (
        f"Error on the held-out runs: {proposed.noise_ratio:.3g} times the sensors' noise with this formula of "
        f"{proposed.effect.formula.complexity} parameters, {table_error:.3g} with the table of {KNOTS} values.",
    )


@dataclass(frozen=True)
class TableComparison:
    """Formulas for one table, and the table itself, each fitted to the same runs.

    Attributes:
        table: The table.
        fitted: Error of the machine with the table on the fitted runs, in units of the noise.
        held_out: Its root-mean-square error on the held-out runs in units of the noise, by channel.
        formulas: Formulas by increasing complexity with their errors.
    """

    table: AppliedEffect
    fitted: float
    held_out: dict[str, float]
    formulas: tuple[ProposedFormula, ...]

    @property
    def noise_ratio(self) -> float:
        """Error of the table on held-out (not fitted) runs / sensor noise, mean over the channels, dimensionless."""
        return float(np.mean(list(self.held_out.values())))

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as an entry of `proposed_formulas` in report.json.

        Returns:
            Label and complexity (number of knots) of the table, its errors in units of the noise, and its formulas.
        """
        return {
            "table": self.table.label,
            "complexity": KNOTS,
            "fitted": self.fitted,
            "held_out": self.held_out,
            "formulas": [formula.as_json() for formula in self.formulas],
        }


def compare_formulas(
    result: IdentificationResult, log: Callable[[str], None] = lambda line: None
) -> tuple[TableComparison, ...]:
    """Propose formulas for each force or friction that identification could only describe by a table of values.

    A table interpolates over one variable, such as a carriage's position. Formulas are fitted to the same runs.

    Args:
        result: Result of `identify`.
        log: Called with a line of text for every formula.

    Returns:
        One comparison (errors and complexity of the table and its formulas) per table of the corrected machine.

    Raises:
        ImportError: If the machine has a table and scikit-learn is not installed; the message names the extra
            `formulas`.
    """
    return tuple(_compare(result, table, log) for table in tables_of(result.after.machine))


def _compare(result: IdentificationResult, table: AppliedEffect, log: Callable[[str], None]) -> TableComparison:
    """Fit the formulas for a table to the fitted runs in its place, and evaluate all on the held-out runs."""
    machine, refit = result.after.machine, _Refit(result)
    errors, held_out = refit.error(machine), refit.held_out(machine)
    log(f"formulas for {table.label}; error on the held-out runs in units of the noise:")
    log(f"  table of {KNOTS} values: {np.mean(list(held_out.values())):.4g}")
    formulas = []
    for proposal in propose_formulas(machine, table):
        applied = proposal.effect.applied()
        others = tuple(applied if e.label == table.label else e for e in machine.effects)
        fitted = refit.fit(machine.replace(effects=others, uncertainty=None), acceptable=errors**2)
        effect = next(e for e in fitted.machine.effects if e.name == applied.name)
        updated = dataclasses.replace(
            proposal.effect, formula=proposal.effect.formula.with_values(effect.parameters.values())
        )
        predicted = refit.held_out(fitted.machine)
        if not np.isfinite([fitted.chi2, *predicted.values()]).all():
            log(f"  {updated.formula.name}: the simulation diverges")
            continue
        formulas.append(ProposedFormula(updated, math.sqrt(fitted.chi2), predicted))
        log(f"  {updated.formula.name}, {updated.formula.complexity} parameters: {formulas[-1].noise_ratio:.4g}")
    limit = _CLOSE * min((f.fitted or math.inf for f in formulas), default=math.inf)
    simplest = next((f for f in formulas if (f.fitted or math.inf) <= limit), None)
    chosen = tuple(dataclasses.replace(f, recommended=f is simplest) for f in formulas)
    return TableComparison(table, errors, held_out, chosen)


class _Refit:
    """Fits of machines to the fitted runs of a result of `identify`, all in the same way."""

    def __init__(self, result: IdentificationResult) -> None:
        self._result = result
        self._data = refine_starts(result.fitted, result.after.machine)
        self._bandwidth = self._deciding_bandwidth()
        self._step = SEARCH_STEP if self._bandwidth else POLISH_STEP
        self._scales: TypicalScales | None = None

    def _deciding_bandwidth(self) -> float:
        """Return that of the simulation unless the simulation of the corrected machine drifts away."""
        errors = channel_errors(self._result.after.machine, self._data)
        outputs = np.concatenate([run.outputs for run in self._data.runs])
        rmse = np.array([errors[c].rmse or 0.0 for c in self._result.after.machine.output_channels])
        drift = rmse / np.maximum(np.nanstd(outputs, axis=0), 1e-12)
        return SIMULATION if drift.max() < self._result.criteria.max_drift else SEARCH_BANDWIDTH

    def error(self, machine: Machine) -> float:
        """Return the error of a machine on the fitted runs in units of the noise."""
        cost = prediction_cost(machine, self._data, self._bandwidth, longest_step=self._step)
        return math.sqrt(cost / self._data.count)

    def fit(self, machine: Machine, *, acceptable: float) -> Fit:
        """Fit all parameters of a machine with its effects, starting from its values.

        Where the fit in simulation does not reach an acceptable chi-squared per sample, because the start was too far,
        it is repeated from a fit of the prediction with an observer.
        """
        free = self._free(machine)
        values = machine.parameters
        theta = np.array([f.theta(values[f.name]) for f in free])
        run = partial(fit, machine, free, self._data, iterations=_ITERATIONS)
        best = run(self._bandwidth, theta=theta, longest_step=self._step)
        if self._bandwidth == SIMULATION and best.chi2 > acceptable:
            closer = run(SEARCH_BANDWIDTH, theta=theta, longest_step=SEARCH_STEP)
            again = run(self._bandwidth, theta=closer.theta, longest_step=self._step)
            best = min(best, again, key=lambda candidate: candidate.cost)
        return best

    def _free(self, machine: Machine) -> tuple[FreeParameter, ...]:
        """Return the free parameters: those of the declared machine, and those of all effects."""
        declared = {f.name: f for f in default_free_parameters(self._result.declared.machine, effects=False)}
        free = [declared.get(f.name, f) for f in default_free_parameters(machine, effects=False)]
        if self._scales is None:
            empty = Fit(machine, (), np.zeros(0), 0.0, 1, self._bandwidth, np.zeros((0, 0)))
            self._scales = typical_scales(empty, self._data)
        for effect in machine.effects:
            free += effect_parameters(effect, machine, self._scales)
        return tuple(free)

    def held_out(self, machine: Machine) -> dict[str, float]:
        """Return the simulation error on the held-out runs in units of the noise, by channel."""
        errors = channel_errors(machine, refine_starts(self._result.held_out, machine, self._result.fitted))
        return {channel: e.noise_ratio for channel, e in errors.items() if e.noise_ratio is not None}
