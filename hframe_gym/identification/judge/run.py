"""Judge runs: which contradicts the others, which quantity differs among them, which observer each needs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .criteria import SelectionCriteria
from .error import AS_GOOD, CLEAR, FAR, FitError, Measured, is_enough, required_gain
from .held_out import HeldOutEffect

# Smallest number of runs to compare. Two runs may differ in almost any parameter; a third one can contradict
# two that agree with each other.
MIN_RUNS_COMPARED = 3
# Largest range of a quantity over the runs / its mean at which all runs have the same value.
EQUAL = 0.1
# Largest difference between two runs with the same value, as a fraction of the range over all runs.
SAME = 0.05


def contradicting_run(ratios: Mapping[str, float]) -> str | None:
    """Return the name of the run that contradicts the others most; None if none does, or of fewer than three.

    A run contradicts the others if its ratio exceeds 10 (`FAR`).

    Args:
        ratios: Chi-squared per sample of each run divided by that of the other runs, dimensionless, by name
            of the run. The parameters are fitted to the other runs only.
    """
    if len(ratios) < MIN_RUNS_COMPARED:
        return None
    worst = list(ratios)[int(np.argmax(list(ratios.values())))]
    return worst if ratios[worst] > FAR else None


@dataclass(frozen=True)
class HeldOutRun:
    """Evidence of one held-out run about the machine.

    Attributes:
        error: Error of the machine with the selected effects on this run.
        fitted_chi2: Chi-squared per sample of the fitted runs, dimensionless.
        gains: Function that returns by which fraction the effects reduce the squared error of this run: all
            of them, with the parameters fitted beside them, then each. None without effects.
    """

    error: FitError
    fitted_chi2: float
    gains: Callable[[], Sequence[float]] | None


def contradicts(run: HeldOutRun) -> bool:
    """Return whether a held-out run contradicts the machine that explains the fitted runs.

    It does if its chi-squared per sample is more than 10 times (`FAR`) that of the fitted runs or of the
    noise, whichever is larger. It does not if one effect, or all together, more than double its squared
    error: then the effects are wrong, not the run.

    Args:
        run: What the run shows.
    """
    if not run.error.cost > FAR * max(1.0, run.fitted_chi2) * run.error.count:
        return False
    return not (run.gains is not None and min(run.gains()) < 1.0 - CLEAR)


def shows_effects(gain: float) -> bool:
    """Return whether a held-out run that contradicts the machine may still remove effects from it.

    It may if all effects together remove more than 90 % (1 - 1 / `FAR`) of its squared error: then it is a
    run of this machine, and the rest shows that the model is incomplete. Otherwise something was wrong with
    the run, and it says nothing of effects.

    Args:
        gain: Fraction of the squared error of the run that all effects together remove, dimensionless.
    """
    return gain > 1.0 - 1.0 / FAR


def uses_all_runs(chi2_without: float, complete_explained: bool, complete_chi2: Measured) -> bool:
    """Return whether to use the effects found in all runs instead of those found without a suspect run.

    They are used if they explain all runs, or leave less than 10 times (`FAR`) the error that the search
    without the suspect leaves in its runs.

    Args:
        chi2_without: Chi-squared per sample, dimensionless, that the search without the suspect leaves, with
            the widest observer.
        complete_explained: Whether the effects found in all runs explain all runs.
        complete_chi2: Function that returns the chi-squared per sample that these leave, dimensionless, with
            the widest observer.
    """
    return complete_explained or complete_chi2() < FAR * chi2_without


def differs_in_a_parameter(suspect: str, different_run: str | None, chi2: float, chi2_others: float) -> bool:
    """Return whether a suspect run differs from the others only in the value of one parameter.

    It does if it is the only run with another value, and separate values leave less than 1.2 times
    (`AS_GOOD`) the error that the other runs have by themselves.

    Args:
        suspect: Name of the run that differs most.
        different_run: Name of the only run in which the parameter has another value; None if several do.
        chi2: Chi-squared per sample of all runs, including the suspect, with a separate value of the
            parameter in each, dimensionless.
        chi2_others: Chi-squared per sample of the runs without the suspect, to which the machine is fitted,
            dimensionless.
    """
    return different_run == suspect and chi2 < AS_GOOD * chi2_others


def run_that_differs_alone(different_run: str | None, chi2: float, chi2_before: float) -> str | None:
    """Return the name of the only run that needs another value of a quantity, if this is a fault of the run.

    It is a fault if one value for all runs leaves more than 10 times (`FAR`) the error of a value in each. An
    effect that only this run excites raises the error less.

    Args:
        different_run: Name of the run; None if several differ.
        chi2: Chi-squared per sample of all runs with a value of the quantity in each, dimensionless.
        chi2_before: That with one value for all runs, dimensionless.

    Returns:
        `different_run`, or None if it is no fault.
    """
    return different_run if chi2_before > FAR * chi2 else None


def explains_all_runs(chi2: float, variance: float, criteria: SelectionCriteria) -> bool:
    """Return whether chi-squared of all runs is below `explained_chi2` (1.5) times that of a correct machine.

    Args:
        chi2: Chi-squared per sample of all runs with the widest observer, dimensionless. The machine has
            either one value of each parameter for all runs or, of one of them, a value in each run.
        variance: Chi-squared per sample that a correct machine leaves with this observer, dimensionless
            (`FitError.floor`).
        criteria: Decision threshold `explained_chi2`.
    """
    return chi2 < criteria.explained_chi2 * variance


def explains_by_run(by_run: FitError, common: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether a quantity explains the runs only with a separate value in each run.

    The separate values must explain all runs (`explains_all_runs`), and reduce the error by `required_gain`:
    otherwise, with an error just above what counts as explained, arbitrary differences would seem an
    explanation.

    Args:
        by_run: Error with a value in each run, with the widest observer.
        common: Error with one value for all runs, with the same observer.
        criteria: Decision thresholds `explained_chi2` and those of `required_gain`.
    """
    enough = is_enough(common, by_run, required_gain(common, criteria))
    return enough and explains_all_runs(by_run.chi2, common.floor, criteria)


