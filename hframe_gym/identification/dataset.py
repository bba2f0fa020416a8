"""Recordings prepared for identification, and the typical size of the quantities in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from ..recordings import Recording, fill_gaps
from .encoder_zeros import EncoderZeros, common_encoder_zeros
from .free_parameters import typical_force
from .initial_state import correct_encoder_zeros, encoder_zero_errors, measured_initial_state, model_initial_state
from .rest_measurement import InitialState, behind_belts, estimate_initial_state
from .sensor_properties import clock_jitter, independent_values, noise_by_row, sensor_noise, sensor_quantum

Array = NDArray[np.float64]
MIN_ROWS = 20  # rows of a run that the filters of the residual need


@dataclass(frozen=True)
class PreparedRecording:
    """One recording of a machine, with its initial state.

    Attributes:
        name: Name of the run.
        time_s: Sample times, s, shape (n,).
        inputs: Drive voltages, V, shape (n, drives).
        outputs: Measurements minus zeros (readings at position 0), m or rad, shape (n, sensors), NaN where missing.
        initial: Measured initial state.
        noise: Standard deviation of each measurement, m or rad, shape (n, sensors): the sensor's noise and
            the jitter of the clock times the speed.
        weights: Number of independent values that each measurement counts as, at most 1, shape (n, sensors), see
            `independent_values`; 0 where not measured.
        dropped: True for rows that the logger dropped; their voltages are interpolated or estimated, shape (n,).
    """

    name: str
    time_s: Array
    inputs: Array
    outputs: Array
    initial: InitialState
    noise: Array
    weights: Array
    dropped: NDArray[np.bool_]

    @property
    def count(self) -> float:
        """Effective number of measured values in the fit, dimensionless; N repeats of a rounded value count as one."""
        return float(self.weights.sum())

    def initial_state(self, machine: Machine) -> Array:
        """Return the state from which a machine is simulated over this run.

        It follows from the measurements at rest and from the machine, because effects may change what sensors measure,
        and forces at rest stretch the belts.

        Args:
            machine: Machine with its effects (deviations from the nominal model), which may add coordinates.

        Returns:
            Positions (m, rad), velocities (m/s, rad/s; zero at rest) and states of the effects (SI; zero unless
            estimated), shape (2 * coordinates + effect states,).
        """
        return dataclasses.replace(self.initial, state=model_initial_state(machine, self.initial)).start(machine)


@dataclass(frozen=True)
class Dataset:
    """Prepared recordings of one rig.

    Attributes:
        runs: The recordings.
        noise: Standard deviations of the sensors' noise, m or rad, shape (sensors,).
        quantum: Quantization steps of the sensors, m or rad, 0 where there is none, shape (sensors,).
        behind_belts: True for encoders on pulleys, which elastic belts separate from the tool, shape (sensors,).
        zeros: Zeros (measurements at position 0) of the encoders that kept them in all runs. None: unknown.
    """

    runs: tuple[PreparedRecording, ...]
    noise: Array
    quantum: Array
    behind_belts: NDArray[np.bool_]
    zeros: EncoderZeros | None = None

    @property
    def count(self) -> float:
        """Effective number of measured values of all runs in the fit, dimensionless (sum of the runs' `count`)."""
        return sum(run.count for run in self.runs)

    @cached_property
    def period(self) -> float:
        """Median sampling period over all runs, s."""
        return float(np.median(np.concatenate([np.diff(run.time_s) for run in self.runs])))

    def with_runs(self, names: Sequence[str]) -> Dataset:
        """Return a copy with some of the runs; the sensors' noise and quantization steps are not estimated again.

        Args:
            names: Names of the runs to keep; names of other runs are ignored.

        Returns:
            Copy with these runs (measurements of shape (n, sensors) each), in the order of this data set.
        """
        return dataclasses.replace(self, runs=tuple(run for run in self.runs if run.name in names))


def prepare(recordings: Sequence[Recording], machine: Machine) -> Dataset:
    """Prepare recordings for a fit: fill gaps, and estimate initial states and properties of the sensors.

    Args:
        recordings: Runs of one rig (times, s; voltages, V; measurements, m or rad), at least one.
        machine: Machine with the rig's coordinates, belts and sensors.

    Returns:
        Data set with one prepared recording per run: its initial state, and its measurements minus the sensors' zeros
        (measurements at position 0), m or rad, shape (n, sensors). For all runs: noise and quantization step of each
        sensor, m or rad, shape (sensors,), and the zeros of those encoders that kept them in all runs.
    """
    recorded, recordings = recordings, [fill_gaps(recording) for recording in recordings]
    channels = [[recording.outputs[:, j] for recording in recordings] for j in range(len(machine.sensors))]
    quanta = np.array([sensor_quantum(c, s.resolution) for c, s in zip(channels, machine.sensors, strict=True)])
    # The zeros that each run alone gives show which encoders kept theirs; those then improve the initial states.
    separate = [estimate_initial_state(recording, machine) for recording in recordings]
    zeros = common_encoder_zeros(separate, machine, quanta)
    initial = [measured_initial_state(r, machine, zeros, quanta, s) for r, s in zip(recordings, separate, strict=True)]
    rows = [state.resting_rows for state in initial]
    noise = [
        sensor_noise(channel, rows, quantum, sensor.noise)
        for channel, quantum, sensor in zip(channels, quanta, machine.sensors, strict=True)
    ]
    jitter = _common_jitter(recordings, machine, noise)
    runs = tuple(
        PreparedRecording(
            r.name,
            r.time_s,
            r.inputs,
            r.outputs - state.offset,
            state,
            noise_by_row(r.time_s, r.outputs, np.array(noise), jitter),
            independent_values(r.time_s, r.outputs, quanta),
            np.isin(r.time_s, before.time_s, invert=True),
        )
        for before, r, state in zip(recorded, recordings, initial, strict=True)
    )
    return Dataset(runs, np.array(noise), quanta, behind_belts(machine), zeros)


def with_known_positions(data: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """Copy a data set without the runs that cannot be simulated, because no sensor determines the initial position.

    Args:
        data: Data set of prepared runs (times, voltages, measurements, SI).

    Returns:
        data: Copy without these runs (measurements of shape (n, sensors) each). If no run would remain, all are kept.
        warnings: One sentence that names the runs that were left out; empty if none was.
    """
    located = [run.name for run in data.runs if run.initial.position_known]
    if not located or len(located) == len(data.runs):
        return data, ()
    lost = ", ".join(run.name for run in data.runs if run.name not in located)
    return data.with_runs(located), (f"Not used, because no sensor with a known zero measures the start: {lost}.",)


def _common_jitter(recordings: Sequence[Recording], machine: Machine, noise: Sequence[float]) -> float:
    """Return the jitter of the clock, s: the smallest estimate of all encoders, or of all sensors without encoders.

    Encoders resolve the jitter best. The smallest estimate is used, because vibration of a single channel looks alike.
    """
    encoders = [j for j, sensor in enumerate(machine.sensors) if sensor.incremental]
    measured = np.isfinite(np.concatenate([r.outputs for r in recordings])).any(axis=0)
    return min(
        (
            clock_jitter([r.time_s for r in recordings], [r.outputs[:, j] for r in recordings], noise[j])
            for j in encoders or range(len(machine.sensors))
            if measured[j]
        ),
        default=0.0,
    )


def with_all_measurements(data: Dataset, recordings: Sequence[Recording]) -> Dataset:
    """Copy a data set, with the saturated measurements (at the ends of a sensor's range) that a fit leaves out.

    Args:
        data: Data set prepared from recordings whose saturated measurements were replaced by NaN.
        recordings: The same recordings with these measurements; recordings of other runs are ignored.

    Returns:
        Copy with all measurements minus the estimated zeros of the sensors, m or rad, shape (n, sensors).

    Raises:
        KeyError: If the recording of a run is missing.
    """
    outputs = {r.name: fill_gaps(r).outputs for r in recordings}
    runs = (
        dataclasses.replace(
            run,
            outputs=outputs[run.name] - run.initial.offset,
            weights=independent_values(run.time_s, outputs[run.name], data.quantum),
        )
        for run in data.runs
    )
    return dataclasses.replace(data, runs=tuple(runs))


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
    if not machine.effects or not any(np.any(run.initial.offset_known) for run in data.runs):
        return data
    errors = encoder_zero_errors(machine, [run.initial for run in runs])
    initial = [correct_encoder_zeros(run.initial, machine, errors) for run in data.runs]
    corrected = (
        dataclasses.replace(run, initial=state, outputs=run.outputs - errors)
        for run, state in zip(data.runs, initial, strict=True)
    )
    zeros = data.zeros and data.zeros._replace(offset=data.zeros.offset + errors)
    return dataclasses.replace(data, runs=tuple(corrected), zeros=zeros)


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


@dataclass(frozen=True)
class TypicalScales:
    """Typical sizes of physical quantities on a machine during its recordings.

    The keys are the units that effect parameters declare; `scales_of_motion` documents how the sizes are computed.

    Attributes:
        by_coordinate: Sizes by coordinate and by key, in N, m/s and m or in Nm, rad/s and rad: "force", "speed",
            "position", "viscous", "drag", "stiffness"; with a drive, also "voltage" (V) and "A" (its current, A).
        general: Sizes that belong to no coordinate, by key: of belts, extension "m" (m), force "N" (N), "1/m^2".
    """

    by_coordinate: Mapping[str, Mapping[str, float]]
    general: Mapping[str, float]

    def of(self, coordinate: str) -> Mapping[str, float]:
        """Return the typical sizes at a coordinate together with the sizes that belong to no coordinate.

        Args:
            coordinate: Name of the coordinate; any other text, such as "", gives the general sizes only.

        Returns:
            Typical size, SI, by key: "force", "speed", "position", "viscous" (force / speed), "drag" (force / speed^2),
            "stiffness" (force / position), "voltage", "A" (current); of belts "m" (extension), "N" (force), "1/m^2".
        """
        return {**self.general, **self.by_coordinate.get(coordinate, {})}


def scales_of_motion(machine: Machine, positions: Array, velocities: Array, inputs: Sequence[Array]) -> TypicalScales:
    """Compute typical sizes of forces, speeds, positions, voltages, currents and belt extensions from a motion.

    Starting values of effect parameters are multiples of these sizes.

    Args:
        machine: Machine that moved.
        positions: Positions over all rows of all runs, m or rad, shape (n, coordinates).
        velocities: Velocities over the same rows, m/s or rad/s, shape (n, coordinates).
        inputs: Drive voltages by run, V, shape (rows of the run, drives) each; n rows in total.

    Returns:
        by_coordinate: By coordinate, sizes by key, in N, m/s and m (linear) or in Nm, rad/s and rad (rotary):

            - "force": a tenth of the force of all drives together at standstill and rated voltage.
            - "speed": 99th percentile of its magnitude. "position": largest minus smallest position.
            - "viscous": force / speed. "drag": force / speed^2. "stiffness": force / position.
            - With a drive, "voltage": largest magnitude of its voltage, V.
            - With a drive, "A": largest magnitude of its current, A, which is (voltage - back-EMF) / resistance.
        general: Empty without belts; with belts, sizes by key:

            - "m": 99th percentile of the magnitude of the belts' extensions, m. "1/m^2": 1 / this size squared.
            - "N": largest magnitude of a belt's force, N, which is extension * EA / rest length.
    """
    force = typical_force(machine)
    top_speed = np.maximum(np.percentile(np.abs(velocities), 99, axis=0), 1e-9)
    span = np.maximum(np.ptp(positions, axis=0), 1e-9)
    by_coordinate: dict[str, dict[str, float]] = {}
    for i, c in enumerate(machine.coordinates):
        drive = force * c.travel_per_unit  # N, or Nm: force at the belt times the pulley radius
        speed, distance = float(top_speed[i]), float(span[i])
        by_coordinate[c.name] = {"force": drive, "speed": speed, "position": distance}
        by_coordinate[c.name] |= {"viscous": drive / speed, "drag": drive / speed**2, "stiffness": drive / distance}
    for d, voltage in zip(machine.drives, np.concatenate(list(inputs)).T, strict=True):
        i = machine.coordinate_names.index(d.coordinate)
        # Ohm's law with the back-EMF of the motor, which turns gear_ratio times as fast as the coordinate.
        current = (voltage - d.Ke * d.gear_ratio * velocities[:, i]) / d.resistance
        sizes = by_coordinate[d.coordinate]
        for key, values in (("A", current), ("voltage", voltage)):
            sizes[key] = max(float(np.abs(values).max()), sizes.get(key, 1e-9))
    general: dict[str, float] = {}
    if machine.belts:
        extension = positions @ machine.belt_matrix.T  # (n, belts)
        stiffness = np.array([b.EA / b.rest_length for b in machine.belts])
        largest = max(float(np.percentile(np.abs(extension), 99)), 1e-9)
        general = {"m": largest, "N": float(np.abs(extension * stiffness).max()), "1/m^2": 1.0 / largest**2}
    return TypicalScales(by_coordinate, general)
