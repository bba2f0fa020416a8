"""Propose and add tables: a force, or a change of the Coulomb friction force, interpolated over one variable.

They are the fallback for a residual that no effect of the library explains. For every coordinate, the missing
force (the force that the model lacks) is averaged over bins of every variable; the variables that explain
most of it become candidates. The knots of an accepted table then move to where its fitted curve bends. A
table describes the residual but not its physical cause.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...effects.smooth_table import KNOTS, TABLE_FAMILY, definition
from ...line_log import LineLog
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..budget import spend
from ..evidence.tried_effects import SelectedEffect, Selection
from ..fit.cross_validation import costs_left_out, equations_of_pieces
from ..fit.estimation import Fit, describe_gain
from ..fit.model_error import continue_fit
from ..forces.missing_force import HIGHEST_FREQUENCY, missing_force
from ..judge import table as judge
from ..judge.criteria import SelectionCriteria
from ..judge.error import is_enough, required_gain
from ..predict.free_parameters import prior_precision
from ..predict.prediction import SEARCH_BANDWIDTH, map_runs, predict
from ..propose.candidates import Candidate
from ..propose.screening import screen
from ..propose.trial_fits import fit_with_candidate
from ..propose.typical_scales import TypicalScales, typical_scales

# Bins of the variable over which a force is averaged; finer than the knots, to find the bends.
_BINS = 4 * KNOTS
_BASE_KNOT_DENSITY = 0.15  # Relative density of knots where the curve is straight; the sharpest bend adds 1.
_MIN_BIN_SAMPLES = 21  # The mean of a bin with fewer samples is too noisy to be used.
# Knots at a density of this power of the curvature leave the smallest mean squared error.
_CURVATURE_POWER = 0.4
# Fraction of the knots that are spread evenly, so that bends between the others are seen.
_EVEN_KNOTS = 1.0 / 6.0
_SIGNIFICANT = 2.0  # Standard deviations by which the curvature of a fitted table must exceed zero.
_KNOT_MOVES = 6  # Largest number of times that the knots of a table move; two or three suffice.


class Table(NamedTuple):
    """Proposal of a table: a force, or a change of the Coulomb friction force, over knots of one variable.

    Attributes:
        effect: Name of the effect with its variable, for example "smooth_force[position of x]".
        site: Coordinate that the table acts on.
        knots: Values of the variable at the table's knots, denser where the curve bends, shape (knots,).
    """

    effect: str
    site: str
    knots: Array


def table_candidates(
    machine: Machine, data: Dataset, scales: TypicalScales, criteria: SelectionCriteria
) -> list[Candidate]:
    """Propose the tables (forces or Coulomb friction over one variable) that explain most missing force.

    The missing force is the force that would have to be added to the model for it to follow the measurements.
    A force on one coordinate also appears in the missing force of the others, so the table that explains most
    may act on the wrong coordinate. For each coordinate, the function therefore proposes several:

    - the three best tables (`max_tables_per_coordinate`);
    - of the remaining tables, the best one over time;
    - of the remaining tables, both over the position of the coordinate, force and friction, because fitted
      friction parameters can hide a part of a force that depends on the position.

    Args:
        machine: Machine with the effects that have been selected so far.
        scales: Typical sizes on this machine; the basis functions are multiples of the typical force.
        criteria: Decision thresholds, among them `max_tables_per_coordinate`.

    Returns:
        The proposed tables as candidates, grouped by coordinate, each with one basis function per knot.
        Tables that the machine already has are left out.
    """
    existing_labels = {effect.label for effect in machine.effects}
    variables = table_variables(machine, data)
    max_per_site = criteria.max_tables_per_coordinate
    chosen: list[Table] = []
    for site, record in missing_force(machine, data, HIGHEST_FREQUENCY).items():
        _, velocity, force = record.T
        if not np.any(force):
            continue
        ranked: list[tuple[float, Table]] = []
        for name, variable in variables.items():
            # Friction opposes the motion: to the missing force f belongs the Coulomb friction force -f
            # sign(v).
            for kind, samples in (("smooth_force", force), ("smooth_friction", -force * np.sign(velocity))):
                fraction, knots = _explained_fraction(
                    variable, samples, symmetric=name.startswith("velocity")
                )
                ranked.append((fraction, Table(f"{kind}[{name}]", site, knots)))
        chosen += proposed_tables(site, ranked, max_per_site)
    return [
        _candidate(table, scales) for table in chosen if f"{table.effect}@{table.site}" not in existing_labels
    ]


def proposed_tables(site: str, ranked: Sequence[tuple[float, Table]], count: int) -> list[Table]:
    """Choose the tables that are proposed at a coordinate.

    They are the first `count` of the ranking; of the others, the best one over time, which may explain a
    drift, and both over the position of the coordinate, force and friction, because fitted friction can hide
    a part of a force over the position.

    Args:
        site: Name of the coordinate.
        ranked: Fraction of the missing force that each table explains, dimensionless, and the table, largest
            fraction first.
        count: Number of tables that are proposed because they explain most.

    Returns:
        The tables in this order, each once.
    """
    tables = [table for _, table in sorted(ranked, key=lambda entry: -entry[0])]
    best, remaining = tables[:count], tables[count:]
    over_time = [table for table in remaining if table.effect.endswith("[time]")][:1]
    return best + over_time + [t for t in remaining if t.effect.endswith(f"[position of {site}]")]


def table_variables(machine: Machine, data: Dataset) -> dict[str, Array]:
    """Return the samples of every variable that a table can depend on, over all runs in sequence.

    Positions, velocities and paths are predictions that an observer corrects by the measurements at every
    sample.

    Args:
        machine: Machine that predicts the motion.
        data: Prepared recordings with n rows in total.

    Returns:
        By name, shape (n,) each: "position of C" (m or rad), "velocity of C" (m/s or rad/s) and "path of C"
        (distance traveled since the start of the run, m or rad) for each coordinate C, and "time" (s).
    """

    def variables_of_run(run: PreparedRecording) -> dict[str, Array]:
        motion = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, states=True)
        values: dict[str, Array] = {}
        for i, c in enumerate(machine.coordinate_names):
            position = motion.positions[0, :, i]
            values[f"position of {c}"] = position
            values[f"velocity of {c}"] = motion.velocities[0, :, i]
            values[f"path of {c}"] = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(position)))])
        return values | {"time": run.time_s}

    parts = list(map_runs(variables_of_run, data))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _explained_fraction(variable: Array, samples: Array, *, symmetric: bool) -> tuple[float, Array]:
    """Return the fraction of square sum that means over bins explain, and knots, denser where means bend.

    The fraction is in addition to what the mean over all samples explains. Symmetric knots of a table over a
    velocity cover both directions.
    """
    # Outliers do not widen the range; they count in the end bins.
    low, high = np.percentile(variable, [0.05, 99.95])
    if symmetric:
        high = max(high, -low)
        low = -high
    if not high > low:
        return 0.0, np.linspace(-1.0, 1.0, KNOTS)
    edges = np.linspace(low, high, _BINS + 1)
    index = np.clip(np.searchsorted(edges, variable) - 1, 0, _BINS - 1)
    count = np.bincount(index, minlength=_BINS)
    bin_means = np.bincount(index, samples, _BINS) / np.maximum(count, 1)
    total = float(np.sum(samples**2))
    usable = count >= _MIN_BIN_SAMPLES
    fraction = float(np.sum(count[usable] * (bin_means[usable] - samples.mean()) ** 2)) / max(total, 1e-300)
    centers = 0.5 * (edges[1:] + edges[:-1])
    smooth = bin_means
    if usable.any():
        smooth = np.convolve(
            np.interp(centers, centers[usable], bin_means[usable]), [0.25, 0.5, 0.25], "same"
        )
    # The error of linear interpolation is proportional to curvature times interval squared. A density of
    # knots that is proportional to the root of the curvature makes it equal everywhere.
    curvature = np.abs(np.gradient(np.gradient(smooth)))
    density = np.sqrt(curvature / max(float(curvature.max()), 1e-300)) + _BASE_KNOT_DENSITY
    cumulative = np.concatenate([[0.0], np.cumsum(density)])
    knots = np.interp(np.linspace(0.0, cumulative[-1], KNOTS), cumulative, edges)
    return fraction, knots


def _candidate(table: Table, scales: TypicalScales) -> Candidate:
    """Convert a table to a candidate whose basis functions (columns) are nonzero at one knot each."""
    effect = definition(table.effect)
    typical = scales.of(table.site)
    knots = {f"k{i:02d}": float(k) for i, k in enumerate(table.knots)}
    zero = {f"f{i:02d}": 0.0 for i in range(KNOTS)}
    size = effect.parameter("f00").scale * typical["force"]
    return Candidate(effect, table.site, tuple({**knots, **zero, name: size} for name in zero), typical)


def add_tables(
    current: Fit,
    selected: tuple[SelectedEffect, ...],
    data: Dataset,
    *,
    criteria: SelectionCriteria,
    max_tables: int,
    log: LineLog,
) -> Selection:
    """Add tables (forces or Coulomb friction over one variable) that reduce the residual of a fitted machine.

    Each step ranks the proposed tables by their linearized gain (predicted reduction of chi-squared) and adds
    the first one that passes cross-validation and reduces chi-squared per sample by `required_gain`. For the
    cross-validation, each run is divided into halves (into more pieces if there are fewer than four runs).
    Each piece is predicted with parameters that are fitted to all other pieces. The geometric mean of these
    costs must be below `max_table_cross_validation` (0.4) times that without the table.

    Args:
        current: Fit of the machine with the effects selected so far; all fits have its observer bandwidth.
        selected: Effects selected so far.
        data: Runs that are fitted.
        criteria: Decision thresholds.
        max_tables: Largest number of tables to add.
        log: Called with a line of text for every table that passes cross-validation.

    Returns:
        fit: Fit of the machine with the tables.
        selected: All selected effects, the tables last, with their fitted parameters. Without a suitable
        table, the results are `current` and `selected` themselves.
    """
    for _ in range(max_tables):
        scales = typical_scales(current, data)
        # Of the tables with the largest linearized gain, the first that passes cross-validation.
        proposals = table_candidates(current.machine, data, scales, criteria)
        spend(f"screening {len(proposals)} tables of force and friction")
        ranked = screen(current, proposals, data)
        min_gain = required_gain(current.error, criteria)
        proposed = (s for s in ranked[: criteria.max_screened_tables] if s.gain > min_gain * data.count)
        trials = (fit_with_candidate(current, s, scales, data) for s in proposed)
        confirmed = (
            t for t in trials if judge.confirms_table(_left_out_ratio(t, current, data, criteria), criteria)
        )
        trial = next(confirmed, None)
        if trial is None:
            break
        converged = fit_with_moved_knots(trial, data, criteria)
        effect = converged.machine.effects[-1]
        gain = (current.cost - converged.cost) / data.count
        log(f"  {effect.label} {describe_gain(current, converged)}")
        if not is_enough(current.error, converged.error, min_gain):
            break
        selected = (*selected, SelectedEffect(effect, gain, current.machine))
        current = converged
    return current, tuple(s.with_values(current.machine) for s in selected)


def fit_with_moved_knots(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> Fit:
    """Fit a machine again, and move the knots of its tables to where their curves bend while errors fall.

    The missing force that proposes a table is smooth in time. Over a narrow bend it is therefore too wide and
    too low, and its knots are too far apart there. The fitted values resolve the bend better. The number of
    knots, and their first and last value, do not change.

    Args:
        fitted: Fit of the machine with its tables (forces or Coulomb friction forces over one variable); the
            new fit has the same observer bandwidth.
        criteria: Decision thresholds. A move must reduce chi-squared per sample by as much as an effect must,
            and also reduce it in cross-validation.

    Returns:
        Fit of the same parameters, with the knots of the last confirmed move.
    """
    fitted = continue_fit(fitted, data, fitted.bandwidth)
    for label in [e.label for e in fitted.machine.effects if e.definition.family == TABLE_FAMILY]:
        for _ in range(_KNOT_MOVES):
            moved = continue_fit(_knots_moved(fitted, label), data, fitted.bandwidth)
            if not judge.moves_knots(fitted.error, moved.error, criteria):
                break
            if not judge.confirms_knots(_left_out_ratio(moved, fitted, data, criteria)):
                break
            fitted = moved
    return fitted


def _knots_moved(fitted: Fit, label: str) -> Fit:
    """Return the fit with a table's other knots, with interpolated values; its cost is not computed again."""
    machine = fitted.machine
    table = next(e for e in machine.effects if e.label == label)
    knots, values = (np.array([table.parameters[f"{key}{i:02d}"] for i in range(KNOTS)]) for key in "kf")
    of_table = np.array([f.along == label for f in fitted.free])
    scale = np.array([f.scale or 1.0 for f in fitted.free])[of_table]
    precision = fitted.information / max(1.0, fitted.chi2) + prior_precision(fitted.free)
    covariance = np.linalg.inv(precision)[np.ix_(of_table, of_table)] * np.outer(scale, scale)
    moved = knots_at_bends(knots, values, covariance)
    parameters = {f"k{i:02d}": float(knot) for i, knot in enumerate(moved)}
    parameters |= {f"f{i:02d}": float(value) for i, value in enumerate(np.interp(moved, knots, values))}
    changed = AppliedEffect(table.definition, table.site, parameters)
    machine = machine.replace(effects=tuple(changed if e is table else e for e in machine.effects))
    theta = np.array([f.theta(machine.parameters[f.name]) for f in fitted.free])
    return dataclasses.replace(fitted, machine=machine, theta=theta)


