"""Simulate a machine over a recording, from the initial state that every command uses.

Identification evaluates its machines on held-out runs with `simulate_recording`, and ``hframe simulate`` calls the same
function with the machine that identification wrote, so both have the same errors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import NotFiniteError, simulate, simulate_batch
from ..machine import Machine, Trajectory
from ..recordings import Recording, fill_gaps, without_outliers
from .criteria import SelectionCriteria
from .dataset import Dataset, PreparedRecording, refine_encoder_offsets, with_encoder_zeros
from .encoder_zeros import EncoderZeros, max_held_angle
from .initial_state import measured_initial_state, model_initial_state
from .prediction import POLISH_STEP, map_runs
from .residual import errors_by_channel, force_error, simulation_error
from .rest_measurement import (
    InitialState,
    count_resting_rows,
    max_zero_means,
    rigid_basis,
    sensor_zero_error,
    settled_rows,
)
from .result import ModelEvaluation, PredictionErrors
from .sensor_properties import Range, blank_saturated, saturation_ranges, sensor_noise, sensor_quantum

Array = NDArray[np.float64]
_POSITION_CORRECTIONS = 3  # Simulations that refine a position which no laser measures at rest.


class SimulatedRecording(NamedTuple):
    """A machine simulated over a recording, at the n times of that recording.

    Attributes:
        trajectory: Positions, velocities and sensor readings; these include the zeros of the recording's sensors (their
            measurements at position 0), so that they can be compared with the recording.
        error: Measured minus simulated values, in the sensors' units, NaN where nothing or an outlier was measured,
            shape (n, sensors).
        initial: Initial state and zeros of the sensors; its `warnings` list what could not be determined.
    """

    trajectory: Trajectory
    error: Array
    initial: InitialState

    @property
    def outputs(self) -> Array:
        """Simulated measurements, in the sensors' units, shape (n, sensors)."""
        return self.trajectory.outputs


def simulate_recording(machine: Machine, recording: Recording) -> SimulatedRecording:
    """Simulate a machine over a recording and compare it with the measurements.

    The simulation starts from the state that the measurements at rest determine, see `initial_state_of_recording`.
    Samples that the logger dropped are filled in before the simulation. Outliers have no influence and do not count.

    Args:
        machine: Machine, declared or identified.
        recording: The run (times, voltages, measurements); outputs may be missing.

    Returns:
        Trajectory, errors, m or rad, shape (n, sensors), and initial state.

    Raises:
        NotFiniteError: If the motion diverges.
    """
    cleaned = fill_gaps(without_outliers(recording, machine))
    initial = _initial_state(machine, cleaned)
    motion = simulate(
        machine, cleaned.time_s, cleaned.inputs, initial.state, offset=initial.offset, longest_step=POLISH_STEP
    )
    recorded = np.isin(cleaned.time_s, recording.time_s)  # the rows that `fill_gaps` did not insert
    trajectory = dataclasses.replace(
        motion,
        time_s=motion.time_s[recorded],
        positions=motion.positions[recorded],
        velocities=motion.velocities[recorded],
        outputs=motion.outputs[recorded],
    )
    return SimulatedRecording(trajectory, cleaned.outputs[recorded] - trajectory.outputs, initial)


def initial_state_of_recording(machine: Machine, recording: Recording) -> InitialState:
    """Determine the initial state from which a machine is simulated over a recording.

    Measurements beyond a sensor's range do not count, effects on readings are inverted, pulleys are in static
    equilibrium. Encoders whose zero (measurement at position 0) the machine declares measure how the belts are
    stretched, unless the lasers show that the encoder was switched on anew. The sensors' offsets are those of the
    simulation from that state, so that `simulate(..., offset=initial.offset)` minus the recording is the error that
    identification reports.

    Args:
        machine: Machine, declared or identified.
        recording: The run (times, voltages, measurements); outputs may be missing.

    Returns:
        Initial state of the machine (positions, velocities, shape (2 * coordinates,)) and the sensors' offsets, m or
        rad, shape (sensors,); `warnings` lists what could not be determined. If the simulation diverges, the offsets
        are those of the measurements at rest.
    """
    return _initial_state(machine, fill_gaps(without_outliers(recording, machine)))


def _initial_state(machine: Machine, recording: Recording) -> InitialState:
    """Return the initial state of a recording without gaps and outliers."""
    rows = count_resting_rows(recording)
    channels = [[recording.outputs[:, j]] for j in range(len(machine.sensors))]
    quanta = np.array([sensor_quantum(c, s.resolution) for c, s in zip(channels, machine.sensors, strict=True)])
    usable = _without_saturated(machine, recording, rows, quanta)
    zeros = EncoderZeros.of_machine(machine)
    initial = measured_initial_state(usable, machine, zeros, quanta)
    refined = bool(machine.effects) and bool(initial.offset_known.any())
    initial = dataclasses.replace(initial, offsets_refined=refined)
    state = model_initial_state(machine, initial)
    measured = np.isfinite(recording.outputs)

    def readings(state: Array) -> Array:
        return simulate_batch(
            machine, recording.time_s, recording.inputs, start=state, states=False, longest_step=POLISH_STEP
        ).readings

    if not initial.lasers_measured:
        state = _corrected_position(machine, initial, state, usable, readings)
    error = np.where(measured, recording.outputs - readings(state), 0.0)
    if not np.isfinite(error).all():
        return dataclasses.replace(initial, state=state)
    offset = sensor_zero_error(error, measured, rows, max_zero_means(machine, quanta))[0, 0]
    return dataclasses.replace(initial, state=state, offset=offset)


