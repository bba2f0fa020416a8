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
        floor: Chi-squared per sample that an exact machine leaves with this observer: 1 / (1 - position
            gain); with unknown voltages between the rows, what they cause as well.
    """

    cost: float
    count: float
    bandwidth: float = 0.0
    widest: bool = False
    floor: float = 1.0

    @property
    def chi2(self) -> float:
        """Chi-squared per sample: the cost / the number of values, dimensionless; 1 if only noise is left."""
        return self.cost / self.count

    @property
    def excess(self) -> float:
        """Chi-squared per sample minus that of an exact machine (`floor`), dimensionless, at least 0."""
        return max(self.chi2 - self.floor, 0.0)

    @property
    def simulated(self) -> bool:
        """Whether it is the error of an open-loop simulation (bandwidth 0), without an observer."""
        return self.bandwidth == 0.0


def required_gain(error: FitError, criteria: SelectionCriteria) -> float:
    """Return the smallest reduction of chi-squared per sample for which an effect is selected.

    Args:
        error: Error without the effect.
        criteria: Decision thresholds `min_gain` and `min_gain_fraction`.

    Returns:
        The larger of `min_gain` (0.01) and `min_gain_fraction` (0.1) times the excess of the error,
        dimensionless.
    """
    return max(criteria.min_gain, criteria.min_gain_fraction * error.excess)


def is_enough(without: FitError, with_effect: FitError, enough: float) -> bool:
    """Return whether a change of the machine reduces chi-squared per sample by at least a required amount.

    Args:
        without: Error without the change.
        with_effect: Error with it, of the same observer and the same measured values.
        enough: Required reduction of chi-squared per sample, dimensionless.
    """
    return not without.cost - with_effect.cost < enough * without.count


def explains(
    error: FitError, criteria: SelectionCriteria, *, without_effects: bool, simulated: Measured
) -> bool:
    """Return whether a machine explains the data, so that no effect is missing.

    Chi-squared per sample must be below 1.5 (`explained_chi2`). If a machine without effects reaches this
    with the widest observer only, it may lack forces of any size, which this observer hides: its simulation
    must then leave no more than twice the noise (`max_noise_ratio_explained`) as well.

    Args:
        error: Error with the observer under which the data are most likely.
        criteria: Decision thresholds `explained_chi2` and `max_noise_ratio_explained`.
        without_effects: Whether the machine has no effects beside the declared ones.
        simulated: Function that returns chi-squared per sample of its simulation, dimensionless.
    """
    if not nearly_explains(error, criteria):
        return False
    return not (without_effects and error.widest) or simulated() <= criteria.max_noise_ratio_explained**2


def nearly_explains(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether chi-squared per sample is below `explained_chi2` (1.5).

    So little error does not falsify statistical tests. In contrast to `explains`, the widest observer
    suffices.
    """
    return error.chi2 < criteria.explained_chi2


def voltages_may_cause(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether unknown voltages between the rows may cause all of an error beyond the noise.

    They may if chi-squared per sample is below 1 + 4 x 0.5 = 3: with all voltages known, an exact machine may
    exceed 1 by 0.5 (`explained_chi2`), and the variance of the unknown voltages is known within a factor of 4
    (`SIZE_OF_VOLTAGES` squared).

    Args:
        error: Error of a fit to a log that is slower than its controller.
        criteria: Decision threshold `explained_chi2`.
    """
    return error.chi2 < 1.0 + SIZE_OF_VOLTAGES**2 * (criteria.explained_chi2 - 1.0)


def only_noise_is_left(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether chi-squared per sample is at most 1 + `min_gain` (0.01), the least gain of an effect."""
    return error.chi2 <= 1.0 + criteria.min_gain


def unexplained_fraction(error: FitError, best: FitError | None) -> float:
    """Return the fraction of an excess that the best trial leaves, from 0 to 1; 1 without trials.

    Args:
        error: Error without the effect of the trial.
        best: Smallest error of a trial, with the same observer; None without trials.
    """
    return 1.0 if best is None else min(1.0, best.excess / max(error.excess, 1e-9))


def is_better_start(predicted: tuple[float, float], simulated: tuple[float, float]) -> bool:
    """Return whether to refit from the values of a plain fit instead of the declared ones.

    It is better if its prediction cost is smaller by a factor of 1.2 (`AS_GOOD`), or if it is smaller at all
    and the simulation cost is smaller by a factor of 2 (`CLEAR`).

    Args:
        predicted: Costs of the refits from the plain and from the declared values, with the widest observer,
            dimensionless; the second may be infinite.
        simulated: Costs of the same two refits in simulation, dimensionless.
    """
    plain, declared = predicted
    plain_simulated, declared_simulated = simulated
    return AS_GOOD * plain < declared or (plain < declared and CLEAR * plain_simulated < declared_simulated)
