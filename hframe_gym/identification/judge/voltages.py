"""Judge the voltages of a log: held or changing between its rows, how often, and known or not in its gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Array
from .criteria import SelectionCriteria
from .error import AS_GOOD, CLEAR, FitError, is_enough, required_gain, voltages_may_cause

# Smallest fraction of command changes that follow a change in the row before, for a controller that is faster
# than the log. Such a controller changes its output in row after row while the machine moves (0.88 to 1.0);
# steps and square waves do not (0).
ROW_AFTER_ROW = 0.5
# Number of standard deviations at which an estimated delay of the voltages is clear; chance exceeds it once
# in a thousand times. This suffices because a single delay is tested after each effect, not the best of
# hundreds of candidates.
CLEAR_DELAY = 3.3


@dataclass(frozen=True)
class UpdatesEvidence:
    """Evidence of the motion about voltages between the rows of a log.

    Attributes:
        held: Error of the fit with voltages that are held from row to row.
        updated: Error of the fit with interpolated voltages that change between the rows; its floor includes
            what the errors of these voltages cause.
        better: Fraction of the runs whose error the second fit reduces.
    """

    held: FitError
    updated: FitError
    better: float


def may_change_between_rows(successive: float) -> bool:
    """Return whether the commands of a log may come from a controller that is faster than the log.

    They may if more than half (`ROW_AFTER_ROW`) of their changes follow a change in the row before. Commands
    that rest between their changes, such as steps, are computed no more often than they are logged.

    Args:
        successive: Fraction of the changes of the commands that follow a change in the row before,
            dimensionless.
    """
    return successive > ROW_AFTER_ROW


def commands_are_held_over_gaps(held: Array, interpolated: Array) -> bool:
    """Return whether commands that rest between their changes keep their last value in the gaps of a log.

    They do if this leaves the smaller cost, summed over the runs: the controller was then late, and neither
    computed nor logged anything. If only the logger was late, they changed somewhere in the gap, and a
    straight line over it is right on average.

    Args:
        held: Cost of each run with commands that are held over its gaps, dimensionless, shape (runs,).
        interpolated: The same with commands that are interpolated linearly, shape (runs,).
    """
    return bool(held.sum() < interpolated.sum())


def replaces_held_commands(estimated: FitError, held: FitError) -> bool:
    """Return whether estimated voltages replace commands that are held over the gaps of a run.

    They do if they leave less than half (`CLEAR`) of the excess, as they do if a step lies within a gap. A
    held command is known, and an estimate otherwise only adapts to what the machine lacks.

    Args:
        estimated: Error of the run with estimated voltages.
        held: The same with commands that are held over its gaps.
    """
    return CLEAR * estimated.excess < held.excess


def voltages_change_between_rows(evidence: UpdatesEvidence, criteria: SelectionCriteria) -> bool:
    """Return whether the voltages change between the rows, instead of being held.

    Changing voltages must reduce chi-squared per sample by `min_gain` (0.01), although interpolation adds an
    error of its kind; the excess with held voltages must be more than 1.2 times (`AS_GOOD`) as large; and the
    error must fall in more than half of the runs.

    Args:
        evidence: Errors with held and with changing voltages.
        criteria: Decision threshold `min_gain`.
    """
    held, updated = evidence.held, evidence.updated
    enough = is_enough(held, updated, criteria.min_gain)
    return enough and held.excess > AS_GOOD * updated.excess and evidence.better > 0.5


def voltages_change_at_another_rate(delay: float, deviation: float) -> bool:
    """Return whether interpolated voltages may change more or less often per row than a search has assumed.

    They may if their delay differs from that of the assumed number by more than 3.3 (`CLEAR_DELAY`) standard
    deviations.

    Args:
        delay: Delay of the voltages beyond that of the assumed number, in sampling periods, dimensionless.
        deviation: Standard deviation of this delay, in sampling periods, the accuracy of the times of
            recordings included, dimensionless.
    """
    return abs(delay) > CLEAR_DELAY * deviation


def another_rate_explains_more(present: FitError, other: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether to search again with another number of voltage changes per row.

    It is called when the estimated delay of the voltages differs clearly from the assumed one. If unknown
    voltages may cause all of the present error (`voltages_may_cause`), the other number must not raise
    chi-squared per sample by `min_gain` or more: the error is then less accurate than the delay, and prefers
    too many changes. Otherwise it must reduce it by `required_gain`, as an effect must, because a missing
    effect, such as the inductance of a motor, also changes the delay.

    Args:
        present: Error of a fit with the present number of changes.
        other: Error of a fit with another number, of the same observer and with the same statistics.
        criteria: Decision thresholds of `required_gain` and `voltages_may_cause`.
    """
    if voltages_may_cause(present, criteria):
        return not is_enough(other, present, criteria.min_gain)
    return is_enough(present, other, required_gain(present, criteria))


def drives_delay_voltages(counted: FitError, delayed: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether voltages act later due to a delay or lag of the drives, not to fewer changes per row.

    The delay of the drives must reduce chi-squared per sample by `required_gain` beyond what fewer changes
    leave, and unknown voltages must be able to cause all of its remaining error (`voltages_may_cause`):
    otherwise a missing effect may cause the delay.

    Args:
        counted: Error with the number of changes whose delay is closest to the estimated one.
        delayed: Error with the present number and a delay of the drives.
        criteria: Decision thresholds of `required_gain` and `voltages_may_cause`.
    """
    return voltages_may_cause(delayed, criteria) and is_enough(
        counted, delayed, required_gain(counted, criteria)
    )


def interpolation_suffices(simulated: Array) -> bool:
    """Return whether interpolated voltages simulate a machine as well as known ones would.

    They do if the mean square error of each sensor grows by less than a factor of 1.2 (`AS_GOOD`) over its
    noise. Set points of a planner are smooth between the rows; the voltages of a controller that answers
    noise are not.

    Args:
        simulated: Simulation errors that the interpolation causes, in units of the noise of each sensor,
            dimensionless, shape (sensors,); not finite where the simulation diverges.
    """
    return bool(np.all(1.0 + simulated**2 < AS_GOOD))
