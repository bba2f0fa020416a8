"""Simulate a machine over a recording, from the initial state that every command uses.

Identification evaluates its machines on held-out runs with `simulate_recording`, and ``hframe simulate``
calls the same function with the machine that identification wrote, so both have the same errors.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...dynamics import resolved_step, simulate, simulate_batch
from ...machine import Machine, Trajectory
from ...preparation.inputs.clock_voltages import clock_voltages, with_clock_voltages
from ...preparation.inputs.interpolated_voltages import update_times, updated_inputs
from ...preparation.sensors.saturation import without_saturated
from ...preparation.session import prepare
from ...preparation.start.encoder_zeros import EncoderZeros
from ...preparation.start.measured_state import InitialState
from ...preparation.start.modeled_state import measured_initial_state, model_initial_states
from ...preparation.start.rest import rest_and_noise
from ...preparation.start.sensor_zeros import (
    free_zeros,
    has_zero,
    max_reported_zero_means,
    max_zero_means,
    sensor_zero_error,
)
from ...preparation.usable import from_first_measurement, usable_run, without_unknown_voltage
from ...recordings import Recording, fill_gaps
from ..fit.lost_voltages import estimate_lost_voltages
from ..fit.start_estimation import most_probable_start
from ..predict.prediction import POLISH_STEP


class SimulatedRecording(NamedTuple):
    """A machine simulated over a recording, at the n times of that recording.

    Attributes:
        trajectory: Positions, velocities and simulated measurements. The latter include the zeros of the
            sensors (their measurements at position 0), so that they can be compared with the recording.
        error: Measured minus simulated values, in the sensors' units, shape (n, sensors); NaN where nothing
            or an outlier was measured, in repetitions of slow sensors, and before the machine came to rest.
        initial: Initial state and zeros of the sensors; its `warnings` list what could not be determined.
    """

    trajectory: Trajectory
    error: Array
    initial: InitialState

    @property
    def outputs(self) -> Array:
        """Simulated measurements, in the sensors' units, shape (n, sensors)."""
        return self.trajectory.outputs


def simulate_recording(machine: Machine, recording: Recording, *, updates: int = 1) -> SimulatedRecording:
    """Simulate a machine over a recording and compare it with the measurements.

    The simulation starts from the most probable state, which is estimated from the measurements at rest and
    the motion, and uses no feedback of the measurements. Rows that the logger dropped are filled in before
    the simulation; the measurements determine their voltages.

    Three kinds of measurements count as not measured: outliers (up to five consecutive samples of a sensor
    that leave its motion and return to it), repetitions of a sensor that is slower than the log, and
    measurements before the machine comes to rest, if it still moves when the run begins.

    Args:
        machine: Machine, declared or identified.
        recording: The run; outputs may be missing.
        updates: How many times the controller changes the voltages from one row to the next; more than once,
            they are interpolated between the rows.

    Returns:
        Trajectory at the n times of the recording, errors (measured minus simulated), in the sensors' units,
        shape (n, sensors), NaN where not measured, and initial state. A run that does not begin at rest is
        simulated from its first measurement on; the rows before are NaN.

    Raises:
        NotFiniteError: If the motion diverges.
    """
    begun = from_first_measurement(recording, machine)
    cleaned, recorded = _cleaned(begun, machine, updates)
    initial = _initial_state(machine, cleaned, updates)
    motion = simulate(
        machine,
        *_updated(machine, cleaned, updates),
        initial.start(machine),
        offset=initial.zeros,
        longest_step=resolved_step(machine, POLISH_STEP),
    )
    rows = np.flatnonzero(recorded) * updates
    before = len(recording.time_s) - len(begun.time_s)

    def of_recording(values: Array) -> Array:
        """Return values at the simulated rows, NaN before them."""
        return np.pad(values, ((before, 0), (0, 0)), constant_values=np.nan)

    trajectory = dataclasses.replace(
        motion,
        time_s=recording.time_s,
        positions=of_recording(motion.positions[rows]),
        velocities=of_recording(motion.velocities[rows]),
        outputs=of_recording(motion.outputs[rows]),
    )
    error = of_recording(cleaned.outputs[recorded]) - trajectory.outputs
    return SimulatedRecording(trajectory, error, initial)


