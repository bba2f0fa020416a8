"""Judge how much of the cost an effect that does not exist removes by chance.

The error that a model leaves is correlated in time, so that tests that assume white noise accept effects that
do not exist.
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy.special import fdtri, ndtri

from .criteria import SelectionCriteria


@dataclass(frozen=True)
class LongRunVariance:
    """Variance of a residual in the direction in which an effect changes predictions, summed over long times.

    Attributes:
        ratio: Variance / variance for white noise, dimensionless, at least 1; infinite if the machine
            diverges.
        parameters: Number of free parameters of the effect.
        blocks: Number of independent pieces of time from which it is estimated; few of them estimate it
            inaccurately.
    """

    ratio: float
    parameters: int = 1
    blocks: int = 1000


def chance_gain(variance: LongRunVariance, criteria: SelectionCriteria) -> float:
    """Return the reduction of the cost, dimensionless, that an absent effect hardly ever reaches.

    Reduction / (variance x number of parameters) has an F distribution.

    Args:
        variance: Variance of the residual in the direction of the effect.
        criteria: Decision threshold `chance`.
    """
    quantile = fdtri(variance.parameters, variance.blocks, 1.0 - criteria.chance)
    return variance.ratio * variance.parameters * float(quantile)


def chance_deviations(criteria: SelectionCriteria) -> float:
    """Return how many standard deviations from 0 an estimate must be to exclude chance.

    Args:
        criteria: Decision threshold `chance`, the probability that chance alone leads so far.

    Returns:
        Number of standard deviations of a normal distribution, to either side, dimensionless: 4.9 for 1e-6.
    """
    return float(-ndtri(0.5 * criteria.chance))


def exceeds_chance(gain: float, variance: LongRunVariance, criteria: SelectionCriteria) -> bool:
    """Return whether a reduction of the cost is larger than chance explains.

    Args:
        gain: Reduction of the cost by an effect, dimensionless.
        variance: Variance of the residual in the direction of the effect.
        criteria: Decision threshold `chance`.
    """
    return gain >= chance_gain(variance, criteria)
