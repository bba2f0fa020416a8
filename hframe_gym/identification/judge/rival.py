"""Judge rivals: effects that explain the same data about equally well."""

from __future__ import annotations

from dataclasses import dataclass

from .chance import LongRunVariance, chance_gain
from .criteria import SelectionCriteria
from .error import CLEAR, FitError


def equal_margin(without: FitError, best_cost: float, criteria: SelectionCriteria) -> float:
    """Return the difference of cost from the best trial, dimensionless, up to which another trial is equally good.

    Args:
        without: Error without any of the trials.
        best_cost: Smallest cost of a trial, dimensionless.
        criteria: Decision threshold `rival_gain_fraction`.
    """
    return (1.0 - criteria.rival_gain_fraction) * (without.cost - best_cost)


def preference(cost: float, parameters: int, needs_part: bool, limit: float) -> tuple[bool, int, bool]:
    """Return a key that sorts trials: of those up to a limit of the cost, the one with the fewest parameters first.

    Of these, an effect that any machine may have comes before one that needs a part: friction that falls with speed was
    called an eddy-current brake on a ball screw that has no magnets.

    Args:
        cost: Cost of the trial, dimensionless.
        parameters: Number of its free parameters.
        needs_part: Whether its effect exists on machines with a certain part only.
        limit: Cost up to which trials are equally good, dimensionless.
    """
    equal = cost <= limit
    return not equal, parameters if equal else 0, needs_part if equal else False


@dataclass(frozen=True)
class RivalEvidence:
    """Losses, -2 log(likelihood) per measured value, of the machine with an effect and with a rival in its place.

    Attributes:
        loss: With the effect.
        margin: What chance may add to it, if the effect is right.
        rival_loss: With the rival.
        rival_margin: What chance may add to that, if the rival is right.
        known: Whether the rival was fitted during the search; otherwise it was derived from a pair of effects.
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
    """Return whether a rival is more likely than everything before by more than chance may cause.

    Args:
        evidence: Losses with the effect and with the rival.
        least: Smallest loss up to now, of the effect or of another rival, dimensionless.
    """
    return evidence.rival_loss < least - evidence.rival_margin


def remains_rival(evidence: RivalEvidence) -> bool:
    """Return whether a rival is not less likely than the effect by more than chance may cause.

    A pair that moves the stage alike differs only while friction holds the stage, where a fit is least reliable; its
    margin is the larger of both.
    """
    margin = evidence.margin if evidence.known else max(evidence.margin, evidence.rival_margin)
    return evidence.rival_loss <= evidence.loss + margin


def largest_resembling_loss(variance: LongRunVariance, criteria: SelectionCriteria) -> float:
    """Return the increase of chi-squared, dimensionless, up to which these runs may not distinguish two effects.

    It is known to first order only, so that it must be clearly larger than what chance may cause.

    Args:
        variance: Variance of the residual in the effect's direction.
        criteria: Decision threshold `chance`.
    """
    return CLEAR * chance_gain(variance, criteria)
