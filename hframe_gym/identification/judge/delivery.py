"""Choose the machine that is delivered: that of the search, a simpler one, or one that describes what is left.

The held-out runs compare them. A name is a statement about causes, a delivered machine one about motion: it predicts
no worse than a plain fit of inertia and friction, or than the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...arrays import Array
from .criteria import SelectionCriteria
from .error import AS_GOOD, CLEAR
from .verdict import Verdict


def is_worse_than(ratio: float, left: float, criteria: SelectionCriteria) -> bool:
    """Return whether a machine predicts the held-out runs worse than a simpler one: the plain fit, or the declared one.

    What noise explains is hardly an error: among machines that leave no more, a somewhat smaller one is chance. The
    noise is the same for both, so that it does not explain a clear difference. An error below the noise counts as the
    noise.

    Args:
        ratio: Ratio of its simulation error to that of the simpler machine.
        left: Its simulation error in units of the noise; not a number if it diverges.
        criteria: Decision thresholds `min_gain`, for the ratio of the squared errors, and `max_noise_ratio_explained`,
            up to which they may differ by `AS_GOOD`.
    """
    if not left <= criteria.max_noise_ratio_explained:
        return ratio**2 > 1.0 + criteria.min_gain
    return ratio > 1.0 and max(left, 1.0) ** 2 > AS_GOOD * max(left / ratio, 1.0) ** 2


@dataclass(frozen=True)
class PredictionsByRun:
    """How well a machine predicts the held-out runs, with two observers.

    Attributes:
        judging: Chi-squared per sample with the observer that judges, in units of the noise at rest / that of an exact
            machine, dimensionless, shape (runs, sensors); NaN if not measured.
        slow: The same with the slowest observer.
    """

    judging: Array
    slow: Array

    @property
    def worst(self) -> tuple[float, float]:
        """Largest chi-squared of both observers, dimensionless; infinite: a prediction diverges, or no measurement."""
        judging, slow = (
            float(np.max(c[~np.isnan(c)], initial=0.0)) or math.inf for c in (self.judging, self.slow)
        )
        return judging, slow


def predictions_prevail(
    machine: PredictionsByRun, simpler: Callable[[], PredictionsByRun], criteria: SelectionCriteria
) -> bool:
    """Return whether predictions show that a machine is no worse than a simpler one, although its simulation is.

    In a simulation, errors add up, and grow where the motion passes the top of a potential: a little difference there
    decides to which side the machine goes on. Of two machines whose simulations have lost the run, the one with the
    smaller error has it by chance. An observer confines an error to some tenths of a second, so that the errors of
    predictions are many and independent. They prevail only where they leave no doubt: in each held-out run and at each
    sensor, the machine leaves what noise explains, and the simpler one, at some sensor of a run, clearly more. A slow
    force, which the judging observer may hide, must not speak for the simpler machine.

    Where noise is estimated too large, both machines explain the runs, and where it is too small, or the model has
    errors as those of most real machines, neither does; then the simulations decide.

    Args:
        machine: Predictions of the machine.
        simpler: Function that returns the predictions of the plain fit, or of the declared machine.
        criteria: Decision threshold `explained_chi2`.
    """
    judging, slow = machine.worst
    if not judging < criteria.explained_chi2:
        return False
    judging_simpler, slow_simpler = simpler().worst
    return judging_simpler > CLEAR * max(judging, 1.0) and slow_simpler >= slow


def forces_contradict(lacking: float, without: float) -> bool:
    """Return whether the measured forces contradict effects whose values were fitted to complete runs.

    A cause exerts its force at every moment. Effects that bring the end of a long simulation closer, but miss more of
    the forces on the way than the machine without them, compensate for something else.

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
        left: Simulation error on the held-out runs in units of the noise; not a number if the machine diverges.
        criteria: Decision threshold `max_noise_ratio_explained`.
    """
    return verdict == "unexplained" and not names and not left <= criteria.max_noise_ratio_explained


def description_helps(ratio: float) -> bool:
    """Return whether a machine with a description, which has more effects, is delivered in place of the one without.

    Args:
        ratio: Ratio of their simulation errors on the held-out runs.
    """
    return AS_GOOD * ratio**2 < 1.0