def knots_at_bends(knots: Array, values: Array, covariance: Array) -> Array:
    """Place the knots of a table more densely where its curve is significantly bent.

    Their density grows with the power 0.4 of the second derivative beyond two of its standard deviations; a
    sixth of the knots stays evenly spaced. The first and the last knot do not move.

    Args:
        knots: Increasing values of the table's variable, in its unit, shape (KNOTS,), see `smooth_table`.
        values: Values of the table at the knots, N or Nm, shape (KNOTS,).
        covariance: Covariance of these values, N^2 or (Nm)^2, shape (KNOTS, KNOTS).

    Returns:
        Increasing knots, in the same unit, shape (KNOTS,); `knots` if no curvature is significant.
    """
    spacing = np.diff(knots)
    slopes = np.diff(np.eye(KNOTS), axis=0) / spacing[:, None]
    # Second derivative of values.
    operator = np.diff(slopes, axis=0) / (0.5 * (spacing[1:] + spacing[:-1]))[:, None]
    variance = np.einsum("ij,jk,ik->i", operator, covariance, operator)
    curvature = np.sqrt(np.maximum((operator @ values) ** 2 - _SIGNIFICANT**2 * variance, 0.0))
    if not np.any(curvature):
        return knots
    # Each piece between two knots has the larger curvature of its ends.
    curvature = np.maximum(np.append(curvature[0], curvature), np.append(curvature, curvature[-1]))
    at_bends = curvature**_CURVATURE_POWER * spacing
    density = (1.0 - _EVEN_KNOTS) * at_bends / at_bends.sum() + _EVEN_KNOTS * spacing / spacing.sum()
    cumulative = np.concatenate([[0.0], np.cumsum(density)])
    return np.asarray(np.interp(np.linspace(0.0, cumulative[-1], KNOTS), cumulative, knots))


