"""Judge rivals: effects that explain the same data about equally well."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .chance import LongRunVariance, chance_gain
from .criteria import SelectionCriteria
from .error import AS_GOOD, CLEAR, FitError, nearly_explains


def equal_margin(without: FitError, best_cost: float, criteria: SelectionCriteria) -> float:
    """Return by how much a trial's cost may exceed the best one's if both count as equally good.

    The result is dimensionless.

    Args:
        without: Error without any of the trials.
        best_cost: Smallest cost of a trial, dimensionless.
        criteria: Decision threshold `rival_gain_fraction`.
    """
    return (1.0 - criteria.rival_gain_fraction) * (without.cost - best_cost)


def preference(cost: float, parameters: int, needs_part: bool, limit: float) -> tuple[bool, int, bool]:
    """Return a sort key for trials; of equally good ones, the one with the fewest parameters comes first.

    Of these, an effect that any machine may have comes before one that needs a part: friction that falls with
    speed was called an eddy-current brake on a ball screw that has no magnets.

    Args:
        cost: Cost of the trial, dimensionless.
        parameters: Number of its free parameters.
        needs_part: Whether its effect exists on machines with a certain part only.
        limit: Cost up to which trials are equally good, dimensionless.

    Returns:
        Key for ascending order. Trials above the limit have equal keys: a stable sort keeps their order.
    """
    equal = cost <= limit
    return not equal, parameters if equal else 0, needs_part if equal else False


@dataclass(frozen=True)
class TrialEvidence:
    """Errors of the trials of two effects in the same step of a search.

    Attributes:
        without: Error without either effect.
        selected: Error with the selected one.
        cost: Cost with the other one, dimensionless.
        variance: Function that returns the variance of the residual in the direction of the selected effect.
    """

    without: FitError
    selected: FitError
    cost: float
    variance: Callable[[], LongRunVariance]


def may_be_the_cause(evidence: TrialEvidence, criteria: SelectionCriteria) -> bool:
    """Return whether another tried effect, instead of the selected one, may be the cause.

    It may be in three cases: it explains nearly as much; it explains more than half as much, and chance can
    cause the difference, because the remaining error is correlated in time; or the selected effect does not
    nearly explain the data, and both leave about the same error. In the last case the error is due to missing
    effects, and both effects are compared again once these are found.

    Args:
        evidence: Errors without and with each of the two effects.
        criteria: Decision thresholds `rival_gain_fraction`, `explained_chi2` and `chance`.
    """
    best_cost = evidence.selected.cost
    lost = evidence.cost - best_cost
    if lost < equal_margin(evidence.without, best_cost, criteria):
        return True
    if CLEAR * lost >= evidence.without.cost - best_cost:
        return False
    if not nearly_explains(evidence.selected, criteria):
        other = dataclasses.replace(evidence.selected, cost=evidence.cost)
        return other.excess < AS_GOOD * evidence.selected.excess
    return lost < chance_gain(evidence.variance(), criteria)


@dataclass(frozen=True)
class RivalEvidence:
    """Losses, -2 log(likelihood) per measured value, of the machine with an effect and with a rival.

    Attributes:
        loss: With the effect.
        margin: Amount that chance may add to `loss`, if the effect is right.
        rival_loss: With the rival.
        rival_margin: Amount that chance may add to `rival_loss`, if the rival is right.
        known: Whether the rival was fitted during the search; otherwise it was derived from a pair of
            effects.
    """

    loss: float
    margin: float
    rival_loss: float
    rival_margin: float
    known: bool = True


def chance_margin(variance: LongRunVariance, count: float, criteria: SelectionCriteria) -> float:
    """Return the difference of two losses that chance may cause, dimensionless.

    Args:
        variance: Variance of the residual in the effect's direction.
        count: Number of measured values, dimensionless.
        criteria: Decision threshold `chance`.
    """
    return chance_gain(variance, criteria) / count


def is_likelier(evidence: RivalEvidence, least: float) -> bool:
    """Return whether a rival is more likely than the effect and all rivals so far, beyond chance.

    Args:
        evidence: Losses with the effect and with the rival.
        least: Smallest loss up to now, of the effect or of another rival, dimensionless.
    """
    return evidence.rival_loss < least - evidence.rival_margin


def remains_rival(evidence: RivalEvidence) -> bool:
    """Return whether a rival remains possible: chance may explain that it is less likely than the effect.

    A pair of effects that moves the stage alike differs only while friction holds the stage, where a fit is
    least reliable; the larger of both margins counts then.
    """
    margin = evidence.margin if evidence.known else max(evidence.margin, evidence.rival_margin)
    return evidence.rival_loss <= evidence.loss + margin


def only_a_row_tells(durations: Sequence[float], period: float) -> bool:
    """Return whether delays and lags are over within a row of a log, so that it cannot distinguish them.

    A delay and a lag of equal duration act alike on everything that changes more slowly. In a log slower than
    its controller, the voltages within a row are unknown: on two stages, the wrong effect of the two
    explained more.

    Args:
        durations: Durations of the delays or lags, s; all must be shorter than the period.
        period: Sampling period of the log, s.
    """
    return max(durations) < period


def largest_resembling_loss(variance: LongRunVariance, criteria: SelectionCriteria) -> float:
    """Return the increase of chi-squared, dimensionless, below which runs may not distinguish two effects.

    It is known to first order only, and is therefore clearly larger than what chance may cause.

    Args:
        variance: Variance of the residual in the effect's direction.
        criteria: Decision threshold `chance`.
    """
    return CLEAR * chance_gain(variance, criteria)
