"""Estimate the state from which a run most probably began, given all of its measurements.

The measurements at rest leave unknowns (`start_uncertainty`). The motion that follows depends on them and
shows them, once a machine is known well enough.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ...preparation.session_zeros import may_correct_zeros, refine_encoder_zeros, with_zeros
from ...preparation.start.measured_state import InitialState
from ..judge.criteria import SelectionCriteria
from ..judge.error import FitError, is_enough, only_noise_is_left, required_gain
from ..predict.prediction import (
    POLISH_STEP,
    SEARCH_BANDWIDTH,
    SIMULATION,
    map_runs,
    predict,
    residuals,
    whitened,
)
from ..predict.start_uncertainty import (
    effect_state_spreads,
    predict_with_displaced_starts,
    probable_amounts,
    start_displacements,
    uncertain_starts,
)
from .estimation import Fit, prediction_cost
from .lost_voltages import estimate_lost_voltages
from .model_error import continue_fit, fit_with_model_error

# Iterations of a descent, fractions of a step that it tries, and its differences in standard deviations.
_ITERATIONS, _FRACTIONS, _DIFFERENCE = 6, np.array([1.0, 0.5, 0.25, 0.1]), 0.3
_SMALLEST_DECREASE = 0.01  # of the cost per iteration, below which a descent ends
_NOISE_ONLY = 1.2  # mean square error in units of the noise, above which other minima are looked for
# Random displacements from which the search is repeated: their number, standard deviation, and how many of
# them are followed over the first motion, then over the complete run, where the error is a more rugged
# function of the start.
_DRAWS, _DRAW_SPREAD, _FIRST_DESCENTS, _DESCENTS = 127, 1.5, 8, 3
# Motion over which the minima of a long run are compared, rows and s, whichever is longer: two normal runs.
# Only the best minimum is followed over the complete run, because a descent takes longer in proportion to it.
_LONGEST_ROWS, _LONGEST_MOTION = 10_000, 10.0
_FIRST_MOTION = 0.3  # s after the rows at rest; several periods of the belts' vibration

# Function from displacements of a start in units of their standard deviations, shape (B, displacements), to
# simulation errors in units of the noise, shape (B, values).
_Errors = Callable[[Array], Array]


def most_probable_initial_state(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Return the state from which a run most probably began, given all of its measurements.

    It is the state of maximum posterior density: it fits the measurements and is near the state measured at
    rest. An effect is a deviation from the nominal model. Some effects, such as hysteresis and bristle
    friction, have states, which remember motion before the run.

    Args:
        machine: Machine to simulate, with its effects.
        run: Run as `prepare` returns it: times, voltages, measurements minus the sensors' zeros, initial
            state.
        data: Data set of the run, for the sampling period and the sensors' quantization steps.

    Returns:
        Positions (m, rad), velocities (m/s, rad/s) and states of the effects (SI),
        shape (2 * coordinates + effect states,).
    """
    beginning = cache(run.first_rows)  # it keeps what predictions need of a run

    def errors(states: Array, rows: int) -> Array:
        first = beginning(rows)
        motion = predict(
            machine, first, SIMULATION, period=data.period, initial_state=states, longest_step=POLISH_STEP
        )
        # as `recording_simulation` does for a single run
        return residuals(first, data, motion.readings, fitted=False)

    # Only positions and velocities are passed: the effects' states are estimated anew, starting from 0.
    state = run.initial_state(machine)[: 2 * len(machine.coordinates)]
    return most_probable_start(machine, run.initial, state, errors, run.time_s)


