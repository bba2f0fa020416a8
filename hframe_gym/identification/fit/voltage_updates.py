"""Find out whether the voltages change between the rows of a log, from the motion.

A controller that is faster than the log changes the voltages several times from one row to the next. The log
does not say so, but the motion does: voltages that are held from row to row act late, by up to half a
sampling period. A machine is therefore fitted with held voltages, then with voltages that are interpolated
and change twice a row and, unless that gains little, four, eight and sixteen times, while the error falls. If
that reduces the error clearly, the changes are counted by the delay that instruments find
(`slow_logs.excess_delay`). No more changes are tried than the search for effects has integration steps: in a
log at 3200 Hz none, because its rows are closer than two steps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...effects import EFFECTS
from ...machine import Effect, Machine, argument_names
from ...preparation.dataset import Dataset
from ..judge.criteria import SelectionCriteria
from ..judge.error import is_enough, required_gain
from ..judge.voltages import (
    UpdatesEvidence,
    another_rate_explains_more,
    drives_delay_voltages,
    interpolation_suffices,
    may_change_between_rows,
    voltages_change_at_another_rate,
    voltages_change_between_rows,
)
from ..predict.free_parameters import FreeParameter
from ..predict.prediction import NARROWEST_WITH_VOLTAGE_ERRORS, SEARCH_BANDWIDTH, SIMULATION
from ..predict.voltage_errors import expected_excess, simulation_error
from .covariance import DELAY_STD
from .estimation import Fit, fit, prediction_costs
from .model_error import continue_fit, search_step
from .slow_logs import ExcessDelay, excess_delay

# Gain by any number of changes relative to that by two. Voltages that change n times a row act late by 1 / (2
# n) sampling periods: two changes remove half of the delay of held ones, and with it more than half of its
# squared error.
_MOST_FURTHER_GAIN = 2.0
# Changes a row: each acts late by half of what the one before does. Instruments count what lies between.
_TRIALS = (2, 4, 8, 16)
_FEWEST_UPDATES = 2  # a row; held voltages change once
_DELAY_PRIOR = 10.0  # of a delay of the drives, in units of its scale: the runs determine it
_MOST_UPDATES = 20  # a row; with more, voltages act earlier by less than a fortieth of a sampling period


_ERRS = (
    "what the controller did between the rows beyond that adds up to an error of every simulation: "
    "log at the rate of the controller{}"
)
_SUFFICES = "they are so smooth that simulations err less by this than by the sensors' noise"

# What instruments find with a number of changes a row, if anything; they may begin at what they found with
# another one.
MeasuredExcess = Callable[[int, ExcessDelay | None], ExcessDelay | None]


class VoltageUpdates(NamedTuple):
    """Number of voltage changes from one row of a log to the next, with the errors that led to it.

    Attributes:
        per_row: Number of changes; 1 if the voltages are held.
        held: Chi-squared per sample of the machine that is fitted with held voltages, dimensionless.
        fitted: Chi-squared per sample of the machine that is fitted with that many changes, dimensionless.
    """

    per_row: int
    held: float
    fitted: float

    def describe(self, commands: str, period: float) -> str:
        """Return a clause for the user: how often voltages change, and chi-squared with and without.

        Args:
            commands: Name of the inputs, such as "voltages" (`Machine.commands_in_words`).
            period: Sampling period of the log, s.
        """
        return (
            f"the {commands} change between the rows, about {self.per_row} "
            f"times from one row to the next (every {1e3 * period / self.per_row:.2g} "
            f"ms; chi-squared per sample {self.fitted:.3g} instead of {self.held:.3g} with held {commands})"
        )


def describe_interpolation(machine: Machine, data: Dataset) -> str:
    """Return a clause for the user about interpolated voltages.

    It says that simulations err less by them than by noise (`judge.voltages.interpolation_suffices`);
    otherwise that they err more, and what to log in future.

    Args:
        machine: Machine, refitted to these runs.
        data: Runs whose voltages are interpolated, with the errors that this causes (`with_voltage_errors`).
    """
    if interpolation_suffices(simulation_error(machine, data) / data.noise):
        return _SUFFICES
    # The mean of a set point does not tell what the drive made of it.
    return _ERRS.format(
        "" if machine.drive_laws else f", or log the mean {machine.commands_in_words} between rows"
    )


def other_updates(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> VoltageUpdates | None:
    """Check, after effects were found, whether the voltages change more or less often per row than assumed.

    The effects that the first count lacked caused an error that may have falsified it. Held voltages are
    compared with changing ones again (`voltage_updates`). Smooth set points that are interpolated are held
    after all if the effects leave no other sign of changes (`_held_after_all`). Otherwise the delay of the
    voltages must differ clearly from that of the assumed number, and another number must pass
    `judge.voltages.another_rate_explains_more`; beside a delay of the drives, which makes up for any number,
    the errors alone decide (`number_with_clear_gains`).

    Args:
        fitted: Fit of a machine with effects to the runs.
        data: Runs with the assumed number of changes (`Dataset.updates`).
        criteria: Decision thresholds for the reduction of the error.

    Returns:
        The other number of changes with its errors; None if the assumed one stays, or if an earlier search
        rejected the other one with at least as many effects.
    """
    updates = _held_after_all(fitted, data, criteria) if data.has_voltage_errors else None
    if updates is None:
        count = _counted_again if data.has_voltage_errors else voltage_updates
        updates = count(fitted, data, criteria)
    if updates is None or updates.per_row == data.updates:
        return None
    rejected_with = data.updates_rejected.get(updates.per_row, -1)  # effects
    return updates if len(fitted.machine.effects) > rejected_with else None


def _held_after_all(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> VoltageUpdates | None:
    """Return that set points are held if, beside the effects, nothing speaks for changes any more; else None.

    Set points of a planner are so smooth that changes between the rows only act earlier, by half of a row at
    most. Without its dead band and unbalance, a servo seemed to answer earlier, too. This is not asked where
    interpolation errs by more than the noise: changes then leave more than a delay.

    Args:
        fitted: Fit of a machine with effects to the runs.
        data: Runs with interpolated set points.
    """
    smooth = fitted.machine.drive_laws and interpolation_suffices(
        simulation_error(fitted.machine, data) / data.noise
    )
    if not smooth:
        return None
    bandwidth = max(fitted.bandwidth, NARROWEST_WITH_VOLTAGE_ERRORS)
    known = data.without_voltage_errors()
    changing, held = (continue_fit(fitted, each, bandwidth) for each in (known, known.with_held_voltages()))
    return None if _change(held, changing, known, criteria) else VoltageUpdates(1, held.chi2, changing.chi2)


def _counted_again(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> VoltageUpdates | None:
    """Return another number of changes of interpolated voltages that the error confirms, or None."""
    if _delays_all_drives(fitted.machine):
        return _counted_beside_delay(fitted, data, criteria)
    excess = excess_delay(fitted, data)
    if excess is None:
        return None
    deviation = math.hypot(excess.deviation, DELAY_STD)
    clear = voltages_change_at_another_rate(excess.periods, deviation)
    # The largest number is where the count ends, and need not be close to an estimate.
    at_end = data.updates == most_updates(data)
    if not clear and not at_end:
        return None
    # Instruments need voltages that change; that they are held follows from the delay with the fewest
    # changes.
    nearest = _number_with_delay(0.5 / data.updates + excess.periods, 1, most_updates(data))
    held_after_all = clear and (data.updates, nearest) == (_FEWEST_UPDATES, 1)
    per_row = 1 if held_after_all else count_updates(fitted, data, excess)
    if at_end and not voltages_change_at_another_rate(0.5 / per_row - 0.5 / data.updates, deviation):
        return None
    if clear and excess.periods > 0.0:
        # With the same errors of the voltages, held ones included: these favor them.
        fewer, delayed = (
            continue_fit(fitted, data.with_updates(per_row), fitted.bandwidth),
            _with_delay(fitted, data),
        )
        if drives_delay_voltages(fewer.error, delayed.error, criteria):
            return _counted_beside_delay(delayed, data, criteria)
    # Held voltages are no interpolated ones, and have none of their errors.
    known = data if per_row > 1 else data.without_voltage_errors()
    bandwidth = fitted.bandwidth if per_row > 1 else SEARCH_BANDWIDTH
    present, counted = (
        continue_fit(fitted, each, bandwidth) for each in (known, known.with_updates(per_row))
    )
    if not another_rate_explains_more(present.error, counted.error, criteria):
        return None
    held = counted if per_row == 1 else continue_fit(fitted, data.with_held_voltages(), SEARCH_BANDWIDTH)
    return VoltageUpdates(per_row, held.chi2, counted.chi2)


def _counted_beside_delay(delayed: Fit, data: Dataset, criteria: SelectionCriteria) -> VoltageUpdates | None:
    """Return another number of changes that explains more beside a delay or lag of the drives, or None.

    Such an effect makes up for the delay of any number of changes, so that instruments tell nothing; what is
    left is how smoothly the voltages change.

    Args:
        delayed: Fit of a machine whose drives have a delay or lag.
        data: Runs with interpolated voltages.
    """
    number, best = _with_fewest_changes(delayed, data, criteria)
    if number == data.updates:
        return None
    held = continue_fit(delayed, data.with_held_voltages(), SEARCH_BANDWIDTH)
    return VoltageUpdates(number, held.chi2, best.chi2)


def _with_fewest_changes(delayed: Fit, data: Dataset, criteria: SelectionCriteria) -> tuple[int, Fit]:
    """Return the number of changes of which no other one explains clearly more beside a delay of the drives.

    Errors prefer too many changes. They are therefore doubled only while that reduces the error by as much as
    an effect must, and halved if not even one doubling does.

    Args:
        delayed: Fit of a machine whose drives have a delay or lag, to these runs.
    """

    def again(fitted: Fit, number: int, goal: float) -> Fit:
        return continue_fit(fitted, data.with_updates(number), fitted.bandwidth, goal=goal)

    start = continue_fit(delayed, data, delayed.bandwidth)
    return number_with_clear_gains(start, data.updates, most_updates(data), again, criteria)


def number_with_clear_gains(
    start: Fit, number: int, most: int, again: Callable[[Fit, int, float], Fit], criteria: SelectionCriteria
) -> tuple[int, Fit]:
    """Double the number of voltage changes per row while each doubling reduces the error by `required_gain`.

    If the first doubling does not, halve the number in the same way, down to 2.

    Args:
        start: Fit with the first number.
        number: First number of changes per row, at least 2.
        most: Largest number.
        again: Function (fit, number, cost) that continues a fit with another number; it may end early if the
            result exceeds the cost (dimensionless).
        criteria: Decision thresholds of `required_gain`.

    Returns:
        Final number, and its fit.
    """
    present = number
    for factor in (2.0, 0.5):
        number, best = present, start
        while _FEWEST_UPDATES <= (other := round(factor * number)) <= most:
            enough = required_gain(best.error, criteria)
            trial = again(best, other, best.cost - enough * best.count)
            if not is_enough(best.error, trial.error, enough):
                break
            number, best = other, trial
        if best is not start:
            break
    return number, best


def _with_delay(
    fitted: Fit, data: Dataset, *, start: float = 0.0, least: float = 0.0, goal: float = math.inf
) -> Fit:
    """Fit a machine again with a delay of all drives, from which a fit learns how late the voltages act.

    Args:
        fitted: Fit of a machine to the same runs.
        start: Delay from which the fit starts, s.
        least: Least delay, s.
        goal: Cost, dimensionless, above which the fit is of no use (`fit`).
    """
    if _delays_all_drives(fitted.machine):
        return continue_fit(fitted, data, fitted.bandwidth, goal=goal)
    delay = EFFECTS["input_delay"].at("drives", d=start)
    (definition,) = delay.definition.parameters
    parameter = FreeParameter(
        f"{delay.label}.{definition.name}",
        start,
        prior=_DELAY_PRIOR,
        scale=definition.scale,
        lower=max(definition.lower, least),
        upper=definition.upper,
    )
    return fit(
        fitted.machine.with_effects(delay),
        (*fitted.free, parameter),
        data,
        fitted.bandwidth,
        theta=np.append(fitted.theta, 0.0),
        longest_step=search_step(fitted.bandwidth, data),
        goal=goal,
    )


def _delays_all_drives(machine: Machine) -> bool:
    """Return whether all drives act later than their voltages, by delays or lags that are known already.

    Another number of changes moves the voltages of all drives. A delay of one drive of several does not make
    up for that.
    """
    late = {d for e in machine.effects if is_timing(e.definition) for d in e.components(machine)}
    return late.issuperset(drive.name for drive in machine.drives)


def is_timing(effect: Effect) -> bool:
    """Return whether an effect delays the voltages, or lets currents lag behind them (inductance).

    Effects of heat or of a sagging supply, whose current follows the voltage at once, are not among them.
    """
    lags = effect.current is not None and effect.next_state is not None
    return effect.delay is not None or (lags and "i" not in argument_names(effect.current))


def count_updates(fitted: Fit, data: Dataset, excess: ExcessDelay | None = None) -> int:
    """Count the voltage changes from one row of a log to the next, from the delay of the voltages.

    Voltages that change n times a row act later than continuous ones by 1 / (2 n) sampling periods. A fit by
    instrumental variables estimates this delay (`slow_logs.excess_delay`). Comparing the errors of fits would
    count too many changes: voltages that act earlier contain more of the controller's answer to the rounding
    error of the next row.

    Args:
        fitted: Fit of a machine to these runs.
        data: Runs with an assumed number of changes, at least 2.
        excess: Delay beyond that of the assumed number, if it is already known.

    Returns:
        The number, from 2 to `most_updates`, whose delay agrees best with the estimated one
        (`number_with_least_excess`); the assumed number if the delay cannot be estimated.
    """
    most = most_updates(data)
    if most <= _FEWEST_UPDATES:
        return data.updates

    def measured(number: int, start: ExcessDelay | None) -> ExcessDelay | None:
        return excess_delay(fitted, data.with_updates(number), start)

    return number_with_least_excess(data.updates, most, excess or excess_delay(fitted, data), measured)


def number_with_least_excess(
    number: int, most: int, excess: ExcessDelay | None, measured: MeasuredExcess
) -> int:
    """Return the number of voltage changes per row whose delay agrees best with the estimated delay.

    With the right number n, the voltages act neither later nor earlier than 1 / (2 n) sampling periods: the
    excess delay is 0. The number whose delay is nearest to the estimate, then the one beside the present
    number in its direction, is accepted if its excess delay is smaller; this is repeated until neither is. If
    the excess still differs from 0 by 3.3 standard deviations, the number is halved or doubled until its sign
    changes, and bisected.

    Args:
        number: Assumed number of changes per row, at least 2.
        most: Largest number.
        excess: Excess delay with the assumed number; None if it cannot be estimated.
        measured: Function (number, excess) that estimates the excess delay with another number, None if it
            cannot; it may start from the excess that was found before.

    Returns:
        Number from 2 to `most`; the assumed one if `excess` is None.
    """
    while excess is not None:
        nearest = _number_with_delay(0.5 / number + excess.periods, _FEWEST_UPDATES, most)
        if nearest == number:
            break
        # Where effects are missing, the estimate depends on the number itself, and the one beside may be
        # better.
        for trial in dict.fromkeys((nearest, number + (1 if nearest > number else -1))):
            found = measured(trial, excess)
            if found is not None and abs(found.periods) < abs(excess.periods):
                number, excess = trial, found
                break
        else:
            if voltages_change_at_another_rate(excess.periods, excess.deviation):
                number = _number_without_excess(number, most, excess, measured)
            break
    return number


def _number_without_excess(number: int, most: int, excess: ExcessDelay, measured: MeasuredExcess) -> int:
    """Return the number of changes a row at which instruments find neither a later nor an earlier action.

    By how much the voltages act later depends on the number itself, and is too small where errors of the
    voltages pass for delays that alternate. Its sign tells whether there are fewer changes or more. Their
    number is halved or doubled until the sign changes, and the numbers between are bisected.

    Args:
        number: Number of changes that is clearly wrong.
        most: Largest number.
        excess: What instruments find with it.
        measured: Function that returns what they find with another one.

    Returns:
        The number with the least excess next to the change of sign; the given one if there is no such change.
    """
    later = excess.periods > 0.0
    beside, found = number, {number: abs(excess.periods)}
    while (other := max(beside // 2, 2) if later else min(2 * beside, most)) != beside:
        estimate = measured(other, None)
        if estimate is None:
            return number
        found[other] = abs(estimate.periods)
        if (estimate.periods > 0.0) != later:
            break
        beside = other
    else:
        return number
    while abs(other - beside) > 1:
        middle = (other + beside) // 2
        estimate = measured(middle, None)
        if estimate is None:
            break
        found[middle] = abs(estimate.periods)
        beside, other = (middle, other) if (estimate.periods > 0.0) == later else (beside, middle)
    return min((beside, other), key=found.__getitem__)


def _number_with_delay(periods: float, fewest: int, most: int) -> int:
    """Return the number of changes a row that lets voltages act later by about that many sampling periods."""
    return min(range(fewest, most + 1), key=lambda number: abs(0.5 / number - periods))


def voltage_updates(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> VoltageUpdates:
    """Determine whether, and how often, the voltages change from one row of a log to the next.

    Fits with held voltages and with 2, 4, 8 and 16 changes a row are compared
    (`judge.voltages.voltages_change_between_rows`); if changing voltages are better, `count_updates` finds
    their number. If they are not, both are compared once more beside a delay of the drives.

    Args:
        fitted: Fit of a machine to the runs with held voltages. The fits that are compared have its observer,
            or one of 15 rad/s if that is narrower.
        data: The runs.
        criteria: Decision thresholds for the reduction of the error.

    Returns:
        The number of changes per row, 1 if the voltages are held, with chi-squared per sample of the fits
        with held and with changing voltages.
    """
    data = data.with_updates(1)
    held = continue_fit(fitted, data, max(fitted.bandwidth, NARROWEST_WITH_VOLTAGE_ERRORS))
    if not can_show_updates(data):
        return VoltageUpdates(1, held.chi2, held.chi2)
    per_row, best = _least_error(held, data, criteria)
    if per_row > 1 and _change(held, best, data.with_updates(per_row), criteria):
        per_row = count_updates(best, data.with_updates(per_row))
        fitted = continue_fit(best, data.with_updates(per_row), held.bandwidth)
        return VoltageUpdates(per_row, held.chi2, fitted.chi2)
    beside_delay = _changing_beside_delay(held, data, criteria)
    return beside_delay or VoltageUpdates(1, held.chi2, held.chi2)


def _changing_beside_delay(held: Fit, data: Dataset, criteria: SelectionCriteria) -> VoltageUpdates | None:
    """Return how often the voltages change between the rows if drives act as late as held voltages do.

    Held voltages act late by half a sampling period, and so do voltages that change between the rows of
    drives with a delay or lag. Both are compared with the delay as a parameter; None if the voltages may be
    held. What tells them apart is how smoothly the voltages change. As held voltages cannot act earlier than
    that, changing ones must not in this comparison either: a simulator of Euler steps acts earlier by half a
    step, and a laser that is late seems to. Two changes a row must reduce the error by a part of what an
    effect must, because what a machine without an effect leaves changes a little with everything. What the
    delay explains does not count: held voltages may have it as well.

    Args:
        held: Fit with voltages that are held from row to row.
        data: The same runs.
    """
    changing = data.with_updates(_FEWEST_UPDATES)
    earlier = (0.5 - 0.5 / _FEWEST_UPDATES) * data.period
    # Held voltages with a delay leave no more than without, so that most comparisons end here, with one fit.
    as_late = _with_delay(held, changing, start=earlier, least=earlier, goal=_promising_cost(held, criteria))
    if not as_late.cost < _promising_cost(held, criteria):
        return None
    held_late = _with_delay(held, data)
    if not as_late.cost < _promising_cost(held_late, criteria):
        return None
    if not _change(held_late, as_late, changing, criteria):
        return None
    delayed = _with_delay(held, changing, start=earlier)
    number, best = _with_fewest_changes(delayed, changing, criteria)
    return VoltageUpdates(number, held.chi2, best.chi2)


def _change(held: Fit, changing: Fit, data: Dataset, criteria: SelectionCriteria) -> bool:
    """Return whether the voltages change between the rows, by fits with held and with changing voltages.

    Args:
        held: Fit with voltages that are held from row to row.
        changing: Fit with voltages that change between the rows.
        data: Runs with the changing voltages, without their errors.
    """
    before, after = (
        prediction_costs(fitted.machine, runs, held.bandwidth)
        for fitted, runs in ((held, data.with_held_voltages()), (changing, data))
    )
    excess = expected_excess(changing.machine, data, held.bandwidth)
    error = dataclasses.replace(changing.error, floor=changing.floor + excess)
    evidence = UpdatesEvidence(held.error, error, float(np.mean(after < before)))
    return voltages_change_between_rows(evidence, criteria)


def can_show_updates(data: Dataset) -> bool:
    """Return whether the motion can show that voltages change between the rows of a log.

    It can if the rows are at least two integration steps apart (`most_updates` is above 1), and the inputs
    change in row after row (`judge.voltages.may_change_between_rows`).
    """
    return most_updates(data) > 1 and may_change_between_rows(successive_changes(data))


def most_updates(data: Dataset) -> int:
    """Return the largest number of voltage changes per row that is tried.

    Changes that follow each other faster than the integration steps of the search (0.25 ms) move the voltages
    by less than half a step, but multiply the steps of every simulation.

    Args:
        data: Runs, for their sampling period.

    Returns:
        The number, from 1 to 20; 1 if the rows follow each other as fast as these steps.
    """
    return min(max(round(data.period / search_step(SIMULATION, data)), 1), _MOST_UPDATES)


def successive_changes(data: Dataset) -> float:
    """Return the fraction of the changes of the inputs that follow a change in the row before, dimensionless.

    A change is a row in which any input differs from the row before. Dropped rows, whose inputs are unknown,
    are not counted. The result is 0 if the inputs never change.
    """
    changes, successive = 0, 0
    for run in data.runs:
        known = ~run.dropped[1:] & ~run.dropped[:-1]
        changed = (np.diff(run.inputs, axis=0) != 0.0).any(axis=1) & known
        changes += int(changed.sum()) - int((changed[1:] & ~known[:-1]).sum())
        successive += int((changed[1:] & changed[:-1]).sum())
    return successive / max(changes, 1)


def _least_error(held: Fit, data: Dataset, criteria: SelectionCriteria) -> tuple[int, Fit]:
    """Return the number of changes with the least error, and its fit; a fit with held voltages is given.

    More than two are tried only if two reduce the error as `_promising_cost` says.
    """
    best, per_row = held, 1
    most, promising = most_updates(data), _promising_cost(held, criteria)
    for trial in (number for number in _TRIALS if number <= most):
        goal = min(best.cost, promising)
        refitted = continue_fit(best, data.with_updates(trial), held.bandwidth, goal=goal)
        if not refitted.cost < best.cost or refitted.cost > promising:
            break
        best, per_row = refitted, trial
    return per_row, best


def _promising_cost(held: Fit, criteria: SelectionCriteria) -> float:
    """Return the cost, dimensionless, below which two changes a row may lead to as much as an effect must."""
    return held.cost - required_gain(held.error, criteria) / _MOST_FURTHER_GAIN * held.count
