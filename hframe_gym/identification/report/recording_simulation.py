"""Simulate a machine over a recording, from the initial state that every command uses.

Identification evaluates its machines on held-out runs with `simulate_recording`, and ``hframe simulate`` calls the same
function with the machine that identification wrote, so both have the same errors.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...dynamics import NotFiniteError, simulate, simulate_batch
from ...machine import Machine, Trajectory
from ...machine.motion import rigid_motions
from ...preparation.dataset import Dataset, PreparedRecording, prepare, without_unknown_voltage
from ...preparation.encoder_zeros import EncoderZeros
from ...preparation.initial_state import measured_initial_state, model_initial_states
from ...preparation.refined_zeros import refine_encoder_zeros
from ...preparation.rest_measurement import (
    InitialState,
    free_zeros,
    has_zero,
    max_reported_zero_means,
    max_zero_means,
    sensor_zero_error,
)
from ...preparation.usable import rest_and_noise, usable_run, without_saturated
from ...recordings import Recording, fill_gaps
from ..fit.force_sizes import force_error, lacking_force
from ..fit.lost_voltages import estimate_lost_voltages
from ..fit.residual import ChannelError, errors_by_channel
from ..fit.start_estimation import most_probable_start, refine_dataset
from ..judge.criteria import SelectionCriteria
from ..predict.prediction import POLISH_STEP, map_runs

Array = NDArray[np.float64]

# A sensor deviates alone if its error is clear, and the others have less than a fifth of what the motion would cause.
_CLEAR_ERROR, _AGREEING = 3.0, 0.2  # multiple of the noise; fraction


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of a machine on runs: of the simulated measurements, and of the drives' force.

    Attributes:
        channels: Simulation error by output channel.
        force: rms error of the drives' force by inverse dynamics / rms force; None for example with belts.
        lacking: rms force that the machine lacks, by an observer, / rms force of the drives; None if it is not known.
    """

    channels: dict[str, ChannelError]
    force: float | None
    lacking: float | None = None

    @property
    def noise_ratio(self) -> float:
        """Ratio of simulation error to sensor noise, rms over the measured channels; NaN if there is none."""
        ratios = [error.noise_ratio for error in self.channels.values() if error.noise_ratio is not None]
        return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else float("nan")

    @property
    def motion_ratio(self) -> float:
        """Ratio of simulation error to motion, rms over the channels that move; NaN if there is none."""
        ratios = [error.motion_ratio for error in self.channels.values() if error.motion_ratio is not None]
        return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else float("nan")

    def as_json(self) -> dict[str, Any]:
        """Convert the errors to the format of report.json.

        Returns:
            By channel name, a dictionary with "rmse" (simulation error, in the channel's unit), "noise_ratio" (rmse
            / standard deviation of the noise) and, if it moves, "percent_of_motion" (100 rmse / rms motion). In
            addition "force_error", the relative error of the drives' force, dimensionless, if there is one.
        """
        content: dict[str, Any] = {
            channel: {"rmse": error.rmse, "noise_ratio": error.noise_ratio}
            | ({} if error.motion_ratio is None else {"percent_of_motion": 100.0 * error.motion_ratio})
            for channel, error in self.channels.items()
        }
        return content if self.force is None else content | {"force_error": self.force}


@dataclass(frozen=True)
class ModelEvaluation:
    """A machine and its errors.

    Attributes:
        machine: The machine.
        held_out: Errors on the held-out runs.
        errors: Simulation errors by name of the held-out run, m or rad, NaN if not measured, shape (n, sensors).
        warnings: Pairs of the name of a run and a sentence about what is unknown about its initial state.
        diverged: Names of the held-out runs on which the simulation diverges; then `held_out` has no channel errors.
    """

    machine: Machine
    held_out: PredictionErrors
    errors: Mapping[str, Array] = field(default_factory=dict)
    warnings: tuple[tuple[str, str], ...] = ()
    diverged: tuple[str, ...] = ()

    @property
    def deviating_sensors(self) -> tuple[str, ...]:
        """Channels whose error is above 3 times their noise although other sensors of the same motion agree.

        Belts stretch little, so if a carriage moved otherwise than simulated, the encoders of the pulleys would deviate
        as well. If only the sensor of the carriage deviates, the cause is that sensor, its mounting, or the part of the
        machine between it and the pulleys.
        """
        errors = self.held_out.channels
        rows = dict(zip(self.machine.output_channels, self.machine.sensor_matrix, strict=True))
        rmse = {channel: error.rmse for channel, error in errors.items() if error.rmse is not None}

        def is_refuted(channel: str, motion: Array) -> bool:
            """Return whether other sensors exclude that the error of a sensor is one of this motion."""
            amount = rmse[channel] / abs(float(rows[channel] @ motion))
            expected = {
                other: amount * abs(float(rows[other] @ motion)) for other in rmse if other != channel
            }
            seen = [rmse[other] < _AGREEING * change for other, change in expected.items() if change > 0.0]
            return bool(seen) and all(seen)

        def deviates(channel: str) -> bool:
            motions = [motion for motion in rigid_motions(self.machine).values() if rows[channel] @ motion]
            clear = (errors[channel].noise_ratio or 0.0) > _CLEAR_ERROR
            return clear and bool(motions) and all(is_refuted(channel, motion) for motion in motions)

        return tuple(filter(deviates, rmse))