def amounts_differ(amounts: Sequence[float], shared: float) -> bool:
    """Return whether a quantity differs between runs: by more than 10 % (`EQUAL`) of its mean.

    Otherwise all runs need the same value, another one than the machine's. An amount is the dimensionless
    change of the quantity from the machine to the run (`run_differences.Quantity`).

    Args:
        amounts: Amount of each run minus the smallest, dimensionless.
        shared: The smallest amount, dimensionless.
    """
    return bool(np.ptp(amounts) > EQUAL * abs(shared + float(np.mean(amounts))))


def amounts_drift(amounts: Sequence[float]) -> bool:
    """Return whether a quantity changes in one direction from run to run.

    Steps the other way of up to 5 % (`SAME`) of the range over all runs are permitted.

    Args:
        amounts: Amount of each run, dimensionless, in the order in which the runs were recorded.
    """
    steps, tolerance = np.diff(amounts), SAME * np.ptp(amounts)
    return bool(np.all(steps > -tolerance) or np.all(steps < tolerance))


def different_run(amounts: Mapping[str, float]) -> str | None:
    """Return the name of the run, if only one differs from all others in a quantity; else None.

    The others are equal if their range is at most 5 % (`SAME`) of the range over all runs.

    Args:
        amounts: Amount of the quantity by name of the run, in one unit, at least three runs.
    """
    values = np.array(list(amounts.values()))
    for i, name in enumerate(amounts):
        if np.ptp(np.delete(values, i)) <= SAME * np.ptp(values):
            return name
    return None


def accepts_run_observers(log_ratio: float) -> bool:
    """Return whether to accept parameters that were fitted with a separate observer bandwidth for each run.

    They are accepted if their mean square error in simulation is less than twice (`CLEAR`) that of the
    parameters fitted with one observer.

    Args:
        log_ratio: Natural logarithm of the ratio of these errors, mean over the runs, dimensionless; not
            finite if the simulation diverges.
    """
    return log_ratio < math.log(CLEAR)


def exchanges_held_out(differing: int, held_out: int, fitted: int) -> bool:
    """Return whether to search again with these held-out runs fitted and other runs held out.

    This is done if all held-out runs contradict the fit, and if there are more fitted runs than these.

    Args:
        differing: Number of held-out runs that contradict the fit.
        held_out: Number of held-out runs.
        fitted: Number of fitted runs.
    """
    return differing >= held_out and fitted > differing


def exchange_confirms(effects: Sequence[HeldOutEffect]) -> bool:
    """Return whether all effects of a second search, with other runs held out, are confirmed by these runs.

    Each must change their predictions (`excited`) and reduce their error. The first held-out runs are now
    fitted and confirm nothing, because they caused the second search by contradicting the first one. An
    effect of one run alone, such as a loose connector, leaves no trace in the runs that are held out now.

    Args:
        effects: What the runs that are held out now say about each effect. Without effects, the result is
            False.
    """
    return bool(effects) and all(effect.excited and effect.gain > 0.0 for effect in effects)
