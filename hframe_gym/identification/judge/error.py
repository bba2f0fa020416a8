"""How large the error of a fit is: what only noise leaves, what counts as a gain, and what explains the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .criteria import SelectionCriteria

Measured = Callable[
    [], float
]  # a number that takes seconds to compute; called only if a decision depends on it

# Three ratios of squared errors, on synthetic rigs. Up to this one, two explanations are as good as each other: a value
# of a parameter for each run and an effect, a machine with and without a description of what it lacks.
AS_GOOD = 1.2
# From this one, one explanation is clearly worse than the other. Model error that adds up, and parameters that adapt to
# it, rarely do as much.
CLEAR = 2.0
# From this one, they differ in kind: a right table and wrong effects (1524 and 57), runs of one machine and a run with
# half of the gain. An effect that one run alone excites reaches 30, so that only a search can tell.
FAR = 10.0


@dataclass(frozen=True)
class FitError:
    """What a fit leaves of the error.

    Attributes:
        cost: Sum of squared residuals in units of the noise.
        count: Number of independent measured values.
        bandwidth: Bandwidth of the observer that corrects the predictions by the measurements, rad/s; 0 for a
            simulation.
        one_step: Whether this is the widest observer (60 rad/s), which feeds back the sensors' noise.
    """

    cost: float
    count: float
    bandwidth: float = 0.0
    one_step: bool = False

    @property
    def chi2(self) -> float:
        """Chi-squared per sample (mean squared residual / variance), dimensionless; 1 if only noise remains."""
        return self.cost / self.count

    @property
    def simulated(self) -> bool:
        """Whether it is the error of a simulation, without an observer."""
        return self.bandwidth == 0.0


def noise_floor(error: FitError, criteria: SelectionCriteria) -> float:
    """Return chi-squared per sample, dimensionless, of a correct model: 1, with the widest observer `one_step_floor`.

    Args:
        error: Error of any fit with the same observer.
        criteria: Decision thresholds.
    """
    return criteria.one_step_floor if error.one_step else 1.0


def required_gain(error: FitError, criteria: SelectionCriteria) -> float:
    """Return the smallest reduction of chi-squared per sample for which an effect is selected.

    It is the largest of three limits: one for the observer, because the residual of the widest is correlated; one for
    short recordings, in which chance explains more; and a fraction of the error beyond the noise.

    Args:
        error: Error without the effect.
        criteria: Decision thresholds `min_gain_one_step`, `min_gain_simulation`, `min_total_gain`, `min_gain_fraction`.

    Returns:
        Reduction of chi-squared per sample, dimensionless.
    """
    of_observer = criteria.min_gain_one_step if error.one_step else criteria.min_gain_simulation
    excess = error.chi2 - 1.0
    return max(of_observer, criteria.min_total_gain / error.count, criteria.min_gain_fraction * excess)


def is_enough(without: FitError, with_effect: FitError, enough: float) -> bool:
    """Return whether a change of the machine reduces chi-squared per sample by a required amount.

    Args:
        without: Error without the change.
        with_effect: Error with it, of the same observer.
        enough: Required reduction of chi-squared per sample, dimensionless.
    """
    return not without.cost - with_effect.cost < enough * without.count


def explains(
    error: FitError, initial_chi2: float, criteria: SelectionCriteria, *, without_effects: bool
) -> bool:
    """Return whether a machine explains the data: it leaves only noise, or a negligible part of the initial error.

    A machine without effects that needs the widest observer explains nothing, although the observer leaves no error:
    forces of unknown size are missing. Rigs with a negligible residue needed 15 to 30 rad/s.

    Args:
        error: Error at the most likely observer bandwidth.
        initial_chi2: Chi-squared per sample of the first fit, without effects, dimensionless.
        criteria: Decision thresholds `explained_chi2` and `explained_fraction`.
        without_effects: Whether the machine has no other effects than the declared one.
    """
    if without_effects and error.one_step:
        return False
    return error.chi2 < max(criteria.explained_chi2, criteria.explained_fraction * initial_chi2)


def nearly_explains(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether so little error is left that missing effects do not falsify statistical tests."""
    return error.chi2 < criteria.explained_chi2


def only_noise_is_left(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether nothing but noise is left."""
    return not error.chi2 > criteria.noise_level


def unexplained_fraction(error: FitError, best: FitError | None, criteria: SelectionCriteria) -> float:
    """Return which fraction of an error beyond the noise remains with the best trial.

    Args:
        error: Error without a trial.
        best: Smallest error of a trial, with the same observer; None without trials.
        criteria: Decision threshold `one_step_floor`.

    Returns:
        Fraction, dimensionless, at most 1; 1 without trials, negative if less than a correct model's error is left.
    """
    floor = noise_floor(error, criteria)
    smallest = error.chi2 if best is None else best.chi2
    return min(1.0, (smallest - floor) / max(error.chi2 - floor, 1e-9))
