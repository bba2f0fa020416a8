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
    """Return whether a machine predicts held-out runs worse than a simpler one: the plain fit, the declared.

    What noise explains is hardly an error: among machines that leave no more, a somewhat smaller one is
    chance. The noise is the same for both, so that it does not explain a clear difference. An error below the
    noise counts as the noise.

    Args:
        ratio: Ratio of its simulation error to that of the simpler machine.
        left: Its simulation error in units of the noise; not a number if it diverges.
        criteria: Decision thresholds `min_gain`, for the ratio of the squared errors, and
            `max_noise_ratio_explained`, up to which they may differ by `AS_GOOD`.
    """
    if not left <= criteria.max_noise_ratio_explained:
        return ratio**2 > 1.0 + criteria.min_gain
    return ratio > 1.0 and max(left, 1.0) ** 2 > AS_GOOD * max(left / ratio, 1.0) ** 2


def held_out_run_decides(explained: bool, *, contradicts_all: bool) -> bool:
    """Return whether a held-out run may help to choose between a fitted machine and simpler ones.

    A run that contradicts all of them says that something was wrong with it, not which machine is right: the
    smaller of two errors that both differ in kind from what the fitted runs leave is chance, and so large
    that it would outvote the other held-out runs.

    Args:
        explained: Whether the fitted machine explains the fitted runs.
        contradicts_all: Whether the run contradicts the fitted machine and all simpler ones.
    """
    return not (explained and contradicts_all)


def forces_contradict(lacking: float, without: float) -> bool:
    """Return whether the measured forces contradict effects whose values were fitted to complete runs.

    A cause exerts its force at every moment. Effects that bring the end of a long simulation closer, but miss
    more of the forces on the way than the machine without them, compensate for something else.

    Args:
        lacking: Force that the machine with the effects lacks, relative to that of the drives.
        without: Force that the refitted machine without them lacks, relative to that of the drives.
    """
    return lacking > AS_GOOD * without


def needs_description(verdict: Verdict, names: int, left: float, criteria: SelectionCriteria) -> bool:
    """Return whether what is left should be described, because no cause of it is named.

    Args:
        verdict: Verdict of the search.
        names: Number of effects that are named.
        left: Simulation error on the held-out runs in units of the noise; not a number if the machine
            diverges.
        criteria: Decision threshold `max_noise_ratio_explained`.
    """
    return verdict == "unexplained" and not names and not left <= criteria.max_noise_ratio_explained


def description_helps(ratio: float, predicted: float | None = None) -> bool:
    """Return whether a machine with a description, thus more effects, is delivered instead of the other.

    Args:
        ratio: Ratio of their simulation errors on the held-out runs.
        predicted: Ratio of the squared errors of their predictions, if the motion of the machine without the
            description is unstable: there the smaller error of a simulation may be chance, so that
            predictions must become better too. None if it is stable.
    """
    return AS_GOOD * ratio**2 < 1.0 and (predicted is None or AS_GOOD * predicted < 1.0)