def _without_saturated(machine: Machine, recording: Recording, rows: int, quanta: Array) -> Recording:
    """Return a recording without saturated measurements.

    The machine's effects ``sensor_range`` say where a sensor saturates; others are examined as in identification.
    """
    criteria = SelectionCriteria()
    channels = recording.outputs.T
    noise = np.array(
        [sensor_noise([c], [rows], q, s.noise) for c, q, s in zip(channels, quanta, machine.sensors, strict=True)]
    )
    ends: dict[str, Range] = saturation_ranges([recording], machine, noise, criteria)
    for e in machine.effects:
        if e.name == "sensor_range":
            ends[e.site] = (e.parameters["low"], e.parameters["high"])
    return blank_saturated(recording, ends, machine, noise, criteria)


def _corrected_position(
    machine: Machine,
    initial: InitialState,
    state: Array,
    recording: Recording,
    readings: Callable[[Array], Array],
) -> Array:
    """Return the state moved rigidly until the lasers that measure nothing at rest have no error in the median.

    Where encoders with a known zero determine the position, it moves by no more than the stretch that friction can
    hold in the belts.

    Args:
        machine: Machine to simulate.
        initial: Measured initial state.
        state: State to correct, shape (2 * coordinates,).
        recording: The run without saturated measurements.
        readings: Function that simulates the readings (1, n, sensors) from a state.
    """
    rest = settled_rows(initial.resting_rows)
    fixed = np.array([not s.incremental for s in machine.sensors])
    at_rest = np.isfinite(recording.outputs[rest]).any(axis=0)
    usable = fixed & np.isfinite(recording.outputs).any(axis=0)
    if not usable.any():
        return state
    rigid = rigid_basis(machine)
    limit = np.inf
    if initial.position_measured:
        limit = float(np.max(max_held_angle(machine)[~fixed] * _travel_per_unit(machine)[~fixed], initial=0.0))
    moved = np.zeros(len(machine.sensors))  # by the lasers' readings, m
    corrected = state
    for _ in range(_POSITION_CORRECTIONS):
        error = recording.outputs - readings(corrected)[0]
        if not np.isfinite(error[np.isfinite(recording.outputs)]).all():
            return state
        for j in np.flatnonzero(usable & ~at_rest):
            moved[j] = np.clip(moved[j] + np.nanmedian(error[:, j]), -limit, limit)
        corrected = state.copy()
        shift = np.linalg.lstsq(machine.sensor_matrix[usable] @ rigid, moved[usable], rcond=1e-9)[0]
        corrected[: len(rigid)] += rigid @ shift
    return corrected


def _travel_per_unit(machine: Machine) -> Array:
    """Return the travel of the belts per unit of each sensor's coordinate, m or m/rad, shape (sensors,)."""
    return np.array([machine.coordinate(s.coordinate).travel_per_unit for s in machine.sensors])


def evaluate_held_out(
    machine: Machine, fitted: Dataset, held_out: Dataset, recordings: Sequence[Recording]
) -> ModelEvaluation:
    """Simulate a machine over the held-out runs (not fitted) as ``hframe simulate`` does, and compare with the data.

    The zeros of the encoders (measurements at position 0), which all fitted runs determine together, are written to the
    machine. Everything else about the initial states follows from each recording alone.

    Args:
        machine: Machine to evaluate.
        fitted: Runs that the machine was fitted to (times, voltages, measurements, SI).
        held_out: Runs to evaluate on, as prepared for identification.
        recordings: The recordings of these runs as they were measured; others are ignored.

    Returns:
        The machine with these zeros and its simulation errors, m or rad, shape (n, sensors) for each run. Where its
        motion diverges, only the rows before count.

    Raises:
        KeyError: If the recording of a run is missing.
    """
    machine = with_encoder_zeros(machine, fitted)
    refined = refine_encoder_offsets(held_out, machine, fitted)
    measured = {recording.name: recording for recording in recordings}

    def simulated(run: PreparedRecording) -> tuple[Array, tuple[str, ...]]:
        """Return the errors at the rows of the prepared run (n, sensors), and the warnings about its start."""
        recording = measured[run.name]
        try:
            simulation = simulate_recording(machine, recording)
        except NotFiniteError:
            return simulation_error(machine, run, refined), run.initial.warnings
        error = np.full(run.outputs.shape, np.nan)  # rows that the preparation inserted in gaps stay NaN
        error[np.isin(run.time_s, recording.time_s)] = simulation.error
        return error, simulation.initial.warnings

    results = list(map_runs(simulated, refined))
    errors = {run.name: error for run, (error, _) in zip(refined.runs, results, strict=True)}
    channels = errors_by_channel(list(errors.values()), machine, held_out.noise)
    warnings = tuple(warning for _, lines in results for warning in lines)
    return ModelEvaluation(machine, PredictionErrors(channels, force_error(machine, refined)), errors, warnings)
