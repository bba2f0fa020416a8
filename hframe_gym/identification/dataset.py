"""Recordings prepared for identification, and the typical size of the quantities in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from ..recordings import Recording, fill_gaps
from .free_parameters import typical_force
from .initial_state import encoder_zero_errors, model_initial_state, refine_offsets
from .rest_measurement import InitialState, behind_belts, common_encoder_zeros, estimate_initial_state
from .sensor_properties import sensor_noise, sensor_quantum

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PreparedRecording:
    """One recording of a machine, with its initial state.

    Attributes:
        name: Name of the run.
        time_s: Sample times, s, shape (n,).
        inputs: Drive voltages, V, shape (n, drives).
        outputs: Measurements minus the sensors' zeros, in the sensors' units, shape (n, sensors); NaN where not
            measured.
        initial: Measured initial state.
        rows: Rows that count in the residual, shape (n,). Default: all.
    """

    name: str
    time_s: Array
    inputs: Array
    outputs: Array
    initial: InitialState
    rows: NDArray[np.bool_] | None = None

    @property
    def count(self) -> int:
        """Number of measured values that count."""
        counted = self.outputs if self.rows is None else self.outputs[self.rows]
        return int(np.isfinite(counted).sum())

    def initial_state(self, machine: Machine) -> Array:
        """Return the initial state of a machine in this run.

        Args:
            machine: Machine with its effects.

        Returns:
            Positions and velocities, in the coordinates' units, shape (2 * coordinates,).
        """
        return model_initial_state(machine, self.initial)


@dataclass(frozen=True)
class Dataset:
    """Prepared recordings of one rig.

    Attributes:
        runs: The recordings.
        noise: Standard deviations of the sensors' noise, in their units, shape (sensors,).
        quantum: Quanta of the sensors, in their units, 0 where there is none, shape (sensors,).
        behind_belts: Whether elastic belts lie between a sensor and the tool, shape (sensors,).
    """

    runs: tuple[PreparedRecording, ...]
    noise: Array
    quantum: Array
    behind_belts: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """Number of measured values that count."""
        return sum(run.count for run in self.runs)

    @property
    def period(self) -> float:
        """Median sampling period, s."""
        return float(np.median(np.concatenate([np.diff(run.time_s) for run in self.runs])))

    def with_runs(self, names: Sequence[str]) -> Dataset:
        """Return the data set of some of the runs, with the same noise.

        Args:
            names: Names of the runs to keep.

        Returns:
            Reduced copy.
        """
        return dataclasses.replace(self, runs=tuple(run for run in self.runs if run.name in names))

    def with_rows(self, rows: Sequence[NDArray[np.bool_]]) -> Dataset:
        """Return the same runs, with only some of their rows in the residual.

        Args:
            rows: Rows that count, by run, each of shape (n,).

        Returns:
            Copy with these rows.
        """
        pairs = zip(self.runs, rows, strict=True)
        return dataclasses.replace(self, runs=tuple(dataclasses.replace(run, rows=counted) for run, counted in pairs))


def prepare(recordings: Sequence[Recording], machine: Machine) -> Dataset:
    """Prepare recordings for fitting a machine: fill gaps, estimate initial states, zeros and noise.

    Args:
        recordings: Runs of one rig.
        machine: Machine with the rig's coordinates, belts and sensors.

    Returns:
        Data set with one prepared recording per run.
    """
    recordings = [fill_gaps(recording) for recording in recordings]
    channels = [[recording.outputs[:, j] for recording in recordings] for j in range(len(machine.sensors))]
    quanta = np.array([sensor_quantum(c, s.resolution) for c, s in zip(channels, machine.sensors, strict=True)])
    separate = [estimate_initial_state(recording, machine) for recording in recordings]
    zeros = common_encoder_zeros(separate, machine, quanta)
    initial = [estimate_initial_state(recording, machine, zeros) for recording in recordings]
    rows = [state.resting_rows for state in initial]
    noise = [
        sensor_noise(channel, rows, quantum, sensor.noise)
        for channel, quantum, sensor in zip(channels, quanta, machine.sensors, strict=True)
    ]
    runs = tuple(
        PreparedRecording(r.name, r.time_s, r.inputs, r.outputs - state.offset, state)
        for r, state in zip(recordings, initial, strict=True)
    )
    return Dataset(runs, np.array(noise), quanta, behind_belts(machine))


def with_all_measurements(data: Dataset, recordings: Sequence[Recording]) -> Dataset:
    """Return a data set with all measurements, including the saturated ones that a fit leaves out.

    Args:
        data: Prepared data set.
        recordings: Recordings that it was made from, and possibly others.

    Returns:
        Copy with all outputs.
    """
    outputs = {r.name: fill_gaps(r).outputs for r in recordings}
    runs = (dataclasses.replace(run, outputs=outputs[run.name] - run.initial.offset) for run in data.runs)
    return dataclasses.replace(data, runs=tuple(runs))


def refine_encoder_offsets(data: Dataset, machine: Machine, reference: Dataset | None = None) -> Dataset:
    """Correct the encoders' zeros by a fitted machine, see `encoder_zero_errors`.

    Args:
        data: Data set to correct.
        machine: Fitted machine.
        reference: Data set that the machine was fitted to, from which the errors are estimated. Default: `data`.

    Returns:
        Corrected copy; `data` itself where no encoder kept its zero or the machine has no effects.
    """
    runs = (data if reference is None else reference).runs
    if not machine.effects or not any(np.any(run.initial.offset_known) for run in data.runs):
        return data
    errors = encoder_zero_errors(machine, [run.initial for run in runs])
    corrected = (
        dataclasses.replace(run, initial=refine_offsets(run.initial, machine, errors), outputs=run.outputs - errors)
        for run in data.runs
    )
    return dataclasses.replace(data, runs=tuple(corrected))


@dataclass(frozen=True)
class TypicalScales:
    """Typical sizes of physical quantities on a machine in its recordings, by unit.

    Attributes:
        by_coordinate: Sizes by coordinate and by unit, in the coordinates' units.
        general: Sizes by unit of quantities that belong to no coordinate.
    """

    by_coordinate: Mapping[str, Mapping[str, float]]
    general: Mapping[str, float]

    def of(self, coordinate: str) -> Mapping[str, float]:
        """Return the sizes that apply at a coordinate.

        Args:
            coordinate: Name of the coordinate; an unknown name gives the general sizes.

        Returns:
            Size by unit.
        """
        return {**self.general, **self.by_coordinate.get(coordinate, {})}


def scales_of_motion(machine: Machine, positions: Array, velocities: Array, inputs: Sequence[Array]) -> TypicalScales:
    """Return the typical sizes of the quantities in a motion.

    Args:
        machine: Machine that moved.
        positions: Positions along all runs, in the coordinates' units, shape (n, coordinates).
        velocities: Velocities along all runs, shape (n, coordinates).
        inputs: Drive voltages by run, V, each of shape (n, drives).

    Returns:
        Typical sizes by coordinate and unit.
    """
    force = typical_force(machine)
    top_speed = np.maximum(np.percentile(np.abs(velocities), 99, axis=0), 1e-9)
    travel = np.maximum(np.ptp(positions, axis=0), 1e-9)
    by_coordinate: dict[str, dict[str, float]] = {}
    for i, c in enumerate(machine.coordinates):
        drive = force * c.travel_per_unit
        speed, distance = float(top_speed[i]), float(travel[i])
        by_coordinate[c.name] = {
            "force": drive,
            "speed": speed,
            "position": distance,
            "viscous": drive / speed,
            "drag": drive / speed**2,
            "stiffness": drive / distance,
        }
    voltages = np.concatenate(list(inputs))
    for j, d in enumerate(machine.drives):
        i = machine.coordinate_names.index(d.coordinate)
        current = (voltages[:, j] - d.Ke * d.gear_ratio * velocities[:, i]) / d.resistance
        by_coordinate[d.coordinate]["A"] = max(float(np.abs(current).max()), 1e-9)
    general: dict[str, float] = {}
    if machine.belts:
        extension = positions @ machine.belt_matrix.T  # (n, belts)
        stiffness = np.array([b.EA / b.rest_length for b in machine.belts])
        largest = max(float(np.percentile(np.abs(extension), 99)), 1e-9)
        general = {"m": largest, "N": float(np.abs(extension * stiffness).max()), "1/m^2": 1.0 / largest**2}
    return TypicalScales(by_coordinate, general)
