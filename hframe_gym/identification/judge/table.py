"""Judge tables: forces or friction interpolated over one variable, where no known effect explains the error.

A table has two dozen values and fits almost any residual; one over the wrong variable fails on other data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .criteria import SelectionCriteria
from .error import AS_GOOD, CLEAR, FAR, FitError, is_enough, required_gain


def confirms_table(left_out_ratio: float, criteria: SelectionCriteria) -> bool:
    """Return whether data to which a table was not fitted keep less than 40 % of their cost with it.

    Args:
        left_out_ratio: Ratio of the cost of these data with the table / without it, dimensionless: a
            geometric mean over pieces of the runs; not finite if one diverges.
        criteria: Decision threshold `max_table_cross_validation`, the 40 %.
    """
    return left_out_ratio < criteria.max_table_cross_validation


def confirms_knots(left_out_ratio: float) -> bool:
    """Return whether moved knots reduce the cost of data to which they were not fitted.

    A knot is one of the values between which a table is interpolated. Any reduction suffices, because few
    runs reach the ends of a table, so that its error there is uncertain. `moves_knots` decides whether the
    gain is large enough.

    Args:
        left_out_ratio: Ratio of the cost of these data with the moved knots / with the former ones,
            dimensionless.
    """
    return left_out_ratio < 1.0


def moves_knots(before: FitError, moved: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether moved knots of a table reduce chi-squared per sample by `required_gain`.

    Args:
        before: Error with the former knots.
        moved: Error with the moved knots.
        criteria: Decision thresholds of `required_gain`.
    """
    return is_enough(before, moved, required_gain(before, criteria))


@dataclass(frozen=True)
class TableEvidence:
    """Errors of a machine with tables and of the best machines without tables, with the widest observer.

    Errors are chi-squared per sample beyond that of an exact machine: no table removes the noise.

    Attributes:
        explained: Whether the machine with tables explains the data.
        excess: Error of the machine with tables.
        refitted: Error of the refitted machine without effects.
        with_effects: Error of the machine with the selected effects and without tables.
        effects: Number of the selected effects that the table replaces; 0 if they stay beside it.
    """

    explained: bool
    excess: float
    refitted: float
    with_effects: float
    effects: int = 0


def accepts_table(evidence: TableEvidence) -> bool:
    """Return whether a machine with tables is accepted in place of the best machines without tables.

    It is if it explains the data, or if its excess is less than a tenth (`FAR`) of that of the refitted
    machine and of the one with effects. Where tables replace two or more effects, less than half (`CLEAR`) of
    the excess with effects suffices: several effects may only imitate one curve.

    Args:
        evidence: Errors of the machines.
    """
    than_effects = CLEAR if evidence.effects > 1 else FAR
    is_better = (
        than_effects * evidence.excess < evidence.with_effects and FAR * evidence.excess < evidence.refitted
    )
    return evidence.explained or is_better


def is_one_curve(table: float, effects: float) -> bool:
    """Return whether several effects of one variable only imitate a curve of another form.

    A table over this variable, in place of the effects, must leave less than half (`CLEAR`) of their
    simulation cost. With the widest observer, such effects may explain the data, but the error of their forms
    adds up in a simulation. A table can hardly be better than the right effects.

    Args:
        table: Cost of the simulation with the table in place of the effects, dimensionless.
        effects: Cost of the simulation with the effects, dimensionless.
    """
    return CLEAR * table < effects


def recommended_formula(errors: Sequence[float]) -> int | None:
    """Return the index of the simplest formula that is as good as the best one; None without formulas.

    A formula is as good if its squared error is at most 1.2 times (`AS_GOOD`) the smallest one.

    Args:
        errors: Root mean square errors of the formulas, in units of the noise, the simplest formula first.
    """
    return next((i for i, error in enumerate(errors) if error**2 <= AS_GOOD * min(errors) ** 2), None)


def is_better_than_table(formula: float, table: float) -> bool:
    """Return whether a formula is better than the table that it replaces.

    Its squared error must be smaller by a factor of more than 1.2 (`AS_GOOD`).

    Args:
        formula: Root mean square error with the formula on the held-out runs, in units of the noise.
        table: The same with the table, in units of the noise.
    """
    return AS_GOOD * formula**2 < table**2
