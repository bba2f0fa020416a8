"""Judge rivals: effects that explain the same data about equally well."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .chance import LongRunVariance, chance_gain
from .criteria import SelectionCriteria
from .error import AS_GOOD, CLEAR, FitError, nearly_explains


def equal_margin(without: FitError, best_cost: float, criteria: SelectionCriteria) -> float:
    """Return by how much a trial's cost, dimensionless, may exceed the best one's if both are equally good.

    It is 3 % (1 - `rival_gain_fraction`) of the reduction of the cost by the best trial.

    Args:
        without: Error without any of the trials.
        best_cost: Smallest cost of a trial, dimensionless.
        criteria: Decision threshold `rival_gain_fraction`.
    """
    return (1.0 - criteria.rival_gain_fraction) * (without.cost - best_cost)


def preference(cost: float, parameters: int, needs_part: bool, limit: float) -> tuple[bool, int, bool]:
    """Return a sort key for the trials of a step: equally good ones first, of these the simplest.

    A trial is equally good if its cost is at most `limit`. Of these, the one with the fewest parameters comes
    first; with equal numbers, an effect that any machine may have before one that needs a part, such as an
    eddy-current brake, which needs magnets.

    Args:
        cost: Cost of the trial, dimensionless.
        parameters: Number of free parameters of its effect.
        needs_part: Whether its effect exists on machines with a certain part only.
        limit: Cost up to which trials are equally good, dimensionless: the smallest cost + `equal_margin`.

    Returns:
        Key for ascending order. Trials above the limit have equal keys, so that a stable sort keeps their
        order.
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

    It may in three cases:

    - It reduces the cost by more than 97 % (`rival_gain_fraction`) of what the selected one does.
    - It reduces it by more than half of that, chi-squared per sample with the selected one is below 1.5
      (`explained_chi2`), and chance may cause the difference (`chance_gain`).
    - It reduces it by more than half of that, chi-squared per sample with the selected one is at least 1.5,
      and its excess is below 1.2 times (`AS_GOOD`) that of the selected one. Both are compared again when the
      missing effects are found.

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
    """Return the difference of the losses of two machines that chance may cause, dimensionless.

    It is `chance_gain` per measured value, as a loss is.

    Args:
        variance: Variance of the residual in the effect's direction.
        count: Number of measured values, dimensionless.
        criteria: Decision threshold `chance`.
    """
    return chance_gain(variance, criteria) / count


def is_likelier(evidence: RivalEvidence, least: float) -> bool:
    """Return whether a rival has a loss below those of the effect and the rivals so far, beyond chance.

    The difference must exceed its `rival_margin`.

    Args:
        evidence: Losses with the effect and with the rival.
        least: Smallest loss up to now, of the effect or of another rival, dimensionless.
    """
    return evidence.rival_loss < least - evidence.rival_margin


def remains_rival(evidence: RivalEvidence) -> bool:
    """Return whether a rival remains possible: its loss exceeds the effect's by no more than chance may.

    That is `margin`; for a rival that was derived from a pair of effects (not `known`), the larger one of
    both margins. Such a pair moves the stage as the effect does, except while friction holds it, where a fit
    is least reliable.
    """
    margin = evidence.margin if evidence.known else max(evidence.margin, evidence.rival_margin)
    return evidence.rival_loss <= evidence.loss + margin


def only_a_row_tells(durations: Sequence[float], period: float) -> bool:
    """Return whether all of several delays and lags are shorter than a row of a log.

    The log then cannot tell them apart.

    A delay and a lag of equal duration act alike on everything that changes more slowly than they do, and in
    a log slower than its controller the voltages within a row are unknown.

    Args:
        durations: Durations of the delays or lags, s, at least one.
        period: Sampling period of the log, s.
    """
    return max(durations) < period


def largest_resembling_loss(variance: LongRunVariance, criteria: SelectionCriteria) -> float:
    """Return the increase of the cost, dimensionless, up to which another effect may be a rival.

    It is twice (`CLEAR`) what chance may cause, because the increase is predicted by a linearization, before
    the rival is fitted.

    Args:
        variance: Variance of the residual in the effect's direction.
        criteria: Decision threshold `chance`.
    """
    return CLEAR * chance_gain(variance, criteria)
