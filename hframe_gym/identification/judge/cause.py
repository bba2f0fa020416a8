"""Judge causes: variables on which a missing force depends, found without the form of any effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# Smallest fraction of the missing force, beyond noise, that a variable must explain to be a cause. Chance
# explains less on synthetic rigs.
MINIMUM_DEPENDENCE = 0.05
# Relative error of the expected variance of the noise. A part of the force within this error may still be
# noise.
NOISE_ERROR = 0.5
# Factor on what a special variable explains, dimensionless, so that it ranks before a plain one only if it
# explains clearly more: the age of a contact, for example, follows from its speed. In the same way, a plain
# variable ranks before a constant force, which its curve contains, only if it explains clearly more.
SPECIAL_PREFERENCE = 0.95


def beyond_noise(total: float, by_noise: float) -> float:
    """Return the part of a sum of squares that noise does not cause, dimensionless.

    It is `total` - `by_noise`, but at least half of `by_noise`, because this is known within a factor of 1.5
    only.

    Args:
        total: Sum of the squares of a measured force in units of its noise, dimensionless.
        by_noise: Expected contribution of noise to this sum, dimensionless.
    """
    return max(total - by_noise, NOISE_ERROR * by_noise)


@dataclass(frozen=True)
class CauseEvidence:
    """How much of a missing force a variable, such as a position, explains.

    The missing force is what the drives and the motion of the runs leave of the machine's equations. All sums
    of squares are those of this force in units of its noise, dimensionless.

    Attributes:
        explained: Sum of squares that the variable explains in pieces of the runs to which its curve was not
            fitted.
        certain: `explained` minus its standard error.
        fraction: Explained fraction of the sum of squares beyond noise, in all pieces.
        beyond_noise: Sum of squares beyond noise, as `beyond_noise` returns it.
        plain: Whether the variable is a position, a velocity, a current or a motor's torque.
        constant: Whether the cause is a constant force, which depends on no variable.
    """

    explained: float
    certain: float
    fraction: float
    beyond_noise: float
    plain: bool
    constant: bool = False


def is_cause(evidence: CauseEvidence) -> bool:
    """Return whether a variable explains more of the missing force than chance does.

    It does if it explains more than 5 % (`MINIMUM_DEPENDENCE`) of the sum of squares beyond noise, both in
    pieces to which its curve was not fitted and in all pieces, and more than its standard error in the
    former.
    """
    explained = min(evidence.explained / evidence.beyond_noise, evidence.fraction)
    return evidence.certain > 0.0 and explained > MINIMUM_DEPENDENCE


def rank_of_cause(evidence: CauseEvidence, total: float) -> float:
    """Return a sort key for causes: the explained fraction of a force, with a preference for simple ones.

    The fraction is `certain` / `total`. It is divided by 0.95 for a constant force and multiplied by 0.95 for
    a variable that is not plain, such as the age of a contact, so that these count for more or less than a
    plain variable.
    """
    explained = evidence.certain / total
    if evidence.constant:
        return explained / SPECIAL_PREFERENCE
    return explained if evidence.plain else SPECIAL_PREFERENCE * explained


def names_causes(matches: Sequence[Sequence[bool]]) -> bool:
    """Return whether the found effects agree with the causes of a missing force.

    Args:
        matches: For each effect, whether it acts on the component and depends on the variable of each cause,
            the strongest cause first.

    Returns:
        True if an effect matches the strongest cause, and each effect matches some cause.
    """
    if not matches or not matches[0]:
        return False
    return any(of_effect[0] for of_effect in matches) and all(any(of_effect) for of_effect in matches)
