"""Nonparametric candidates: a table of a force or a friction level against one variable.

They are the fallback for a residual that no effect of the library explains. The missing force (the force that the model
lacks) of every coordinate is compared with every variable; the best pairs become candidates. The report calls a table a
table, not a physical effect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..effects.smooth_table import KNOTS, definition
from ..machine import Machine
from .candidates import Candidate
from .criteria import SelectionCriteria
from .dataset import Dataset, PreparedRecording, TypicalScales
from .estimation import Fit, fit, prediction_cost
from .forward_selection import Log, SelectedEffect, Selection, describe_gain
from .prediction import SEARCH_BANDWIDTH, map_runs, predict
from .residual import missing_force
from .screening import ScoredCandidate, screen
from .trial_fits import fit_with_candidate, typical_scales

Array = NDArray[np.float64]
_BINS = 96  # Bins of the variable over which a force is averaged.
_BASE_KNOT_DENSITY = 0.15  # Density of the knots where the curve is straight; at the sharpest bend it is larger by 1.
_MIN_SAMPLES = 20  # Samples that make the mean of a bin usable.


class Table(NamedTuple):
    """A proposed table: a force or friction level that is interpolated between knots of one variable.

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
    """Propose the tables (forces or friction levels over one variable) that explain most of the missing force.

    The missing force is the force that would have to be added to the model for it to follow the measurements. Several
    tables are proposed for each coordinate. A force on one coordinate also appears in the missing force of the others;
    the best table alone could therefore be the wrong one. Proposed are:

    - the three best tables (`max_tables_per_coordinate`);
    - the best one over time, even if others explain more;
    - the best one over the position of the coordinate, even if others explain more. The refitted friction may contain a
      part of such a force, and the missing force then shows only the rest.

    Args:
        machine: Machine with the effects (deviations from the nominal model) that have been selected so far.
        data: Prepared recordings (times, voltages, measurements, SI).
        scales: Typical sizes on this machine; a fraction of the typical force is the unit of the ordinates.
        criteria: Decision thresholds, among them `max_tables_per_coordinate`.

    Returns:
        These tables as candidates, coordinate by coordinate, without those that the machine has already; each has one
        basis function per knot.
    """
    present = {e.label for e in machine.effects}
    motion_and_force = missing_force(machine, data)
    variables = table_variables(machine, data)
    ranked: list[tuple[float, Table]] = []
    for site, motion in motion_and_force.items():
        force, direction = motion[:, 2], np.sign(motion[:, 1])
        if not np.any(force):
            continue
        # Forces on the belt travel, N, so that those on linear and on rotary coordinates can be compared.
        travel_per_unit = float(machine.travel_per_unit[machine.coordinate_names.index(site)])
        mean_square = float(np.mean(force**2)) * travel_per_unit**-2
        for name, values in variables.items():
            # A force acts independently of the direction of motion, a friction level against it.
            for kind, curve in (("smooth_force", force), ("smooth_friction", -force * direction)):
                # Fraction of the mean square that a curve over this variable explains.
                fraction, knots = _curve(values, curve, symmetric=name.startswith("velocity"))
                ranked.append((fraction * mean_square, Table(f"{kind}[{name}]", site, knots)))
    ranked.sort(key=lambda entry: -entry[0])
    count = criteria.max_tables_per_coordinate
    chosen: list[Table] = []
    for site in motion_and_force:
        at_site = [table for _, table in ranked if table.site == site]
        chosen += at_site[:count]
        for variable in ("time", f"position of {site}"):
            chosen += [table for table in at_site[count:] if table.effect.endswith(f"[{variable}]")][:1]
    return [_candidate(table, scales) for table in chosen if f"{table.effect}@{table.site}" not in present]


