"""Judge tables: forces or friction interpolated over one variable, where no known effect explains the error.

A table has two dozen values and fits almost any residual; one over the wrong variable fails on other data.
"""

from __future__ import annotations

from dataclasses import dataclass

from .criteria import SelectionCriteria
from .error import CLEAR, FAR, FitError, is_enough, required_gain


def required_table_gain(error: FitError, criteria: SelectionCriteria) -> float:
    """Return the smallest reduction of chi-squared per sample, dimensionless, for which a table is added.

    Args:
        error: Error without the table, with the widest observer.
        criteria: Decision thresholds `min_table_gain`, `min_table_gain_fraction` and `one_step_floor`.
    """
    excess = error.chi2 - criteria.one_step_floor
    return max(criteria.min_table_gain, criteria.min_table_gain_fraction * excess)


def confirms_table(left_out_ratio: float, criteria: SelectionCriteria) -> bool:
    """Return whether data to which a table was not fitted confirm it.

    Args:
        left_out_ratio: Ratio of the cost of these data with the table / without it, a geometric mean; not finite if one
            diverges.
        criteria: Decision threshold `max_table_cross_validation`.
    """
    return left_out_ratio < criteria.max_table_cross_validation


def confirms_knots(left_out_ratio: float) -> bool:
    """Return whether data to which moved knots were not fitted confirm them: their cost falls.

    The error at the ends, where few runs come, may change by cross-validation alone; `moves_knots` asks first.

    Args:
        left_out_ratio: Ratio of the cost of these data with the moved knots / with the former ones.
    """
    return left_out_ratio < 1.0


def moves_knots(before: FitError, moved: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether moved knots of a table reduce the error by as much as an effect must.

    Args:
        before: Error with the former knots.
        moved: Error with the moved knots.
        criteria: Decision thresholds of `required_gain`.
    """
    return is_enough(before, moved, required_gain(before, criteria))


@dataclass(frozen=True)
class TableEvidence:
    """What a machine with tables leaves, and what the best machines without tables leave, with the widest observer.

    Attributes:
        explained: Whether the machine with tables explains the data.
        cost: Its cost.
        refitted: Cost of the refitted machine without effects.
        with_effects: Cost of the machine with the selected effects.
        effects: Number of the selected effects that the table replaces; 0 if they stay beside it.
    """

    explained: bool
    cost: float
    refitted: float
    with_effects: float
    effects: int = 0


def accepts_table(evidence: TableEvidence) -> bool:
    """Return whether a machine with tables is accepted: it leaves only noise, or little of the best other machine.

    Several effects may only imitate one unknown curve, so that a table replaces two or more if it is clearly better.

    Args:
        evidence: What the machines leave.
    """
    with_effects = (CLEAR if evidence.effects > 1 else FAR) * evidence.cost < evidence.with_effects
    return evidence.explained or (with_effects and FAR * evidence.cost < evidence.refitted)
