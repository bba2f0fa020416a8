"""Judge a search by the held-out runs: whether its verdict, and the names of its effects, hold against their error.

A search decides by the fitted runs, in units of the noise that it estimated. Both may deceive it: a noise that is too
large explains every error, and the best of a few hundred effects removes a part of almost any error. The errors of the
held-out runs, in units of the sensors' noise at rest, depend on neither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from .criteria import SelectionCriteria

Verdict = Literal["effect_found", "no_effect", "unexplained"]


@dataclass(frozen=True)
class Evidence:
    """What the held-out runs say about the refitted machine (before) and the machine with effects (after).

    Runs that contradict the fitted ones do not count, unless all of them do. A machine whose simulation diverges has
    infinite errors.

    Attributes:
        left: Simulation error with the effects, in multiples of the noise at rest, rms over channels.
        left_before: The same without effects.
        motion: Simulation error with the effects relative to the motion, rms over the channels.
        lacking: Force that the machine with effects lacks, relative to that of the drives.
        remaining_prediction: Fraction of the squared error of predictions, beyond the noise at rest, that the effects
            leave. An observer corrects these predictions by the measurements.
        causes_named: Whether the effects are the causes of the missing force that is left without them, as
            `dependences.are_causes` finds them without a form of any effect.
    """

    left: float
    left_before: float
    motion: float
    lacking: float
    remaining_prediction: float
    causes_named: bool = False

    @property
    def remaining_simulation(self) -> float:
        """Fraction of the squared simulation error beyond the noise that the effects leave."""
        return remaining(self.left**2, self.left_before**2, 1.0)

    @property
    def in_words(self) -> str:
        """The error that is left, in numbers."""
        force = f" and {100 * self.lacking:.2g} % of the drives' force are" if math.isfinite(self.lacking) else " is"
        if not math.isfinite(self.left):
            return "the simulation of the held-out runs diverges"
        return f"{self.left:.3g} times the noise of the sensors{force} left on the held-out runs"


def remaining(after: float, before: float, floor: float) -> float:
    """Return which fraction of a mean squared error effects leave, beyond that of an exact machine.

    Args:
        after: Mean squared error with the effects / noise variance, dimensionless.
        before: The same without them, dimensionless.
        floor: The same of an exact machine, dimensionless.

    Returns:
        Fraction, 0 or more; infinite if the machine with effects diverges, or if it leaves an error where there was
        none.
    """
    left, total = max(after - floor, 0.0), max(before - floor, 0.0)
    if not math.isfinite(left):
        return math.inf
    return 0.0 if left == 0.0 else left / total if total > 0.0 else math.inf


def contradiction_of_no_effect(evidence: Evidence, criteria: SelectionCriteria) -> str:
    """Return why the held-out runs contradict that no effect is missing, or "" if they do not.

    Args:
        evidence: What the held-out runs say; the machine of the verdict is "after".
        criteria: Decision thresholds `max_noise_ratio_explained` and `max_motion_error`.

    Returns:
        A clause.
    """
    if not evidence.left <= criteria.max_noise_ratio_explained:
        return (
            f"{evidence.in_words}, and an error is only explained by noise up to "
            f"{criteria.max_noise_ratio_explained:g} times its size"
        )
    if not evidence.motion <= criteria.max_motion_error:
        return (
            f"the error is at the noise of the sensors, but that is {100 * evidence.motion:.2g} % of the motion: too "
            "much to tell whether an effect is missing"
        )
    return ""


def contradiction_of_names(evidence: Evidence, explained: bool, criteria: SelectionCriteria) -> str:
    """Return why the held-out runs do not permit to name effects, or "" if they do.

    Effects are named if they leave hardly more than noise, or if what they leave is small against what they explain.

    Args:
        evidence: What the held-out runs say.
        explained: Whether the machine with effects explains the fitted runs, at the noise and the observer of the fit.
        criteria: Decision thresholds `max_noise_ratio_explained`, `max_remaining`, `max_partial_excess` and
            `max_remaining_explained`.

    Returns:
        A clause.
    """
    if evidence.left <= criteria.max_noise_ratio_explained:
        return ""
    # In a simulation, errors of a force add up, so that the parameters that are fitted beside a wrong effect may reduce
    # its error many times; the error of predictions counts. But of a machine that nearly fits, an observer hides much.
    measured = evidence.remaining_prediction
    if explained:
        measured = min(measured, evidence.remaining_simulation)
    # Of a real machine, a tenth of the error may remain whatever is added. Effects that are its main causes hold all
    # the same; a wrong effect that imitates a cause acts elsewhere, or depends on another variable.
    partial = criteria.max_partial_excess if evidence.causes_named else criteria.max_remaining
    limit = criteria.max_remaining_explained if explained else partial
    if measured <= limit:
        return ""
    return (
        f"{100 * min(measured, 1.0):.2g} % of the squared error remain with the effects ({evidence.in_words}); effects "
        f"are named if at most {100 * limit:.2g} % remain"
    )