def table_variables(machine: Machine, data: Dataset) -> dict[str, Array]:
    """Return the variables over which a table may interpolate a force or a friction level, along all runs.

    Positions and velocities are predictions that an observer corrects by the measurements at every sample.

    Args:
        machine: Machine that predicts the motion.
        data: Prepared recordings with n rows in total (times, voltages, measurements, SI).

    Returns:
        By name, shape (n,) each: "position of C" (m or rad), "velocity of C" (m/s or rad/s) and "path of C" (distance
        traveled since the start of the run, m or rad) for each coordinate C, and "time" (s).
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


def _curve(variable_values: Array, values: Array, *, symmetric: bool) -> tuple[float, Array]:
    """Return the fraction of the mean square that a curve explains beyond the mean, and the curve's knots.

    Args:
        variable_values: Variable, shape (n,).
        values: Force or friction level, shape (n,).
        symmetric: Whether the knots extend equally far to both sides of zero, as for a velocity.

    Returns:
        Fraction between 0 and 1, and knots of shape (knots,).
    """
    low, high = np.percentile(variable_values, [0.05, 99.95])
    if symmetric:
        high = max(high, -low)
        low = -high
    if not high > low:
        return 0.0, np.linspace(-1.0, 1.0, KNOTS)
    edges = np.linspace(low, high, _BINS + 1)
    index = np.clip(np.searchsorted(edges, variable_values) - 1, 0, _BINS - 1)
    count = np.bincount(index, minlength=_BINS)
    mean = np.bincount(index, values, _BINS) / np.maximum(count, 1)
    total = float(np.sum(values**2))
    usable = count > _MIN_SAMPLES
    fraction = float(np.sum(count[usable] * (mean[usable] - values.mean()) ** 2)) / max(total, 1e-300)
    centers = 0.5 * (edges[1:] + edges[:-1])
    smooth = mean
    if usable.any():
        smooth = np.convolve(np.interp(centers, centers[usable], mean[usable]), [0.25, 0.5, 0.25], "same")
    curvature = np.abs(np.gradient(np.gradient(smooth)))
    density = np.sqrt(curvature / max(float(curvature.max()), 1e-300)) + _BASE_KNOT_DENSITY
    cumulative = np.concatenate([[0.0], np.cumsum(density)])
    knots = np.interp(np.linspace(0.0, cumulative[-1], KNOTS), cumulative, edges)
    return fraction, knots


def _candidate(table: Table, scales: TypicalScales) -> Candidate:
    """Return a table as a candidate with one basis function (column) per knot."""
    effect = definition(table.effect)
    at_site = scales.of(table.site)
    knots = {f"k{i:02d}": float(k) for i, k in enumerate(table.knots)}
    zero = {f"f{i:02d}": 0.0 for i in range(KNOTS)}
    size = effect.parameter("f00").scale * at_site["force"]
    return Candidate(effect, table.site, tuple({**knots, **zero, name: size} for name in zero), at_site)


def add_tables(
    current: Fit,
    selected: tuple[SelectedEffect, ...],
    data: Dataset,
    *,
    criteria: SelectionCriteria,
    max_tables: int,
    log: Log,
) -> Selection:
    """Add tables (forces or friction levels interpolated over one variable) for the residual that the effects leave.

    A table is added only if it also predicts the half of the data that it was not fitted to (cross-validation).

    Args:
        current: Fit of the machine with the effects selected so far; its observer bandwidth is used throughout.
        selected: Effects (deviations from the nominal model) selected so far.
        data: Prepared recordings to fit (times, voltages, measurements, SI).
        criteria: Decision thresholds, among them the smallest gain of a table, 0.02 per sample (`min_table_gain`).
        max_tables: Largest number of tables to add.
        log: Called with a line of text for every table that is fitted to all data.

    Returns:
        fit: Fit of the machine with the tables.
        selected: All selected effects, the tables last, with their fitted parameters.
    """
    for _ in range(max_tables):
        scales = typical_scales(current, data)
        # Best predicted reductions of chi-squared first; of those, the first that cross-validation confirms.
        ranked = screen(current, table_candidates(current.machine, data, scales, criteria), data)
        excess = current.chi2 - criteria.one_step_floor
        min_gain = max(criteria.min_table_gain, criteria.min_table_gain_fraction * excess)
        proposed = (s for s in ranked[: criteria.max_screened_tables] if s.gain > min_gain * data.count)
        limit = criteria.max_table_cross_validation
        chosen = next((s for s in proposed if _cross_validation(current, s, scales, data, criteria) < limit), None)
        if chosen is None:
            break
        trial = fit_with_candidate(current, chosen, scales, data)
        best = fit(trial.machine, trial.free, data, current.bandwidth, theta=trial.theta)
        effect = best.machine.effects[-1]
        gain = (current.cost - best.cost) / data.count
        log(f"  {effect.label} {describe_gain(current, best)}")
        if gain < min_gain:
            break
        selected = (*selected, SelectedEffect(effect, gain, current.machine))
        current = best
    return current, tuple(s.with_values(current.machine) for s in selected)


def _cross_validation(
    current: Fit, scored: ScoredCandidate, scales: TypicalScales, data: Dataset, criteria: SelectionCriteria
) -> float:
    """Return the cost of data that a table was not fitted to, relative to the cost without the table.

    A table has two dozen values and can therefore fit errors of any cause; but a table over the wrong variable does not
    predict other data.
    """
    by_run = scored.candidate.effect.against != "time"
    halves = _halves(data, by_run=by_run, blocks=criteria.cross_validation_blocks)
    with_table = without_table = 0.0
    for fitted, validation in (halves, halves[::-1]):
        trial = fit_with_candidate(current, scored, scales, fitted)
        with_table += prediction_cost(trial.machine, validation, current.bandwidth)
        without_table += prediction_cost(current.machine, validation, current.bandwidth)
    return with_table / without_table


def _halves(data: Dataset, *, by_run: bool, blocks: int) -> tuple[Dataset, Dataset]:
    """Divide the data in two: every other run and the rest, or for a single run and for time, every other part."""
    if by_run and len(data.runs) > 1:
        names = [run.name for run in data.runs]
        return data.with_runs(names[0::2]), data.with_runs(names[1::2])
    parts = 2 if len(data.runs) > 1 else blocks
    first = [(np.arange(len(run.time_s)) * parts // len(run.time_s) + k) % 2 == 0 for k, run in enumerate(data.runs)]
    return data.with_rows(first), data.with_rows([~rows for rows in first])