def start_for_observer(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Return the start from which a prediction with the widest observer (60 rad/s) has the smaller error.

    Two are compared: the measured state, and this state displaced by what the prediction makes most probable,
    to first order. The most probable start of a simulation would take much longer, and is worse for a machine
    that lacks much, because its simulation drifts.

    Args:
        run: Run to predict, n samples.
        data: Data set of the run, for the sampling period and the sensors' quantization steps.

    Returns:
        Positions (m, rad), velocities (m/s, rad/s), effect states (SI), shape (2 * coordinates + effect
        states,).
    """
    start = uncertain_starts(machine, [run])[run.name]
    if not len(start.displacements):
        return start.state
    motion = predict_with_displaced_starts(machine, run, SEARCH_BANDWIDTH, start, period=data.period)
    errors = residuals(run, data, motion.readings)
    # A model error reduces the weight of the data, so that a wrong machine cannot explain its error by the
    # start.
    errors /= max(1.0, float(np.sqrt(np.mean(errors[0] ** 2))))
    displaced = start.state + probable_amounts(errors[0], errors[1:], start.differences) @ start.displacements

    def cost(state: Array) -> float:
        again = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, initial_state=state)
        return float(np.sum(residuals(run, data, again.readings) ** 2))

    return min(start.state, displaced, key=cost)


def refine_dataset(data: Dataset, machine: Machine, reference: Dataset | None = None) -> Dataset:
    """Copy a data set, with corrections that need a fitted machine.

    - Zeros of encoders (measurements at position 0): forces that stretch the belts at rest falsify their
      estimate.
    - Voltages in rows that the logger dropped, which were interpolated: see `estimate_lost_voltages`.
    - Initial states, if they were estimated (`refine_starts`) with another machine.
    - Initial states of effects that remember motion before the recording, such as hysteresis. They must be
      close to the true ones, because a fit linearizes the influence of their uncertainty.

    Args:
        machine: Fitted machine with its effects.
        reference: Data set to which the machine was fitted; the errors of the zeros are estimated from it.
            Default: `data`.

    Returns:
        Copy with corrected initial states, voltages, and measurements minus the corrected zeros; `data`
        itself if there is nothing to correct.
    """
    estimated = any(len(run.initial.start_offset) for run in data.runs)  # by another machine
    data = estimate_lost_voltages(refine_encoder_zeros(data, machine, reference), machine)
    data = refine_starts(data, machine) if estimated else data
    if not np.any(effect_state_spreads(machine) > 0.0):
        return data

    def refined(run: PreparedRecording) -> PreparedRecording:
        start = most_probable_initial_state(machine, run, data)
        states = run.initial.with_start(machine, start).effect_states
        return dataclasses.replace(run, initial=dataclasses.replace(run.initial, effect_states=states))

    return dataclasses.replace(data, runs=tuple(map_runs(refined, data)))


def refine_starts(data: Dataset, machine: Machine) -> Dataset:
    """Copy a data set, with the most probable initial states of the runs for a fitted machine.

    A fit linearizes the influence of an uncertain start. This is inaccurate if the start is far from the
    assumed one, because friction determines whether a belt's stretch is released or held.

    Args:
        machine: Fitted machine with its effects.

    Returns:
        Copy in which `InitialState.start_offset` of each run is estimated.
    """

    def refined(run: PreparedRecording) -> PreparedRecording:
        initial = dataclasses.replace(run.initial, start_offset=np.zeros(0))
        measured = dataclasses.replace(run, initial=initial)
        offset = most_probable_initial_state(machine, measured, data) - measured.initial_state(machine)
        count, all_coordinates = len(initial.position), len(machine.coordinates)
        offset = np.concatenate([offset[:count], offset[all_coordinates : all_coordinates + count]])
        return dataclasses.replace(run, initial=dataclasses.replace(initial, start_offset=offset))

    return dataclasses.replace(data, runs=tuple(map_runs(refined, data)))


def with_zeros_of_motion(fitted: Fit, data: Dataset) -> Dataset:
    """Copy a data set, with the zeros of a session's encoders that the motion shows.

    Zeros that follow from the rows at rest assume that the belts are unstretched on average over the runs. A
    torque on a motor that always acts in the same direction, as that of an amplifier's offset, stretches them
    at the start of each run, by an amount that friction and damping determine. The zero is then wrong by this
    stretch, an observer corrects the motor by this error in every row, and forces that do not exist explain
    these corrections. A simulation needs no zero, and shows none.

    Args:
        fitted: Fit of a machine with effects, by predictions with an observer.
        data: Runs that were fitted.

    Returns:
        Copy in which the zero of each encoder that resolves the stretch of the belts is corrected by the
        median over the runs of its most probable error, to first order; `data` itself if there is no such
        encoder, or the fit is a simulation.
    """
    zeros, machine = data.zeros, fitted.machine
    if zeros is None or not fitted.bandwidth or not may_correct_zeros(data, machine):
        return data
    resolved = np.flatnonzero(np.any([run.initial.resolves_stretch for run in data.runs], axis=0))
    errors = np.diag(zeros.spread)[resolved]  # each of the size of one standard deviation
    # Measured at rest: a larger zero is a smaller angle of the pulley.
    turned = np.zeros((len(resolved), len(machine.coordinates)))
    for k, j in enumerate(resolved):
        name = machine.sensors[j].coordinate
        turned[k, machine.coordinate_names.index(name)] = -zeros.spread[j] / machine.sensors[j].row[name]
    starts = uncertain_starts(machine, data.runs)

    def amounts(run: PreparedRecording) -> Array:
        start = starts[run.name]
        wrong = np.pad(turned, ((0, 0), (0, len(start.state) - turned.shape[1])))
        states = np.vstack([start.state, start.displaced_states, start.state + wrong])
        motion = predict(
            machine,
            run,
            fitted.bandwidth,
            period=data.period,
            initial_state=states,
            extra_measurement=np.pad(errors, ((len(states) - len(errors), 0), (0, 0))),
            longest_step=fitted.longest_step,
        )
        error = whitened(residuals(run, data, motion.readings), run, fitted.bandwidth)
        # A model error reduces the weight of the data.
        error /= max(1.0, float(np.sqrt(np.mean(error[0] ** 2))))
        differences = np.concatenate([start.differences, np.ones(len(resolved))])
        found = probable_amounts(error[0], error[1:], differences)[len(start.displacements) :]
        return np.where(run.initial.resolves_stretch[resolved], found, np.nan)  # or it was switched on anew

    values = zeros.values.copy()
    values[resolved] += np.nanmedian(list(map_runs(amounts, data)), axis=0) * zeros.spread[resolved]
    return with_zeros(data, machine, zeros._replace(values=values, by_motion=True))


def _with_likelier_zeros(current: Fit, data: Dataset, criteria: SelectionCriteria) -> tuple[Fit, Dataset]:
    """Return a fit to runs with the zeros that the motion shows, if these reduce the error clearly."""
    while (corrected := with_zeros_of_motion(current, data)) is not data:
        enough = required_gain(current.error, criteria)
        goal = current.cost - enough * data.count
        fitted = continue_fit(current, corrected, current.bandwidth, goal=goal)
        if not is_enough(current.error, fitted.error, enough):
            break
        current, data = fit_with_model_error(fitted, corrected), corrected
    return current, data


def with_probable_starts(current: Fit, data: Dataset, criteria: SelectionCriteria) -> tuple[Fit, Dataset]:
    """Replace the assumed starts of the runs by the most probable ones, if that reduces the error clearly.

    The error must fall by as much as an effect must reduce it. Errors of the assumed starts look like a
    missing effect.

    Args:
        current: Fit of a machine.
        criteria: Decision thresholds of `judge.error.required_gain`.

    Returns:
        fit: New fit, to runs that start from their most probable states; `current` if these explain little.
        data: Data set with these initial states; `data` if they explain little.
    """
    if only_noise_is_left(current.error, criteria) or not math.isfinite(current.cost):
        return current, data
    current, data = _with_likelier_zeros(current, data, criteria)
    if not any(map(len, start_displacements(current.machine, [run.initial for run in data.runs]))):
        return current, data  # nothing is uncertain
    refined = refine_starts(data, current.machine)
    cost = prediction_cost(current.machine, refined, current.bandwidth, longest_step=current.longest_step)
    if not is_enough(current.error, FitError(cost, data.count), required_gain(current.error, criteria)):
        return current, data
    return fit_with_model_error(continue_fit(current, refined, current.bandwidth), refined), refined


def most_probable_start(
    machine: Machine,
    initial: InitialState,
    state: Array,
    errors: Callable[[Array, int], Array],
    time_s: Array,
) -> Array:
    """Return the state from which a run most probably began, by a function that simulates it.

    It is the state of maximum posterior density. It minimizes the sum of squared simulation errors in units
    of the noise plus the sum of squared displacements from the measured state in units of their standard
    deviations. The squared errors of an inaccurate model are first divided by their mean if it exceeds 1.

    Friction makes the sum of squares a function with many minima: the held stretch of a belt is released in
    one and not in another. If the minimum next to the measured state leaves more than noise, 127 random
    states (fixed seed) are compared over the first motion, where minima are fewer, and the best of them are
    followed over the complete run. In a long run, the first 10 s of motion, at least 10,000 rows, decide
    which of them is followed to its end.

    Args:
        machine: Machine to simulate. Its effects may have states that remember earlier motion, such as
            hysteresis.
        initial: Measured initial state of the run.
        state: Positions (m, rad), then velocities (m/s, rad/s), by the measurements at rest, shape (2 *
            coordinates,).
        errors: Function that simulates the first rows of the run from states, shape (B, 2 * coordinates +
            effect states), and returns measured minus simulated values in units of the noise, shape (B,
            values), not finite where the simulation diverges. Its second argument is the number of rows.
        time_s: Sample times of the run, s, shape (n,).

    Returns:
        Positions (m, rad), velocities (m/s, rad/s) and effect states (SI), shape (2 * coordinates + effect
        states,). If nothing is uncertain or the simulation diverges: `state` itself, with effect states of
        zero.

    References:
        Nocedal and Wright (2006), "Numerical optimization", chapter 10 (Gauss-Newton method with a line
        search).
    """
    (displacements,) = start_displacements(machine, [initial])
    state = np.pad(state, (0, displacements.shape[1] - len(state)))
    count = len(displacements)
    if not count:
        return state

    def errors_over(rows: int) -> _Errors:
        return lambda amounts: errors(state + amounts @ displacements, rows)

    rest = initial.resting_rows
    longest = int(np.searchsorted(time_s, time_s[rest - 1] + _LONGEST_MOTION, "right"))
    compared = min(max(longest, rest + _LONGEST_ROWS), len(time_s))
    beginning = errors_over(compared)
    minima = [_descend(beginning, np.zeros(count))]
    if minima[0].mean_square > _NOISE_ONLY:
        end = time_s[rest - 1] + _FIRST_MOTION
        first_motion = errors_over(int(np.searchsorted(time_s, end, "right")))
        draws = _DRAW_SPREAD * np.random.default_rng(0).normal(size=(_DRAWS, count))
        best = _most_probable_first(_evaluate(first_motion, np.vstack([minima[0].amounts, draws])))
        followed = [_descend(first_motion, minimum.amounts).amounts for minimum in best[:_FIRST_DESCENTS]]
        best = _most_probable_first(_evaluate(beginning, np.array(followed)))
        minima += [_descend(beginning, minimum.amounts) for minimum in best[:_DESCENTS]]
    probable = _most_probable_first(minima)[0]
    if compared < len(time_s):
        probable = _descend(errors_over(len(time_s)), probable.amounts)
    return np.asarray(state + probable.amounts @ displacements)


class _Minimum(NamedTuple):
    """Displacements of a start in units of their standard deviations, and the simulation's squared errors.

    Attributes:
        amounts: Displacements, shape (displacements,).
        squares: Sum of the squared errors in units of the noise; not finite if the simulation diverges.
        size: Number of errors.
    """

    amounts: Array
    squares: float
    size: int

    @property
    def mean_square(self) -> float:
        """Mean squared error in units of the noise."""
        return self.squares / self.size


def _evaluate(errors_at: _Errors, amounts: Array) -> list[_Minimum]:
    """Compute the squared errors from several displaced starts, shape (B, displacements)."""
    with np.errstate(invalid="ignore", over="ignore"):
        return [_Minimum(a, float(e @ e), len(e)) for a, e in zip(amounts, errors_at(amounts), strict=True)]


def _most_probable_first(minima: list[_Minimum]) -> list[_Minimum]:
    """Return starts in the order of their posterior density, with one scale of the errors for all of them."""
    finite = [m for m in minima if np.isfinite(m.squares)] or minima[:1]
    excess = max(1.0, min(m.mean_square for m in finite))
    return sorted(finite, key=lambda m: m.squares / excess + float(m.amounts @ m.amounts))


def _descend(errors_at: _Errors, amounts: Array) -> _Minimum:
    """Find the minimum near displacements, shape (displacements,), by Gauss-Newton steps with line search."""
    best, squares, size, count = amounts, np.inf, 1, len(amounts)
    differences = _DIFFERENCE * np.vstack([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    for _ in range(_ITERATIONS):
        error = errors_at(best + differences)
        if not np.isfinite(error).all():
            break
        now, size = error[0], error.shape[1]
        squares = float(now @ now)
        # (displacements, values)
        response = (error[1 : count + 1] - error[count + 1 :]) / (2.0 * _DIFFERENCE)
        excess = max(1.0, squares / size)  # mean square error in units of the noise
        weight = 1.0 / np.sqrt(excess)
        # Of full rank by the identity, however large the response is; the normal equations would lose it.
        step = np.linalg.lstsq(
            np.vstack([weight * response.T, np.eye(count)]), np.concatenate([weight * now, best]), rcond=None
        )[0]
        trials = best - _FRACTIONS[:, None] * step
        with np.errstate(invalid="ignore", over="ignore"):
            trial_squares = np.sum(errors_at(trials) ** 2, axis=1)
            costs = trial_squares / excess + np.sum(trials**2, axis=1)
        cost = squares / excess + float(best @ best)
        lowest = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
        if not costs[lowest] < cost:
            break
        best, squares = trials[lowest], float(trial_squares[lowest])
        if cost - costs[lowest] < _SMALLEST_DECREASE * cost:
            break
    return _Minimum(best, squares, size)
