"""How large the error of a fit is: what noise leaves, what counts as a gain, and what explains the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .criteria import SelectionCriteria

Measured = Callable[
    [], float
]  # a number that takes seconds to compute; called only if a decision depends on it

# Ratios of the squared errors of two explanations, dimensionless, from synthetic rigs. Two explanations may
# be a value of a parameter for each run and an effect, or a machine with and without a description.
#
# Largest ratio at which both are equally good.
AS_GOOD = 1.2
# Smallest ratio at which one is clearly worse. Model error that adds up, and parameters that adapt to it,
# rarely reach it.
CLEAR = 2.0
# Smallest ratio at which they differ in kind. A run with half of the gain exceeds it, and so does the right
# table beside wrong effects (1524 and 57). An effect that a single run excites reaches 30, so that only a
# search can distinguish it from a faulty run.
FAR = 10.0


# Factor within which the size of unknown voltages between the rows is known, dimensionless. It is estimated
# from the third differences of the logged voltages.
SIZE_OF_VOLTAGES = 2.0


@dataclass(frozen=True)
class FitError:
    """Error of a fit.

    Attributes:
        cost: Sum of squared residuals in units of the noise.
        count: Number of independent measured values.
        bandwidth: Bandwidth of the observer that corrects the predictions by the measurements, rad/s; 0 for a
            simulation.
        widest: Whether this is the widest observer (60 rad/s), which feeds back the sensors' noise.
        floor: Chi-squared per sample of an exact machine with this observer: 1 / (1 - position gain).
    """

    cost: float
    count: float
    bandwidth: float = 0.0
    widest: bool = False
    floor: float = 1.0

    @property
    def chi2(self) -> float:
        """Chi-squared per sample (mean squared residual / variance), dimensionless; 1 for mere noise."""
        return self.cost / self.count

    @property
    def excess(self) -> float:
        """Chi-squared per sample beyond that of an exact machine, dimensionless, at least 0."""
        return max(self.chi2 - self.floor, 0.0)

    @property
    def simulated(self) -> bool:
        """Whether it is the error of a simulation, without an observer."""
        return self.bandwidth == 0.0


def required_gain(error: FitError, criteria: SelectionCriteria) -> float:
    """Return the smallest reduction of chi-squared per sample for which an effect is selected.

    Args:
        error: Error without the effect.
        criteria: Decision thresholds `min_gain` and `min_gain_fraction`.

    Returns:
        Reduction of chi-squared per sample, dimensionless.
    """
    return max(criteria.min_gain, criteria.min_gain_fraction * error.excess)


def is_enough(without: FitError, with_effect: FitError, enough: float) -> bool:
    """Return whether a change of the machine reduces chi-squared per sample by a required amount.

    Args:
        without: Error without the change.
        with_effect: Error with it, of the same observer.
        enough: Required reduction of chi-squared per sample, dimensionless.
    """
    return not without.cost - with_effect.cost < enough * without.count


def explains(
    error: FitError, criteria: SelectionCriteria, *, without_effects: bool, simulated: Measured
) -> bool:
    """Return whether a machine explains the data, so that no effect is missing.

    A machine without effects that needs the widest observer may lack forces of unknown size, although the
    observer leaves no error. Therefore its simulation, without an observer, must also explain the data,
    within the limit for held-out runs. (Drifting noise, such as that of a tachometer, needs this observer as
    well. Rigs with a negligible residue needed 15 to 30 rad/s.)

    Args:
        error: Error at the most likely observer bandwidth.
        criteria: Decision thresholds `explained_chi2` and `max_noise_ratio_explained`.
        without_effects: Whether the machine has no effects beside the declared ones.
        simulated: Function that returns chi-squared per sample of its simulation, dimensionless.
    """
    if not nearly_explains(error, criteria):
        return False
    return not (without_effects and error.widest) or simulated() <= criteria.max_noise_ratio_explained**2


def nearly_explains(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether so little error is left that missing effects do not falsify statistical tests."""
    return error.chi2 < criteria.explained_chi2


def voltages_may_cause(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether unknown voltages between the rows may cause all of an error beyond the noise.

    With all voltages known, an exact machine may leave as much as `explained_chi2`. Here the limit of the
    excess is larger, by the factor within which the variance of the unknown voltages is known.

    Args:
        error: Error of a fit to a log that is slower than its controller.
        criteria: Decision threshold `explained_chi2`.
    """
    return error.chi2 < 1.0 + SIZE_OF_VOLTAGES**2 * (criteria.explained_chi2 - 1.0)


def only_noise_is_left(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether only noise is left: the rest is less than an effect must explain (`min_gain`)."""
    return error.chi2 <= 1.0 + criteria.min_gain


def unexplained_fraction(error: FitError, best: FitError | None) -> float:
    """Return the fraction of an error beyond the noise that remains with the best trial.

    Args:
        error: Error without a trial.
        best: Smallest error of a trial, with the same observer; None without trials.

    Returns:
        Fraction, dimensionless, from 0 to 1; 1 without trials.
    """
    return 1.0 if best is None else min(1.0, best.excess / max(error.excess, 1e-9))


def is_better_start(predicted: tuple[float, float], simulated: tuple[float, float]) -> bool:
    """Return whether a refit from the values of a plain fit is better than one from the declared values.

    It is better if its predictions are clearly better, or if they are a little better and its simulation is
    much better.

    Args:
        predicted: Costs of the refits from the plain and from the declared values, with the widest observer,
            dimensionless; the second may be infinite.
        simulated: Costs of the same two refits in simulation, dimensionless.
    """
    plain, declared = predicted
    plain_simulated, declared_simulated = simulated
    return AS_GOOD * plain < declared or (plain < declared and CLEAR * plain_simulated < declared_simulated)