def error_ratio(evaluation: ModelEvaluation, reference: ModelEvaluation) -> float:
    """Return the simulation error of a machine over that of another one on the same runs.

    Args:
        evaluation: Machine to compare.
        reference: Machine to compare with.

    Returns:
        Geometric mean of the ratio over the measured channels. 0 if only the reference diverges, or nothing is
        measured; infinite if only the machine diverges; 1 if both do.
    """
    if evaluation.diverged or reference.diverged:
        return 1.0 if evaluation.diverged and reference.diverged else math.inf if evaluation.diverged else 0.0
    ratios = []
    for channel, error in evaluation.held_out.channels.items():
        other = reference.held_out.channels[channel]
        if error.rmse and other.rmse:
            ratios.append(math.log(error.rmse / other.rmse))
    return math.exp(sum(ratios) / len(ratios)) if ratios else 0.0


class SimulatedRecording(NamedTuple):
    """A machine simulated over a recording, at the n times of that recording.

    Attributes:
        trajectory: Positions, velocities and simulated measurements. The latter include the zeros of the sensors (their
            measurements at position 0), so that they can be compared with the recording.
        error: Measured minus simulated values, m or rad, shape (n, sensors); NaN where nothing or an
            outlier was measured, in repetitions of slow sensors, and before the machine came to rest.
        initial: Initial state and zeros of the sensors; its `warnings` list what could not be determined.
    """

    trajectory: Trajectory
    error: Array
    initial: InitialState

    @property
    def outputs(self) -> Array:
        """Simulated measurements, m or rad, shape (n, sensors)."""
        return self.trajectory.outputs