def _left_out_ratio(fitted: Fit, reference: Fit, data: Dataset, criteria: SelectionCriteria) -> float:
    """Return the mean ratio of two fits' costs, each half of a run with parameters from the other halves.

    With two dozen values, a table can fit almost any residual; one over the wrong variable fails on other
    data. Without a whole run, values of the variable that only this run passes would not be determined. Where
    even half a run is the only one that passes some values, the cost of this half is large. The mean is
    therefore geometric, which one half does not dominate. The halves are weighted by their cost in the
    reference, because the others need no table. The ratio is infinite if a machine diverges.
    """
    pieces = max(2, -(-criteria.cross_validation_blocks // len(data.runs)))  # of each run; more of few runs
    costs, before = (
        costs_left_out(equations_of_pieces(f, data, pieces), f.free, f.theta) for f in (fitted, reference)
    )
    return cost_ratio(*(np.array(each)[:, 0] for each in (costs, before)))


def cost_ratio(costs: Array, before: Array) -> float:
    """Return the geometric mean of costs / reference costs of pieces, weighted by the reference costs.

    Args:
        costs: Costs of the pieces, dimensionless, shape (pieces,). Pieces whose cost is 0 in either are left
            out.
        before: Costs of the reference, dimensionless, shape (pieces,).

    Returns:
        Ratio, dimensionless; infinite if any cost is not finite.
    """
    if not np.isfinite([costs, before]).all():
        return math.inf
    compared = (costs > 0.0) & (before > 0.0)  # a piece may have no valid measurement
    return float(np.exp(np.average(np.log(costs[compared] / before[compared]), weights=before[compared])))
