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
    """Return whether a motion is unstable: errors of the size of the noise grow beyond it in a simulation.

    Args:
        enlarged: Factor by which a simulation enlarges an error of the size of the noise, dimensionless.
        criteria: Decision threshold `max_noise_ratio_explained`.
    """
    return enlarged > criteria.max_noise_ratio_explained


def largest_grown_error(motion: UnstableMotion, criteria: SelectionCriteria) -> float:
    """Return the largest simulation error, in units of the noise, that an unstable motion alone may cause."""
    return criteria.max_noise_ratio_explained * motion.enlarged


def predictions_explain(motion: UnstableMotion) -> bool:
    """Return whether the predictions of an unstable motion are as good as those of an exact machine.

    In a stable motion, an error beyond the noise must be small in predictions and in simulation. Here
    predictions are the only evidence, so that the limit is stricter: for a pendulum without its Stribeck
    friction they leave 1.23 times the error of an exact machine, with it 0.97 times.
    """
    return motion.predicted <= AS_GOOD


def explains_unstable_motion(left: float, motion: UnstableMotion | None, criteria: SelectionCriteria) -> bool:
    """Return whether noise that grows along an unstable motion causes a simulation's error.

    The predictions must confirm this. Such a machine is not replaced by a simpler one with a smaller
    simulation error. If the error exceeds grown noise, the machine lacks something, which an observer must
    not hide.

    Args:
        left: Simulation error in units of the noise, dimensionless; not a number if the simulation diverges.
        motion: Evidence about the motion; None if it is stable.
        criteria: Decision threshold `max_noise_ratio_explained`.
    """
    return (
        motion is not None and left <= largest_grown_error(motion, criteria) and predictions_explain(motion)
    )
