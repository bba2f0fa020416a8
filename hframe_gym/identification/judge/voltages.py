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

    They may not if they rest between their changes: a controller does not compute such a command more often
    than it is logged. To interpolate its steps only moves them, as a shorter delay does.

    Args:
        successive: Fraction of the changes of the commands that follow a change in the row before,
            dimensionless.
    """
    return successive > ROW_AFTER_ROW


def commands_are_held_over_gaps(held: Array, interpolated: Array) -> bool:
    """Return whether commands that rest between their changes keep their last value in the gaps of a log.

    They do if the controller was late, so that it neither computed nor logged anything. If only the logger
    was late, they changed somewhere in the gap, and a straight line over the gap is right on average.
    Recorded rows cannot distinguish the two cases; the motion after the gaps does.

    Args:
        held: Cost of each run with commands that are held over its gaps, shape (runs,).
        interpolated: The same with commands that are interpolated linearly, shape (runs,).
    """
    return bool(held.sum() < interpolated.sum())


def replaces_held_commands(estimated: FitError, held: FitError) -> bool:
    """Return whether estimated voltages replace commands that are held over the gaps of a run.

    A held command is known, and an estimate only adapts to what the machine lacks: a joint whose commands
    were 0.1 and 0.2 Nm seemed to have -0.7 Nm between them. The estimate must therefore leave far less of the
    motion, as it does if a step lies within a gap.

    Args:
        estimated: Error of the run with estimated voltages.
        held: The same with commands that are held over its gaps.
    """
    return CLEAR * estimated.excess < held.excess


def voltages_change_between_rows(evidence: UpdatesEvidence, criteria: SelectionCriteria) -> bool:
    """Return whether the voltages change between the rows, instead of being held.

    Two conditions must hold. Beyond what noise and unknown voltages cause, held voltages leave clearly more
    error, in most runs. And changing voltages reduce the error itself, although interpolation adds an error
    of its own. If the voltages are really held, interpolation adds much more and reduces nothing: so on
    eleven rigs, and by 1.4 % only on one whose machine lacked an effect.

    Args:
        evidence: Errors with held and with changing voltages.
        criteria: Decision threshold `min_gain`.
    """
    held, updated = evidence.held, evidence.updated
    enough = is_enough(held, updated, criteria.min_gain)
    return enough and held.excess > AS_GOOD * updated.excess and evidence.better > 0.5


def voltages_change_at_another_rate(delay: float, deviation: float) -> bool:
    """Return whether interpolated voltages may change more or less often per row than a search has assumed.

    Args:
        delay: Delay of the voltages beyond that of the assumed number, in sampling periods, dimensionless.
        deviation: Standard deviation of this delay, the accuracy of the times of recordings included,
            dimensionless.
    """
    return abs(delay) > CLEAR_DELAY * deviation


def another_rate_explains_more(present: FitError, other: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether to search again with another number of voltage changes per row.

    It follows a clear difference between the assumed and the estimated delay of the voltages. A missing
    effect, such as the inductance of a motor, also changes this delay. If the unknown voltages cannot cause
    all of the remaining error, the other number must therefore reduce the error by as much as an effect must.
    If they can, it only must not raise the error by as much, because the error is then less accurate than the
    delay and prefers too many changes.

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

    If fewer changes explain the data as well, there is no delay. If unknown voltages cannot cause all of the
    remaining error, a missing effect may cause the delay; the result is then False.

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

    Set points of a planner are smooth between the rows; the voltages of a controller that answers noise are
    not.

    Args:
        simulated: Simulation errors that the interpolation causes, in units of the noise of each sensor,
            dimensionless, shape (sensors,); not finite where the simulation diverges.
    """
    return bool(np.all(1.0 + simulated**2 < AS_GOOD))
