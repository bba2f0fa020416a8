"""Simulation errors of a machine on the held-out runs, as every command computes them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...arrays import Array
from ...dynamics import NotFiniteError
from ...machine import Machine
from ...machine.motion import rigid_motions
from ...preparation.dataset import Dataset, PreparedRecording
from ...preparation.session_zeros import refine_encoder_zeros
from ...recordings import Recording
from ..fit.channel_errors import ChannelError, errors_by_channel
from ..forces.force_sizes import lacking_force
from ..forces.inverse_dynamics import force_error
from ..judge.sensor import SensorEvidence, deviates_alone
from ..predict.prediction import map_runs
from .recording_simulation import simulate_recording


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of a machine on runs: of the simulated measurements, and of the drives' force.

    Attributes:
        channels: Simulation error by output channel.
        force: rms error of the drives' force by inverse dynamics / rms force; None for example with belts.
        lacking: rms missing force, by an observer / rms force of the drives; None if unknown.
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


@dataclass(frozen=True)
class ModelEvaluation:
    """A machine and its errors.

    Attributes:
        machine: The machine.
        held_out: Errors on the held-out runs.
        errors: Simulation errors by name of the held-out run, in the sensors' units, NaN if not measured,
            shape (n, sensors).
        warnings: Pairs of the name of a run and a sentence about what is unknown about its initial state.
        diverged: Names of the held-out runs on which the simulation diverges; then `held_out` has no channel
            errors.
    """

    machine: Machine
    held_out: PredictionErrors
    errors: Mapping[str, Array] = field(default_factory=dict)
    warnings: tuple[tuple[str, str], ...] = ()
    diverged: tuple[str, ...] = ()

    @property
    def deviating_sensors(self) -> tuple[str, ...]:
        """Channels whose sensor, or its mounting, is in error, because others contradict it (`judge.sensor`).

        Belts stretch little, so if a carriage moved otherwise than simulated, the encoders of the pulleys
        would deviate as well. If only the sensor of the carriage deviates, the cause is that sensor, its
        mounting, or the part of the machine between it and the pulleys.
        """
        errors = self.held_out.channels
        rows = dict(zip(self.machine.output_channels, self.machine.sensor_matrix, strict=True))
        rmse = {channel: error.rmse for channel, error in errors.items() if error.rmse is not None}

        def ratios(channel: str, motion: Array) -> list[float]:
            """Return the errors of other sensors / those that they would have after such a motion error."""
            amount = rmse[channel] / abs(float(rows[channel] @ motion))
            others = [other for other in rmse if other != channel and rows[other] @ motion]
            return [rmse[other] / (amount * abs(float(rows[other] @ motion))) for other in others]

        def deviates(channel: str) -> bool:
            motions = [motion for motion in rigid_motions(self.machine).values() if rows[channel] @ motion]
            of_others = [ratios(channel, motion) for motion in motions]
            evidence = SensorEvidence(errors[channel].noise_ratio or 0.0, of_others)
            return deviates_alone(evidence)

        return tuple(filter(deviates, rmse))


def error_ratio(evaluation: ModelEvaluation, reference: ModelEvaluation) -> float:
    """Return the simulation error of a machine / that of another machine on the same runs.

    Args:
        evaluation: Machine to compare.
        reference: Machine to compare with.

    Returns:
        Geometric mean of the ratio over the measured channels. 0 if only the reference diverges, or nothing
        is measured; infinite if only the machine diverges; 1 if both do.
    """
    if evaluation.diverged or reference.diverged:
        return 1.0 if evaluation.diverged and reference.diverged else math.inf if evaluation.diverged else 0.0
    ratios = []
    for channel, error in evaluation.held_out.channels.items():
        other = reference.held_out.channels[channel]
        if error.rmse and other.rmse:
            ratios.append(math.log(error.rmse / other.rmse))
    return math.exp(sum(ratios) / len(ratios)) if ratios else 0.0


def evaluate_held_out(machine: Machine, refined: Dataset, recordings: Sequence[Recording]) -> ModelEvaluation:
    """Evaluate a machine on held-out runs (not fitted): simulate it as ``hframe simulate`` does, and compare.

    Everything about the initial states but the zeros of the encoders follows from each recording alone.

    Args:
        machine: Machine with the zeros of its encoders, see `with_encoder_zeros`.
        refined: Runs to evaluate on, as prepared for identification and refined for this machine
            (`refine_dataset`).
        recordings: The recordings of these runs as they were measured; others are ignored.

    Returns:
        The machine, its errors by channel, and its simulation errors (measured minus simulated), in the
        sensors' units, shape (n, sensors) for each run. If the motion of a run diverges, `diverged` names it,
        its errors are NaN, and no error is given for any channel.

    Raises:
        KeyError: If the recording of a run is missing.
    """
    measured = {recording.name: recording for recording in recordings}

    def simulated(run: PreparedRecording) -> tuple[Array, tuple[str, ...], bool]:
        """Return errors at a run's rows (n, sensors), warnings about its start, and whether it diverges."""
        recording = measured[run.name]
        try:
            simulation = simulate_recording(machine, recording, updates=run.updates)
        except NotFiniteError:
            return np.full(run.outputs.shape, np.nan), run.initial.warnings, True
        error = np.full(run.outputs.shape, np.nan)  # rows that the preparation inserted in gaps stay NaN
        error[~run.dropped] = simulation.error
        return error, simulation.initial.warnings, False

    results = list(map_runs(simulated, refined))
    errors = {run.name: error for run, (error, *_) in zip(refined.runs, results, strict=True)}
    diverged = tuple(run.name for run, (*_, infinite) in zip(refined.runs, results, strict=True) if infinite)
    channels = errors_by_channel(
        list(errors.values()), machine, refined.noise, [run.outputs for run in refined.runs]
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
    """Return a copy of a machine with the encoder zeros (readings at position 0) estimated from all runs.

    A simulation of a single run with this copy starts from the same state as in the fit to all runs.

    Args:
        machine: Machine that was fitted to the runs; its effects refine the zeros.

    Returns:
        Copy; sensors whose zero the runs do not determine have none. `machine` itself if no zero is
        determined.
    """
    zeros = refine_encoder_zeros(data, machine).zeros
    return machine if zeros is None else zeros.in_machine(machine)
