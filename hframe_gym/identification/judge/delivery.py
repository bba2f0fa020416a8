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
    """Return whether a machine predicts the held-out runs worse than a simpler one, such as the plain fit.

    If the machine leaves more than twice the noise (`max_noise_ratio_explained`), it is worse if its squared
    error is more than 1 % (`min_gain`) larger than that of the simpler one. Otherwise its squared error must
    be more than 1.2 times (`AS_GOOD`) as large, where an error below the noise counts as the noise: a
    slightly smaller error within the noise is chance.

    Args:
        ratio: Simulation error of the machine / that of the simpler one, dimensionless.
        left: Simulation error of the machine in units of the noise, dimensionless; not a number if it
            diverges.
        criteria: Decision thresholds `min_gain` and `max_noise_ratio_explained`.
    """
    if not left <= criteria.max_noise_ratio_explained:
        return ratio**2 > 1.0 + criteria.min_gain
    return ratio > 1.0 and max(left, 1.0) ** 2 > AS_GOOD * max(left / ratio, 1.0) ** 2


def held_out_run_decides(explained: bool, *, contradicts_all: bool) -> bool:
    """Return whether the choice between the fitted machine and simpler ones uses a held-out run.

    It does not if the fitted machine explains the fitted runs and the run contradicts all of the machines:
    something was then wrong with the run. Its error would outvote the other held-out runs, and which machine
    has the smaller one is chance.

    Args:
        explained: Whether the fitted machine explains the fitted runs.
        contradicts_all: Whether the run contradicts the fitted machine and all simpler ones
            (`judge.run.contradicts`).
    """
    return not (explained and contradicts_all)


def forces_contradict(lacking: float, without: float) -> bool:
    """Return whether the forces along the runs contradict effects whose values were fitted in simulation.

    They do if the force that the machine lacks is more than 1.2 times (`AS_GOOD`) as large with the effects
    as without. A cause exerts its force at every moment: effects that improve the end of a long simulation,
    but make the forces on the way worse, compensate for something else.

    Args:
        lacking: Root mean square of the force that the machine with the effects lacks, as a fraction of that
            of the drives.
        without: The same fraction for the refitted machine without the effects.
    """
    return lacking > AS_GOOD * without


def needs_description(verdict: Verdict, names: int, left: float, criteria: SelectionCriteria) -> bool:
    """Return whether to search for effects or tables that describe an error of which no cause is named.

    It needs the verdict "unexplained", no named effect, and an error of more than twice the noise
    (`max_noise_ratio_explained`) or a diverging simulation.

    Args:
        verdict: Verdict of the search and the held-out runs.
        names: Number of effects that are named.
        left: Simulation error on the held-out runs in units of the noise, dimensionless; not a number if the
            machine diverges.
        criteria: Decision threshold `max_noise_ratio_explained`.
    """
    return verdict == "unexplained" and not names and not left <= criteria.max_noise_ratio_explained


def description_helps(ratio: float, predicted: float | None = None) -> bool:
    """Return whether to deliver a machine with a description of what no named cause explains.

    A description consists of effects or tables that are not claimed to be causes. It must reduce the squared
    simulation error on the held-out runs by more than a factor of 1.2 (`AS_GOOD`) and, if the motion is
    unstable, that of predictions too, because a smaller simulation error may then be chance.

    Args:
        ratio: Simulation error on the held-out runs with the description / without it, dimensionless.
        predicted: Ratio of the squared prediction errors, with / without it, dimensionless; None if the
            motion is stable.
    """
    return AS_GOOD * ratio**2 < 1.0 and (predicted is None or AS_GOOD * predicted < 1.0)