def simulate_recording(
    machine: Machine, recording: Recording, criteria: SelectionCriteria | None = None
) -> SimulatedRecording:
    """Simulate a machine over a recording and compare it with the measurements.

    The simulation starts from the most probable state, which is estimated from the measurements at rest and the motion,
    and uses no feedback of the measurements. Rows that the logger dropped are filled in before the simulation; the
    measurements determine their voltages.

    Three kinds of measurements count as not measured: outliers (up to five consecutive samples of a sensor that leave
    its motion and return to it), repetitions of a sensor that is slower than the log, and measurements before the
    machine comes to rest, if it still moves when the run begins.

    Args:
        machine: Machine, declared or identified.
        recording: The run (times, voltages, measurements); outputs may be missing.
        criteria: Thresholds by which a sensor at the end of its range is recognized. Default: `SelectionCriteria()`.

    Returns:
        Trajectory at the n times of the recording, errors (measured minus simulated), m or rad, shape (n, sensors), NaN
        where not measured, and initial state.

    Raises:
        NotFiniteError: If the motion diverges.
    """
    criteria = criteria or SelectionCriteria()
    cleaned = _cleaned(recording, machine, criteria)
    initial = _initial_state(machine, cleaned, criteria)
    motion = simulate(
        machine,
        cleaned.time_s,
        cleaned.inputs,
        initial.start(machine),
        offset=initial.zeros,
        longest_step=POLISH_STEP,
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


def initial_state_of_recording(
    machine: Machine, recording: Recording, criteria: SelectionCriteria | None = None
) -> InitialState:
    """Determine the initial state from which a machine is simulated over a recording.

    The measurements at rest give a first estimate: saturated ones are ignored, scale and skew of a sensor are
    corrected, and pulleys are in static equilibrium. An encoder measures the stretch of the belts if the machine
    declares its zero (measurement at position 0). The zero is not used if it contradicts the lasers (sensors with a
    fixed zero): the encoder was then switched on anew and counts from another zero. What remains uncertain (belt
    stretch, states of hysteresis and bristles) is estimated from the motion, see
    `start_estimation.most_probable_start`.

    Args:
        machine: Machine, declared or identified.
        recording: The run (times, voltages, measurements); outputs may be missing.
        criteria: Thresholds by which a sensor at the end of its range is recognized. Default: `SelectionCriteria()`.

    Returns:
        Initial state for `simulate(..., initial.start(machine), offset=initial.zeros)`, the simulation whose errors
        identification reports. Its `state` holds positions and velocities, shape (2 * coordinates,), its `zeros` the
        zeros of the sensors, m or rad, shape (sensors,): those at rest, corrected by the mean error of the run as far
        as rounding and the stretch of the belts at the start explain it. If the simulation diverges, the zeros follow
        from the measurements at rest. `warnings` lists what could not be determined.
    """
    criteria = criteria or SelectionCriteria()
    return _initial_state(machine, _cleaned(recording, machine, criteria), criteria)


def _cleaned(recording: Recording, machine: Machine, criteria: SelectionCriteria) -> Recording:
    """Return a recording without outliers, gaps, and measurements before the machine came to rest.

    The measurements also determine the voltages in the gaps, except saturated measurements.
    """
    usable = without_unknown_voltage(usable_run(recording, machine).usable, machine)
    filled = fill_gaps(usable)
    if filled is usable or not np.isfinite(usable.outputs).any():
        return filled
    _, _, noise = rest_and_noise(filled, machine)
    data = prepare(without_saturated([usable], machine, noise, criteria)[0], machine)
    (run,) = estimate_lost_voltages(data, machine).runs
    return dataclasses.replace(filled, inputs=run.inputs)


def _initial_state(machine: Machine, recording: Recording, criteria: SelectionCriteria) -> InitialState:
    """Return the initial state of a recording without gaps and outliers."""
    rows, quanta, noise = rest_and_noise(recording, machine)
    ((usable,), _) = without_saturated([recording], machine, noise, criteria)
    initial = measured_initial_state(usable, machine, EncoderZeros.of_machine(machine), quanta)
    refined = bool(machine.effects) and bool(initial.resolves_stretch.any())
    initial = dataclasses.replace(initial, zeros_refined=refined)
    state = model_initial_states(machine, [initial])[0][: 2 * len(machine.coordinates)]
    max_means = max_zero_means(free_zeros(machine), quanta)
    measured = np.isfinite(usable.outputs)
    zeroed = has_zero(machine)

    def errors(states: Array, outputs: Array) -> Array:
        """Return measured minus simulated values in the first k rows, 0 if not measured, shape (B, k, sensors)."""
        time_s, inputs = recording.time_s[: len(outputs)], recording.inputs[: len(outputs)]
        motion = simulate_batch(machine, time_s, inputs, start=states, states=False, longest_step=POLISH_STEP)
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


def evaluate_held_out(
    machine: Machine,
    fitted: Dataset,
    held_out: Dataset,
    recordings: Sequence[Recording],
    criteria: SelectionCriteria | None = None,
) -> ModelEvaluation:
    """Evaluate a machine on the held-out runs (not fitted): simulate it as ``hframe simulate`` does, and compare.

    The zeros of the encoders (measurements at position 0), estimated from all fitted runs together, are written to the
    machine. Everything else about the initial states follows from each recording alone.

    Args:
        machine: Machine to evaluate.
        fitted: Runs that the machine was fitted to (times, voltages, measurements, SI).
        held_out: Runs to evaluate on, as prepared for identification.
        recordings: The recordings of these runs as they were measured; others are ignored.
        criteria: Thresholds of the identification. Default: `SelectionCriteria()`.

    Returns:
        The machine with these zeros, its errors by channel, and its simulation errors (measured minus simulated), m or
        rad, shape (n, sensors) for each run. If the motion of a run diverges, `diverged` names it, its errors are NaN,
        and no error is given for any channel.

    Raises:
        KeyError: If the recording of a run is missing.
    """
    machine = with_encoder_zeros(machine, fitted)
    refined = refine_dataset(held_out, machine, fitted)
    measured = {recording.name: recording for recording in recordings}

    def simulated(run: PreparedRecording) -> tuple[Array, tuple[str, ...], bool]:
        """Return the errors at the rows of a run (n, sensors), warnings about its start, and whether it diverges."""
        recording = measured[run.name]
        try:
            simulation = simulate_recording(machine, recording, criteria)
        except NotFiniteError:
            return np.full(run.outputs.shape, np.nan), run.initial.warnings, True
        error = np.full(run.outputs.shape, np.nan)  # rows that the preparation inserted in gaps stay NaN
        error[np.isin(run.time_s, recording.time_s)] = simulation.error
        return error, simulation.initial.warnings, False

    results = list(map_runs(simulated, refined))
    errors = {run.name: error for run, (error, *_) in zip(refined.runs, results, strict=True)}
    diverged = tuple(run.name for run, (*_, infinite) in zip(refined.runs, results, strict=True) if infinite)
    channels = errors_by_channel(
        list(errors.values()), machine, held_out.noise, [run.outputs for run in refined.runs]
    )
    if diverged:  # an error over the other runs would be compared with those of other machines over all runs
        channels = dict.fromkeys(channels, ChannelError(None, None))
    warnings = tuple(
        (run.name, w) for run, (_, texts, _) in zip(refined.runs, results, strict=True) for w in texts
    )
    return ModelEvaluation(
        machine,
        PredictionErrors(channels, force_error(machine, refined), lacking_force(machine, refined)),
        errors,
        warnings,
        diverged,
    )


def with_encoder_zeros(machine: Machine, data: Dataset) -> Machine:
    """Return a copy of a machine whose encoders have the zeros (measurements at position 0) that all runs determine.

    A simulation of a single run with this copy starts from the same state as in the fit to all runs.

    Args:
        machine: Machine that was fitted to the runs; its effects (deviations from the nominal model) refine the zeros.
        data: Data set with the runs (times, voltages, measurements, SI).

    Returns:
        Copy; sensors whose zero the runs do not determine have none. `machine` itself if no zero is determined.
    """
    zeros = refine_encoder_zeros(data, machine).zeros
    return machine if zeros is None else zeros.in_machine(machine)
