"""Decide whether effects only imitate a parameter that differs from run to run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .criteria import SelectionCriteria
from .error import FitError, is_enough, required_gain


@dataclass(frozen=True)
class DriftEvidence:
    """Comparison of effects with a parameter that has another value in each run.

    Attributes:
        unknowns: Number of parameters of the effects that are functions of time or begin each run in an
            unknown state, plus the number of these states; 0 if there is no such effect.
        values: Number of additional values of the parameter: number of runs - 1.
        explained: Function that returns whether the machine with effects explains the data in simulation.
        wide: Function that returns the error of this machine with the observer of the largest bandwidth.
        without: Function that returns the error with that observer and without these effects; None if they
            cannot be removed alone.
        by_run: Function that returns the error with that observer and another value in each run, in place of
            these effects; None if no fit succeeds.
    """

    unknowns: int
    values: int
    explained: Callable[[], bool]
    wide: Callable[[], FitError]
    without: Callable[[], FitError | None]
    by_run: Callable[[], FitError | None]


def imitates_drift(evidence: DriftEvidence, criteria: SelectionCriteria) -> bool:
    """Return whether effects only imitate a parameter that differs from run to run.

    It is False if no effect depends on time or remembers, if the effects explain the data in simulation, or
    if another value of the parameter in each run, in place of the effects, does not reduce the error by
    `required_gain`. Otherwise the explanation with fewer unknowns counts, and the one by run if both have as
    many, unless the other one leaves less chi-squared per sample by more than `required_gain`.

    Args:
        evidence: Errors with the effects and with another value in each run.
        criteria: Decision thresholds of `required_gain`.
    """
    if not evidence.unknowns or evidence.values < 1 or evidence.explained():
        return False
    without, by_run = evidence.without(), evidence.by_run()
    if without is None or by_run is None or not is_enough(without, by_run, required_gain(without, criteria)):
        return False
    wide = evidence.wide()
    if evidence.unknowns < evidence.values:
        return by_run.chi2 < wide.chi2 - required_gain(wide, criteria)
    return not wide.chi2 < by_run.chi2 - required_gain(by_run, criteria)


def less_well_than_by_run(parameter: str) -> str:
    """Return why effects that imitate a drift are removed: a clause that follows "it " (the effect).

    Args:
        parameter: Name of the parameter whose values by run explain the runs better.
    """
    return f"explains the runs less well than another value of {parameter} in each run"
