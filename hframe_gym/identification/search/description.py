"""Describe what no effect explains: effects of the library as a description of the remaining error, not as causes.

The search for causes predicts some hundredths of a second, relative to the sensors' noise. Where a model lacks much, or
the clock of a sensor wanders, no effect stands out there, although a few of them describe most of the error of a
simulation over complete runs. Such a description makes the machine useful. It names no cause: other effects with
similar forces might describe these runs as well.
"""

from __future__ import annotations

import dataclasses

from ...preparation.dataset import Dataset
from ..budget import Budget, BudgetEndedError
from ..evidence.tried_effects import Log
from ..fit.estimation import Fit, prediction_cost
from ..fit.plain_fit import equally_weighted, refined_equally
from ..judge.criteria import SelectionCriteria
from ..predict.prediction import SIMULATION
from .forward_selection import EffectSearch

_MAX_EFFECTS = 2  # Each further one takes longer and removes less.
_BUDGET_PART = 0.2  # of the budget of the identification
_LONGEST = 30.0  # s of processor time


def describe_remainder(
    start: Fit, data: Dataset, criteria: SelectionCriteria, log: Log, budget: Budget
) -> tuple[Fit, tuple[str, ...]] | None:
    """Add the effects that reduce the error of a simulation over complete runs most.

    Args:
        start: Fit in simulation, for example a plain fit.
        data: Runs to fit.
        criteria: Decision thresholds, of which the tests of single effects are used.
        log: Called with a line of text at each stage.
        budget: Budget of the identification; what is left of it may be used, but at most a fifth of it and 30 s.

    Returns:
        Fit with the effects in simulation (theta, shape (k,)), and their labels; None if no effect passes the tests.
    """
    seconds = min(_BUDGET_PART * budget.seconds, _LONGEST, budget.seconds - budget.spent)
    if budget.interrupted or seconds <= 0.0:
        return None
    log("describing the remaining error of complete runs")
    equal, part = equally_weighted(data), Budget(seconds)
    cost = prediction_cost(start.machine, equal, SIMULATION)
    at_start = dataclasses.replace(start, bandwidth=SIMULATION, cost=cost, count=equal.count)
    search = EffectSearch(equal, start.machine, dataclasses.replace(criteria, max_effects=_MAX_EFFECTS), log)
    try:
        with part.limiting():
            fitted, selected = search.run(at_start)
    except BudgetEndedError:
        if not search.reached:
            return None
        fitted, selected = search.reached
    if not selected:
        return None
    return refined_equally(fitted, search.data), tuple(s.effect.label for s in selected)
