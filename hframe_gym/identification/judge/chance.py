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
    """Return the largest reduction of the cost, dimensionless, that an effect which does not exist may cause.

    Reduction / (`variance.ratio` x number of parameters) has an F distribution with the degrees of freedom
    `variance.parameters` and `variance.blocks`; the result is exceeded with the probability `criteria.chance`
    (by default 1e-6).

    Args:
        variance: Variance of the residual in the direction of the effect.
        criteria: Decision threshold `chance`.
    """
    quantile = fdtri(variance.parameters, variance.blocks, 1.0 - criteria.chance)
    return variance.ratio * variance.parameters * float(quantile)


def chance_deviations(criteria: SelectionCriteria) -> float:
    """Return how many standard deviations an estimate must be from 0 to exclude chance.

    Args:
        criteria: Decision threshold `chance`, the probability that an estimate of something absent lies
            further from 0, on either side.

    Returns:
        Number of standard deviations of a normal distribution, dimensionless: 4.9 for 1e-6.
    """
    return float(-ndtri(0.5 * criteria.chance))


def exceeds_chance(gain: float, variance: LongRunVariance, criteria: SelectionCriteria) -> bool:
    """Return whether a reduction of the cost is at least `chance_gain`, so that chance does not explain it.

    Args:
        gain: Reduction of the cost by an effect, dimensionless.
        variance: Variance of the residual in the direction of the effect.
        criteria: Decision threshold `chance`.
    """
    return gain >= chance_gain(variance, criteria)
