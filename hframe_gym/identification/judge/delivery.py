"""Choose the machine that is delivered: that of the search, a simpler one, or one that describes the rest.

The held-out runs compare them. A name is a statement about causes, a delivered machine one about motion: it
predicts no worse than a plain fit of inertia and friction, or than the file.
"""

from __future__ import annotations

from .criteria import SelectionCriteria
from .error import AS_GOOD
from .verdict import Verdict

NO_CLEAR_GAIN = "does not clearly reduce the error of the held-out runs"


def is_worse_than(ratio: float, left: float, criteria: SelectionCriteria) -> bool:
    """Return whether a machine predicts held-out runs worse than a simpler one, such as the plain fit.

    An error that noise explains is hardly an error: among machines within the noise, a slightly smaller error
    is chance, but a clearly smaller one is not, because both see the same noise. An error below the noise
    counts as the noise.

    Args:
        ratio: Ratio of its simulation error to that of the simpler machine.
        left: Simulation error of the machine in units of the noise; not a number if it diverges.
        criteria: Decision thresholds `min_gain`, for the ratio of the squared errors, and
            `max_noise_ratio_explained`, up to which they may differ by `AS_GOOD`.
    """
    if not left <= criteria.max_noise_ratio_explained:
        return ratio**2 > 1.0 + criteria.min_gain
    return ratio > 1.0 and max(left, 1.0) ** 2 > AS_GOOD * max(left / ratio, 1.0) ** 2


def held_out_run_decides(explained: bool, *, contradicts_all: bool) -> bool:
    """Return whether a held-out run may help to choose between a fitted machine and simpler ones.

    A run that contradicts all of them does not show which machine is right, but that something was wrong with
    the run. Its errors would outvote the other held-out runs, and which machine has the smaller one is
    chance.

    Args:
        explained: Whether the fitted machine explains the fitted runs.
        contradicts_all: Whether the run contradicts the fitted machine and all simpler ones.
    """
    return not (explained and contradicts_all)


def forces_contradict(lacking: float, without: float) -> bool:
    """Return whether the measured forces contradict effects whose values were fitted to complete runs.

    A cause exerts its force at every moment. Effects that improve the end of a long simulation, but make the
    forces on the way worse, compensate for something else.

    Args:
        lacking: Missing force of the machine with the effects, relative to the force of the drives.
        without: Missing force of the refitted machine without the effects, relative to the force of the
            drives.
    """
    return lacking > AS_GOOD * without


def needs_description(verdict: Verdict, names: int, left: float, criteria: SelectionCriteria) -> bool:
    """Return whether a table should describe the remaining error, because no cause of it is named.

    Args:
        verdict: Verdict of the search.
        names: Number of effects that are named.
        left: Simulation error on the held-out runs in units of the noise; not a number if the machine
            diverges.
        criteria: Decision threshold `max_noise_ratio_explained`.
    """
    return verdict == "unexplained" and not names and not left <= criteria.max_noise_ratio_explained


def description_helps(ratio: float, predicted: float | None = None) -> bool:
    """Return whether to deliver a machine with a description (more effects or tables) instead of the other.

    Args:
        ratio: Ratio of the simulation errors with / without the description on the held-out runs.
        predicted: Ratio of the squared prediction errors with / without the description, if the motion is
            unstable: a smaller simulation error may then be chance, so that predictions must improve too.
            None if the motion is stable.
    """
    return AS_GOOD * ratio**2 < 1.0 and (predicted is None or AS_GOOD * predicted < 1.0)
