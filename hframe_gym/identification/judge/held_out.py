"""Judge effects by the held-out runs, which can only remove effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .effect import NO_GAIN
from .error import CLEAR, Measured

# Root mean square change of the predictions by an effect / their error, below which the runs do not excite
# it.
MIN_EXCITATION = 0.05

WORSENS = "reduces the error of the held-out runs, but they are simulated worse with {} than without effects"


def gain_of_effect(gain: float, simulated: Measured | None) -> float:
    """Return the fraction of the held-out runs' squared error that an effect removes, dimensionless.

    An observer hides slow errors, and with them a small constant force. If `gain` is not positive, the
    fraction for a simulation takes its place, provided that it is above 0.5.

    Args:
        gain: Fraction of the squared error of predictions, dimensionless, negative if the effect increases
            it.
        simulated: Function that returns the fraction for a simulation, dimensionless; None if `gain` is
            already that.
    """
    if gain > 0.0 or simulated is None:
        return gain
    of_simulation = simulated()
    return of_simulation if of_simulation > 1.0 - 1.0 / CLEAR else gain


def is_excited(change: float, error: float) -> bool:
    """Return whether the held-out runs depend on an effect enough to test it.

    They do if the effect changes the predictions by at least 5 % (`MIN_EXCITATION`) of their root mean square
    error, or if a prediction diverges.

    Args:
        change: Sum of the squared changes of the predictions by the effect, in units of the noise,
            dimensionless; not finite if one diverges.
        error: Sum of the squared errors of the same predictions, in units of the noise, dimensionless.
    """
    return not change < MIN_EXCITATION**2 * error


def worsens_simulation(log_ratios: Sequence[float]) -> bool:
    """Return whether the effects together make simulations of the held-out runs worse, by their mean.

    Args:
        log_ratios: Natural logarithm of the squared simulation error with / without effects, of each run,
            dimensionless; 0 where both diverge. In the mean of logarithms, a single run with a large error of
            another cause has little weight.
    """
    return bool(np.sum(log_ratios) > 0.0)


@dataclass(frozen=True)
class HeldOutEffect:
    """Evidence of the held-out runs for one effect.

    Attributes:
        gain: Fraction of their squared error that the effect removes, dimensionless.
        excited: Whether they depend on the effect at all.
    """

    gain: float
    excited: bool


def refuted_effects(
    effects: Mapping[str, HeldOutEffect], worsens: Callable[[], bool]
) -> tuple[tuple[str, ...], str]:
    """Return the effects that the held-out runs refute, and why.

    An effect that these runs excite is refuted if it does not reduce their error. If each reduces it, but all
    together make the simulation worse, all that are excited are refuted. An effect that is not excited stays,
    because the fitted runs have confirmed it.

    Args:
        effects: What the runs say about each effect, by its label (name@site).
        worsens: Function that returns whether the effects together worsen the simulation.

    Returns:
        Labels, the one with the smallest gain first; none if no effect is refuted. And the reason, a clause
        that follows "it ", without meaning if there are no labels.
    """
    excited = [label for label, effect in effects.items() if effect.excited]
    refuted, reason = [label for label in excited if effects[label].gain <= 0.0], NO_GAIN
    if not refuted and worsens():
        refuted, reason = excited, WORSENS.format("it" if len(effects) == 1 else "all effects together")
    return tuple(sorted(refuted, key=lambda label: effects[label].gain)), reason
