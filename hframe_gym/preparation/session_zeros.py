"""Zeros that the encoders kept in a session: found in all runs, and corrected by a fitted machine.

The effects of a fitted machine stretch the belts at rest, and the zeros follow from measurements at rest.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..arrays import Array, Quanta
from ..machine import Machine
from ..robust_statistics import std_by_median
from .dataset import Dataset
from .start.belt_stretch import max_held_angle
from .start.encoder_zeros import MAX_SCATTER, EncoderZeros
from .start.measured_state import InitialState
from .start.modeled_state import encoder_zero_errors

# Runs needed to distinguish an encoder that keeps its zero from one that is switched on anew for every run.
_MIN_RUNS_FOR_ZERO = 3
_MIN_STRETCH = 0.1e-3  # rad; zeros that scatter by less from run to run show no stretch of the belts.


def common_encoder_zeros(initial: Sequence[InitialState], machine: Machine, quanta: Quanta) -> EncoderZeros:
    """Find the encoders that kept their zero in all runs of a session.

    An encoder on a pulley kept its zero if the standard deviation of the zero from run to run is below the
    belt stretch that static friction can maintain (`max_held_angle`), or below two quantization steps. It is
    computed from the median of the deviations, which single runs hardly change. The zeros of an encoder that
    was switched on anew for every run differ by far more. If at least three runs measure their position at
    rest, only these are used.

    Args:
        initial: Initial states of the runs, each estimated with unknown zeros.
        machine: Machine as declared.

    Returns:
        For each such encoder, the median over the runs and, as `spread`, the standard deviation without
        runs that deviate too far to have kept the zero, or 0 if it is at most a quantization step or 0.1
        mrad. The zeros of all other sensors are unknown, also where the machine declares them. With fewer
        than three runs or without belts: the zeros that the machine declares.
    """
    zeros = EncoderZeros.of_machine(machine)
    if not machine.belts or len(initial) < _MIN_RUNS_FOR_ZERO:
        return zeros
    zeros = zeros.without(np.ones(len(machine.sensors), np.bool_))
    # Runs whose position is measured at rest give the better zeros; the others count only if these are too
    # few.
    positioned = [state.zeros for state in initial if state.position_measured]
    by_run = np.array(
        positioned if len(positioned) >= _MIN_RUNS_FOR_ZERO else [state.zeros for state in initial]
    )
    median = np.median(by_run, axis=0)  # (sensors,)
    deviation = np.abs(by_run - median)  # (runs, sensors)
    spread = std_by_median(deviation, axis=0)  # single deviating runs do not change it
    limit = np.maximum(max_held_angle(machine), 2 * quanta)
    # It is zero if more than half of the runs start where nothing stretches the belts. The others show the
    # stretch.
    kept = deviation <= limit + MAX_SCATTER * spread
    of_kept = np.sqrt(np.mean(deviation**2, axis=0, where=kept))
    for j, sensor in enumerate(machine.sensors):
        rotary = machine.coordinate(machine.coordinate_of_sensor(sensor)).kind == "rotary"
        if sensor.incremental and rotary and spread[j] < limit[j]:
            zeros.values[j] = median[j]
            scatter = max(spread[j], of_kept[j])
            zeros.spread[j] = scatter if scatter > max(quanta[j], _MIN_STRETCH) else 0.0
    return zeros


def refine_encoder_zeros(data: Dataset, machine: Machine, reference: Dataset | None = None) -> Dataset:
    """Copy a data set, with zeros of the encoders corrected by a fitted machine.

    `prepare` estimates zeros as if the belts were unstretched at rest. The effects of the fitted machine give
    the forces that stretch the belts at rest; this stretch is the error of the zeros. If the motion of the
    runs has already corrected the zeros of the reference (`EncoderZeros.by_motion`), those are used instead.

    Args:
        data: Data set to correct (times, voltages, measurements, SI).
        machine: Fitted machine with its effects (deviations from the nominal model).
        reference: Data set to which the machine was fitted; the errors of the zeros are estimated from it.
            Default: `data`.

    Returns:
        Copy with corrected initial states and measurements. `data` itself if the machine has no effects that
        change anything at rest, or if no encoder with a known zero resolves the stretch of the belts.
    """
    source = data if reference is None else reference
    if source.zeros is not None and source.zeros.by_motion:
        return with_zeros(data, machine, source.zeros)
    if not may_correct_zeros(data, machine):
        return data
    states = [run.initial for run in source.runs]
    errors = encoder_zero_errors(machine, states)
    bare = dataclasses.replace(machine, effects=())
    # Effects that change nothing at rest, such as those of friction, give no reason to correct zeros of all
    # runs by the median of some (chi-squared 1.64 instead of 1.07 in a log with interpolated voltages).
    if np.allclose(errors, encoder_zero_errors(bare, states), rtol=0.0, atol=1e-9):
        return data
    return _corrected(data, machine, errors)


def with_zeros(data: Dataset, machine: Machine, zeros: EncoderZeros) -> Dataset:
    """Copy a data set whose encoders count from the given zeros; `data` itself if they do already.

    Args:
        data: Runs of the same session.
        machine: Machine of these runs.
        zeros: Zeros of the encoders.
    """
    if data.zeros is None:
        return data
    errors = np.nan_to_num(zeros.values - data.zeros.values)
    if not errors.any():
        return data
    return dataclasses.replace(_corrected(data, machine, errors), zeros=zeros)


def _corrected(data: Dataset, machine: Machine, errors: Array) -> Dataset:
    """Return a copy with errors (sensors,) added to the zeros of the session, where runs count from them."""
    runs = []
    for run in data.runs:
        here = np.where(run.initial.resolves_stretch, errors, 0.0)  # 0 for an encoder switched on anew
        initial = _with_corrected_zeros(run.initial, machine, here)
        runs.append(dataclasses.replace(run, initial=initial, outputs=run.outputs - here))
    zeros = data.zeros and data.zeros._replace(values=data.zeros.values + errors)
    return dataclasses.replace(data, runs=tuple(runs), zeros=zeros)


def may_correct_zeros(data: Dataset, machine: Machine) -> bool:
    """Return whether `refine_encoder_zeros` may change zeros with a machine.

    It may if the machine has effects, and an encoder of a run kept its zero and measures belt stretch.
    """
    return bool(machine.effects) and any(np.any(run.initial.resolves_stretch) for run in data.runs)


def _with_corrected_zeros(initial: InitialState, machine: Machine, errors: Array) -> InitialState:
    """Return an initial state with errors (sensors,) added to the zeros, and with the resulting positions."""
    state, zeroed = initial.state.copy(), initial.zeroed_measurement
    if len(zeroed):
        zeroed = zeroed - errors
        if not initial.lasers_measured:
            position = initial.position_matrix @ np.nan_to_num(zeroed)
            state[: len(position)] = position
    for j in np.flatnonzero(initial.resolves_stretch):
        sensor = machine.sensors[j]
        i = machine.coordinate_names.index(sensor.coordinate)
        state[i] = initial.state[i] - errors[j] / sensor.row[sensor.coordinate]
    zeros = initial.zeros + errors
    return dataclasses.replace(
        initial, state=state, zeroed_measurement=zeroed, zeros=zeros, zeros_refined=True
    )
