"""Judge a machine along an unstable motion, where the simulation of a complete run says nothing.

Where a force drives the machine away from its path, as at the top of a pendulum or of cogging, an error as
small as the noise grows along the run. A little difference there decides to which side a simulation goes on,
so that an exact machine errs as well, and of two machines whose simulations have lost the run, the one with
the smaller error has it by chance. An observer confines an error to some tenths of a second: predictions are
the only evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

from .criteria import SelectionCriteria
from .error import AS_GOOD


@dataclass(frozen=True)
class UnstableMotion:
    """Evidence about a machine along an unstable motion.

    Attributes:
        enlarged: Factor by which a simulation enlarges an error of the size of the noise, dimensionless
            (`unstable_motion.enlargement`).
        predicted: Squared error of predictions with the observer that judges / that of an exact machine,
            dimensionless, of the run and sensor with the largest one; infinite if a prediction diverges.
    """

    enlarged: float
    predicted: float


def is_unstable(enlarged: float, criteria: SelectionCriteria) -> bool:
    """Return whether a motion is unstable: a simulation more than doubles an error of the size of the noise.

    Args:
        enlarged: Factor by which it enlarges such an error, dimensionless.
        criteria: Decision threshold `max_noise_ratio_explained`, the 2.
    """
    return enlarged > criteria.max_noise_ratio_explained


def largest_grown_error(motion: UnstableMotion, criteria: SelectionCriteria) -> float:
    """Return the largest simulation error, in units of the noise, that an unstable motion alone may cause.

    It is twice (`max_noise_ratio_explained`) the factor by which the motion enlarges the noise.
    """
    return criteria.max_noise_ratio_explained * motion.enlarged


def predictions_explain(motion: UnstableMotion) -> bool:
    """Return whether predictions' squared error is at most 1.2 times (`AS_GOOD`) that of an exact machine.

    Predictions are the only evidence about an unstable motion, so the limit is stricter than elsewhere.
    """
    return motion.predicted <= AS_GOOD


def explains_unstable_motion(left: float, motion: UnstableMotion | None, criteria: SelectionCriteria) -> bool:
    """Return whether noise that grows along an unstable motion causes the error of a simulation.

    The motion must be unstable, the error at most `largest_grown_error`, and `predictions_explain` must hold:
    if the error exceeds grown noise, the machine lacks something, which an observer must not hide.

    Args:
        left: Simulation error in units of the noise, dimensionless; not a number if the simulation diverges.
        motion: Evidence about the motion; None if it is stable.
        criteria: Decision threshold `max_noise_ratio_explained`.
    """
    return (
        motion is not None and left <= largest_grown_error(motion, criteria) and predictions_explain(motion)
    )
