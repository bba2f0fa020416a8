"""Correct the zeros of encoders by a fitted machine, whose effects stretch the belts at rest."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..arrays import Array
from ..machine import Machine
from .dataset import Dataset
from .initial_state import encoder_zero_errors
from .rest_measurement import InitialState


def refine_encoder_zeros(data: Dataset, machine: Machine, reference: Dataset | None = None) -> Dataset:
    """Copy a data set, with zeros (measurements at position 0) of the encoders corrected by a fitted machine.

    `prepare` estimates zeros as if the belts were unstretched at rest. The effects of the fitted machine give the
    forces that stretch the belts at rest; this stretch is the error of the zeros.

    Args:
        data: Data set to correct (times, voltages, measurements, SI).
        machine: Fitted machine with its effects (deviations from the nominal model).
        reference: Data set to which the machine was fitted; the errors of the zeros are estimated from it.
            Default: `data`.

    Returns:
        Copy with corrected initial states and measurements, m or rad, shape (n, sensors) for each run. `data` itself if
        the machine has no effects, or no encoder with a known zero resolves the stretch of the belts.
    """
    runs = (data if reference is None else reference).runs
    if not machine.effects or not any(np.any(run.initial.resolves_stretch) for run in data.runs):
        return data
    errors = encoder_zero_errors(machine, [run.initial for run in runs])
    initial = [_with_corrected_zeros(run.initial, machine, errors) for run in data.runs]
    corrected = (
        dataclasses.replace(run, initial=state, outputs=run.outputs - errors)
        for run, state in zip(data.runs, initial, strict=True)
    )
    zeros = data.zeros and data.zeros._replace(values=data.zeros.values + errors)
    return dataclasses.replace(data, runs=tuple(corrected), zeros=zeros)


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