def _cleaned(recording: Recording, machine: Machine, updates: int) -> tuple[Recording, NDArray[np.bool_]]:
    """Return a recording without outliers, gaps, and measurements before rest, and its logged rows.

    The measurements also determine the voltages in the gaps, except saturated measurements.
    """
    usable = without_unknown_voltage(usable_run(recording, machine).usable, machine)
    filled = fill_gaps(usable)
    logged = np.isin(filled.time_s, usable.time_s)  # `fill_gaps` keeps recorded times exactly
    if filled is usable or not np.isfinite(usable.outputs).any():
        return filled, logged
    data = prepare([_unsaturated(usable, filled, machine)], machine)
    (run,) = estimate_lost_voltages(data.with_updates(updates), machine).runs
    return dataclasses.replace(filled, inputs=run.inputs), logged


def _unsaturated(usable: Recording, filled: Recording, machine: Machine) -> Recording:
    """Return a recording without saturated measurements, by its noise once its gaps are filled."""
    _, _, noise = rest_and_noise(filled, machine)
    ((unsaturated,), _) = without_saturated([usable], machine, noise)
    return unsaturated


def _updated(machine: Machine, recording: Recording, updates: int) -> tuple[Array, Array]:
    """Return the times at which the controller changes the voltages, s, and the voltages from then on, V."""
    if updates == 1:
        return recording.time_s, recording.inputs
    of_position = [sensor.of_position for sensor in machine.sensors]
    clock = clock_voltages(recording.time_s, recording.inputs, recording.outputs[:, of_position])
    inputs = with_clock_voltages(recording.inputs, clock, recording.time_s, updates)
    return update_times(recording.time_s, updates), updated_inputs(recording.time_s, inputs, updates)


def _initial_state(machine: Machine, recording: Recording, updates: int) -> InitialState:
    """Return the initial state of a recording without gaps and outliers."""
    rows, quanta, noise = rest_and_noise(recording, machine)
    ((usable,), _) = without_saturated([recording], machine, noise)
    initial = measured_initial_state(usable, machine, EncoderZeros.of_machine(machine), quanta)
    refined = bool(machine.effects) and bool(initial.resolves_stretch.any())
    initial = dataclasses.replace(initial, zeros_refined=refined)
    state = model_initial_states(machine, [initial])[0][: 2 * len(machine.coordinates)]
    max_means = max_zero_means(free_zeros(machine), quanta)
    measured = np.isfinite(usable.outputs)
    zeroed = has_zero(machine)
    updated, step_s = _updated(machine, recording, updates), resolved_step(machine, POLISH_STEP)

    def errors(states: Array, outputs: Array) -> Array:
        """Return measured minus simulated in the first k rows, 0 if not measured, shape (B, k, sensors)."""
        time_s, inputs = (values[: (len(outputs) - 1) * updates + 1] for values in updated)
        motion = simulate_batch(
            machine, time_s, inputs, start=states, longest_step=step_s, every=updates, states=False
        )
        return np.where(np.isfinite(outputs), outputs - motion.readings, 0.0)

    def weighted_errors(states: Array, count: int) -> Array:
        """Return errors without those of the zeros, in units of the noise, shape (B, count * sensors)."""
        error, valid = errors(states, usable.outputs[:count]), measured[:count]
        error = np.where(
            valid, error - sensor_zero_error(error, valid * zeroed, rows, max_means, quanta), 0.0
        )
        return np.asarray((error / np.where(noise > 0.0, noise, np.inf)).reshape(len(states), -1))

    start = most_probable_start(machine, initial, state, weighted_errors, recording.time_s)
    initial = initial.with_start(machine, start)
    error = errors(start, recording.outputs)
    if not np.isfinite(error).all():
        return initial
    limits = max_reported_zero_means(machine, initial, quanta)
    valid = np.isfinite(recording.outputs) * has_zero(machine)
    zeros = sensor_zero_error(error, valid, rows, limits, quanta)[0, 0]
    return dataclasses.replace(initial, zeros=zeros)
