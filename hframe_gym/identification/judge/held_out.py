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
    """Return the fraction of the held-out runs' squared error that an effect removes.

    An observer hides slow errors, and with them the effect of a small constant force. If it shows no gain,
    the error of a simulation decides, provided that the effect clearly reduces it.

    Args:
        gain: Fraction of the squared error of predictions, negative if the effect increases it.
        simulated: Function that returns the fraction for a simulation; None if `gain` is from a simulation.
    """
    if gain > 0.0 or simulated is None:
        return gain
    of_simulation = simulated()
    return of_simulation if of_simulation > 1.0 - 1.0 / CLEAR else gain


def is_excited(change: float, error: float) -> bool:
    """Return whether an effect changes the predictions of the held-out runs enough to be tested by them.

    Args:
        change: Sum of the squared changes of the predictions by the effect, in units of the noise; not finite
            if one diverges.
        error: Sum of their squared errors, in units of the noise.
    """
    return not change < MIN_EXCITATION**2 * error


def worsens_simulation(log_ratios: Sequence[float]) -> bool:
    """Return whether the effects together make simulations of the held-out runs worse.

    Args:
        log_ratios: Logarithm of the squared simulation error with / without effects, of each run; 0 where
            both diverge. In the mean of logarithms, a single run with a large error of another cause has
            little weight.
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
    """Return the effects that the held-out runs refute.

    These runs never add or change an effect. An effect that they do not excite is kept, because the fitted
    runs have confirmed it. If each effect reduces their error but all together make the simulation worse, all
    that the runs excite are returned.

    Args:
        effects: What the runs say about each effect, by its label.
        worsens: Function that returns whether the effects together worsen the simulation.

    Returns:
        Labels, the weakest first, none if no effect is refuted, and the reason, a clause that follows "it ".
    """
    excited = [label for label, effect in effects.items() if effect.excited]
    refuted, reason = [label for label in excited if effects[label].gain <= 0.0], NO_GAIN
    if not refuted and worsens():
        refuted, reason = excited, WORSENS.format("it" if len(effects) == 1 else "all effects together")
    return tuple(sorted(refuted, key=lambda label: effects[label].gain)), reason
