"""Sizes of forces during recordings: of effects, of the drives, of what a fitted model lacks, and typical ones.

What a model lacks is measured in two ways: `residue_force` by the corrections of an observer, and `force_error` by
comparing the force of the drives with the one that the model needs for the measured motion (inverse dynamics).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from ...arrays import Array
from ...dynamics import Equations, net_forces
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import MIN_ROWS, Dataset, PreparedRecording
from ...recordings import GAP_PERIODS, bridge_blanks
from ..predict.free_parameters import typical_force
from ..predict.prediction import SEARCH_BANDWIDTH, map_runs, observer_gains, predict, prediction_error
from .estimation import Fit
from .model_error import BANDWIDTHS, search_step

# As in the EMPS benchmark (Janot, Gautier and Brunot 2019).
_FORCE_CUTOFF = 100.0  # Hz
_FORCE_DECIMATION = 10
# Inertial force that the noise of the sensors may cause, of the drives' rms force. The ball-screw axis of the EMPS
# benchmark resolves more than 100 Hz, encoders of some hundred lines a turn 10 to 30 Hz.
_RESOLVED_FORCE = 0.5
_LOWEST_CUTOFF = 2.0  # Hz; what is slower is friction and load, and hardly any motion of a machine
_FILTER_TRANSIENT_S = 0.05
_RESOLVED_SPEED = 3.0  # standard deviations of the noise of the speed
_NO_MOTION = 1e-9  # m or rad, m/s or rad/s, V, A; size where nothing moves or acts, which permits a division
SESSION = "session"  # key of the duration of all runs together, s, in `TypicalScales.general`
_CREEP = 1e-12  # m/s or rad/s; a velocity that has a direction only


def effect_force(machine: Machine, effect: AppliedEffect, data: Dataset) -> float:
    """Return the root mean square force that an effect adds to a machine during the recordings.

    Args:
        machine: Machine with or without the effect; the motion is predicted without it.
        data: Runs over which the machine is predicted.

    Returns:
        sqrt(mean over time of the sum of F^2 over the coordinates), N, with the effect's force F at the belt (torque /
        pulley radius); infinite for an effect that adds coordinates or changes a measurement or the clock.
    """
    definition = effect.definition
    if definition.structure or definition.measurement or definition.measurement_delay or definition.clock:
        return np.inf
    without = machine.replace(effects=tuple(e for e in machine.effects if e.label != effect.label))
    return force_difference(without, without.with_effects(effect), data)


def force_difference(first: Machine, second: Machine, data: Dataset) -> float:
    """Return the root mean square difference between the forces of two machines along the same motion.

    If the second machine has one more effect and was refitted, this is the part of the effect's force that other values
    of the first machine's parameters cannot reproduce.

    Args:
        first: Machine whose predicted motion is used.
        second: Machine with the same coordinates.
        data: Runs over which the motion is predicted.

    Returns:
        sqrt(mean over time of the sum of F^2 over the coordinates), N, with the force F of each coordinate at the belt
        (torque / pulley radius).
    """

    def of_run(run: PreparedRecording) -> Array:
        motion = predict(first, run, SEARCH_BANDWIDTH, period=data.period, states=True)
        record = (run.time_s, motion.positions[0], motion.velocities[0], run.inputs)
        change: Array = net_forces(second, *record) - net_forces(first, *record)
        return change.reshape(-1, len(first.coordinates)) / first.travel_per_unit

    return force_size(np.concatenate(list(map_runs(of_run, data))))


def drive_force(machine: Machine, data: Dataset) -> float:
    """Return the root mean square force that the voltages of the recordings cause in the drives, without back-EMF.

    Args:
        data: Runs with the voltages.

    Returns:
        sqrt(mean over time of the sum of F^2 over the drives), N, with the force F of each drive at the belt (torque /
        pulley radius).
    """
    gains = [drive.gain / machine.coordinate(drive.coordinate).travel_per_unit for drive in machine.drives]
    return force_size(np.concatenate([run.inputs for run in data.runs]) * gains)


def force_size(force: Array) -> float:
    """Return the root mean square over time of a force with several components.

    Args:
        force: Forces at n samples, N, shape (n, coordinates).

    Returns:
        sqrt(mean over the samples of the sum of force^2 over the coordinates), N.
    """
    return float(np.sqrt(np.mean(np.sum(force**2, axis=1))))


def residue_force(fitted: Fit, data: Dataset) -> float:
    """Return the root mean square force that a fitted model lacks during the recordings.

    An observer corrects the predicted velocities by the measurements. The lacking force is mass * correction / sampling
    period. The mean square that the sensors' noise causes is subtracted from its mean square.

    Args:
        fitted: Fitted machine with its observer bandwidth. For a fit in simulation (0), an observer of 3 rad/s is used.
        data: Runs that were fitted.

    Returns:
        sqrt(mean over time of the sum of F^2 over the coordinates), N, with the force F of each coordinate at the belt
        (torque / pulley radius).
    """
    # The narrowest observer measures it where none is needed.
    bandwidth = max(fitted.bandwidth, BANDWIDTHS[-2])
    return _observed_force(fitted.machine, data, bandwidth, lambda run: run.noise)


def lacking_force(machine: Machine, data: Dataset) -> float | None:
    """Return the root mean square force that a machine lacks during recordings, relative to the force of the drives.

    It is the force of `residue_force` for the widest observer, which tolerates any error of the machine. Only the noise
    of the sensors at rest is subtracted: jitter of the clock is an estimate from the motion, and an error of the model
    or a sensor that repeats its measurements may be mistaken for it.

    Args:
        data: Runs, for example held-out ones.

    Returns:
        Ratio of root mean squares, dimensionless; infinite if no voltage is applied or the machine diverges; None if no
        sensor shows the direction of a motion, so that no observer can correct a prediction.
    """
    if not machine.shows_direction:
        return None
    force = _observed_force(
        machine, data, SEARCH_BANDWIDTH, lambda run: np.broadcast_to(data.noise, run.noise.shape)
    )
    drives = drive_force(machine, data)
    return force / drives if drives > 0.0 and math.isfinite(force) else math.inf


def _observed_force(
    machine: Machine, data: Dataset, bandwidth: float, noise_of: Callable[[PreparedRecording], Array]
) -> float:
    """Return the rms force by which an observer corrects predictions, N, beyond what noise (n, sensors) causes."""
    velocity_gains = observer_gains(machine, data.period, bandwidth)[len(machine.coordinates) :]
    mass = np.array([c.mass for c in machine.coordinates])
    # Velocity correction per sample -> acceleration -> force at the belt, per unit of each sensor's innovation.
    force_gains = velocity_gains.T / data.period * mass / machine.travel_per_unit  # (sensors, coordinates)

    def of_run(run: PreparedRecording) -> tuple[Array, Array]:
        motion = predict(machine, run, bandwidth, period=data.period, longest_step=search_step(bandwidth))
        innovation = np.nan_to_num(prediction_error(run, data, motion.readings)[0])  # (n, sensors)
        return innovation @ force_gains, np.sqrt(
            (np.isfinite(run.outputs) * noise_of(run) ** 2) @ force_gains**2
        )

    correction, noise = (np.concatenate(part) for part in zip(*map_runs(of_run, data), strict=True))
    square = force_size(correction) ** 2 - force_size(noise) ** 2
    return math.sqrt(max(square, 0.0)) if math.isfinite(square) else math.inf


def force_error(machine: Machine, data: Dataset) -> float | None:
    """Return the relative error of the drives' force: rms(F_drive - F_model) / rms(F_drive).

    F_drive follows from the voltages. F_model is the force that the machine needs for the motion that the least noisy
    sensor of each coordinate measured (inverse dynamics). Positions are low-pass filtered at 100 Hz without phase lag
    and differentiated centrally; forces are decimated by ten. If the noise of the sensors would cause an inertial force
    of more than half of that of the drives, positions and forces are filtered at the highest frequency at which it
    does not: what a coarse sensor does not resolve says nothing about the machine. Where the motion is too slow for the
    sensor to resolve, dry friction may have any value within its limits, and the one that makes the error smallest is
    used.

    Args:
        data: Measured runs. Missing measurements are interpolated between measurements up to 5 ms apart (half a period
            of the filter; more if rows are more than 3 ms apart). Rows near longer gaps are not used, nor runs of fewer
            than 20 rows.

    Returns:
        Error over all rows that are used, dimensionless. None if the machine has belts, if a coordinate lacks a drive
        or a sensor that measures only this coordinate, if an effect other than a delay changes what this sensor
        measures, if no row is used, if F_drive is zero in all of them, or if the sensors resolve forces below 2 Hz
        only.

    References:
        Janot, Gautier and Brunot (2019), the EMPS benchmark.
    """
    sensors = _least_noisy_sensors(machine, data)
    if (
        machine.belts
        or {d.coordinate for d in machine.drives} != set(machine.coordinate_names)
        or not sensors
    ):
        return None
    # Measurement / position.
    scales = np.array([next(iter(machine.sensors[j].row.values())) for j in sensors])
    noise = data.noise[sensors] / np.abs(scales)
    delays = Equations(machine).measurement_delays()
    sensor_delays = {name: delays[j] for name, j in zip(machine.coordinate_names, sensors, strict=True)}
    resolved = _resolved_frequency(machine, data, noise)
    if resolved < _LOWEST_CUTOFF:
        return None
    squared_error, squared_force = 0.0, 0.0  # sums over runs, drives and samples
    for run in data.runs:
        measured = run.outputs[:, sensors] / scales
        complete = np.flatnonzero(np.isfinite(measured).all(axis=1))
        if not len(complete) or complete[-1] + 1 - complete[0] < MIN_ROWS:
            continue
        # a run that began in motion lacks the measurements before its rest
        rows = slice(complete[0], complete[-1] + 1)
        run = dataclasses.replace(run, time_s=run.time_s[rows], inputs=run.inputs[rows])
        period = float(np.median(np.diff(run.time_s)))
        cutoff = min(0.45 / period, _FORCE_CUTOFF, resolved)  # Hz
        # s; 1 % more than 5 ms, because times are rounded
        longest_gap = max(0.505 / cutoff, GAP_PERIODS * period)
        measured = bridge_blanks(measured[rows], run.time_s, longest_gap)
        known = np.asarray(np.isfinite(measured).all(axis=1))
        measured = bridge_blanks(measured, run.time_s, np.inf)
        position = signal.sosfiltfilt(signal.butter(4, 2 * cutoff * period, output="sos"), measured, axis=0)
        velocity = np.gradient(position, run.time_s, axis=0)
        # Standard deviation of a derivative of white noise below the cut-off frequency, m/s or rad/s.
        velocity_noise = 2 * np.pi * np.sqrt(2.0 / 3.0 * period * cutoff**3) * noise
        velocity = np.where(np.abs(velocity) < _RESOLVED_SPEED * velocity_noise, 0.0, velocity)
        trim = int(_FILTER_TRANSIENT_S / period)
        known = ndimage.minimum_filter1d(known, 2 * trim + 1)[trim : len(known) - trim : _FORCE_DECIMATION]
        forces = _inverse_dynamics(machine, run, position, velocity, sensor_delays)
        if resolved < _FORCE_CUTOFF:  # the forces of the drives have frequencies that the positions now lack
            low_pass = signal.butter(4, 2 * cutoff * period, output="sos")
            forces = tuple(signal.sosfiltfilt(low_pass, force, axis=0) for force in forces)
        drive, model = (
            signal.decimate(force[trim : len(force) - trim], _FORCE_DECIMATION, ftype="fir", axis=0)
            for force in forces
        )
        squared_error += float(np.sum((drive - model)[known] ** 2))
        squared_force += float(np.sum(drive[known] ** 2))
    return float(np.sqrt(squared_error / squared_force)) if squared_force else None


def _resolved_frequency(machine: Machine, data: Dataset, noise: Array) -> float:
    """Return the frequency up to which measured positions with that noise (coordinates,) resolve the drives' force, Hz.

    The acceleration of white noise below a cut-off frequency f has the variance (2 pi)^4 2 noise^2 period f^5 / 5.
    """
    mass = np.array([c.mass for c in machine.coordinates])
    drives = {d.coordinate: d.gain for d in machine.drives}
    voltages = np.sqrt(np.mean(np.concatenate([run.inputs for run in data.runs]) ** 2, axis=0))
    force = {d.coordinate: drives[d.coordinate] * v for d, v in zip(machine.drives, voltages, strict=True)}
    largest = _RESOLVED_FORCE * np.array([force[name] for name in machine.coordinate_names]) / mass
    unit = (2 * np.pi) ** 4 * 2.0 * noise**2 * data.period / 5.0
    with np.errstate(divide="ignore"):
        frequency = np.where(largest > 0.0, (largest**2 / unit) ** 0.2, np.inf)
    return float(np.min(frequency))


def _least_noisy_sensors(machine: Machine, data: Dataset) -> list[int]:
    """Return the index of the least noisy sensor of each coordinate, empty if one lacks a sensor without effects.

    Only sensors count that measure at least half as often as the most frequent one. Delays are permitted.
    """
    counts = sum((np.isfinite(run.outputs).sum(axis=0) for run in data.runs), np.zeros(len(machine.sensors)))
    changed = {e.site for e in machine.effects if e.definition.measurement}
    sensors = []
    for name in machine.coordinate_names:
        direct = [j for j, s in enumerate(machine.sensors) if s.of_position and list(s.row) == [name]]
        frequent = [j for j in direct if 2 * counts[j] >= max(counts[direct])]
        best = min(frequent, key=lambda j: data.noise[j] / abs(machine.sensors[j].row[name]), default=None)
        if best is None or machine.sensors[best].channel in changed:
            return []
        sensors.append(best)
    return sensors


def _inverse_dynamics(
    machine: Machine,
    run: PreparedRecording,
    position: Array,
    velocity: Array,
    sensor_delays: Mapping[str, float],
) -> tuple[Array, Array]:
    """Return the forces of the drives and of the model along a measured motion, N or Nm, (n, coordinates) each.

    The measured motion is late by the delay of each coordinate's sensor, s; the voltages are delayed as much. The force
    of the drives is that of the machine without effects. All effects, even those on a drive, belong to the force of the
    model. At zero velocity, dry friction has the value within its limits that makes the error smallest.
    """
    drives = zip(Equations(machine).voltage_delays(), machine.drives, strict=True)
    delays = [delay + sensor_delays[drive.coordinate] for delay, drive in drives]
    mean_voltages = [_centered_mean(run.time_s, run.inputs[:, j], delay) for j, delay in enumerate(delays)]
    voltages = np.column_stack(mean_voltages)
    # The voltages are delayed already.
    prompt = dataclasses.replace(machine, effects=tuple(e for e in machine.effects if not e.definition.delay))
    coordinates = tuple(dataclasses.replace(c, viscous=0.0, coulomb=0.0) for c in machine.coordinates)
    frictionless = dataclasses.replace(machine, coordinates=coordinates, effects=(), ties={})
    drive = net_forces(frictionless, run.time_s, position, velocity, voltages)
    mass = np.array([c.mass for c in machine.coordinates])
    inertial = mass * np.gradient(np.gradient(position, run.time_s, axis=0), run.time_s, axis=0)
    # Excess force with dry friction at its lower and at its upper limit; both are equal where the machine moves.
    lower, upper = (
        net_forces(prompt, run.time_s, position, np.where(velocity == 0.0, direction, velocity), voltages)
        - inertial
        for direction in (_CREEP, -_CREEP)
    )
    return drive, drive - np.maximum(lower, 0.0) - np.minimum(upper, 0.0)


def _centered_mean(time_s: Array, values: Array, delay: float) -> Array:
    """Return the mean of a delayed, held input over one period around each sample, shape (n,).

    A central difference of the measured motion shows the force around its sample, half of which the previous input
    still determines.
    """
    period = float(np.median(np.diff(time_s)))
    integral = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time_s))])
    edges = np.concatenate([time_s - delay - period / 2, time_s - delay + period / 2])
    before, after = np.interp(edges, time_s, integral).reshape(2, -1)
    return (after - before) / period


@dataclass(frozen=True)
class TypicalScales:
    """Typical sizes of physical quantities on a machine during its recordings.

    The keys are the units that effect parameters declare; `scales_of_motion` documents how the sizes are computed.

    Attributes:
        by_coordinate: Sizes by coordinate and by key, in N, m/s and m or in Nm, rad/s and rad: "mass", "force",
            "speed", "position", "viscous", "drag", "stiffness"; with a drive, also "voltage" (V), "A" (its current,
            A), "1/A^2", "1/W".
        general: Sizes of the belts, by key: "m" (extension, m), "N" (force, N), "1/m^2" (1 / extension^2).
    """

    by_coordinate: Mapping[str, Mapping[str, float]]
    general: Mapping[str, float]

    def of(self, coordinate: str) -> Mapping[str, float]:
        """Return the typical sizes at a coordinate together with the sizes that belong to no coordinate.

        Args:
            coordinate: Name of the coordinate; any other text, such as "", gives the general sizes only.

        Returns:
            Typical size, SI, by key: "mass", "force", "speed", "position", "viscous" (force / speed), "drag" (force /
            speed^2), "stiffness" (force / position), "voltage", "A" (current). Belts: "m" (extension), "N" (force),
            "1/m^2".
        """
        return {**self.general, **self.by_coordinate.get(coordinate, {})}


def scales_of_motion(
    machine: Machine, positions: Array, velocities: Array, inputs: Sequence[Array]
) -> TypicalScales:
    """Compute typical sizes of forces, speeds, positions, voltages, currents and belt extensions from a motion.

    Starting values of effect parameters are multiples of these sizes. The sizes of motions, voltages and currents are
    at least 1e-9, even for an axis that never moves. Effects on such an axis get meaningless starting values, but as
    they change no prediction, the screening drops them.

    Args:
        positions: Positions over all rows of all runs, m or rad, shape (n, coordinates).
        velocities: Velocities over the same rows, m/s or rad/s, shape (n, coordinates).
        inputs: Drive voltages by run, V, shape (rows of the run, drives) each; n rows in total.

    Returns:
        by_coordinate: By coordinate, sizes by key, in N, m/s and m (linear) or in Nm, rad/s and rad (rotary):

            - "mass": the machine's mass or moment of inertia.
            - "force": a tenth of the force of all drives together at standstill and rated voltage.
            - "speed": 99th percentile of its magnitude. "position": largest minus smallest position.
            - "viscous": force / speed. "drag": force / speed^2. "stiffness": force / position.
            - With a drive, "voltage": largest magnitude of its voltage, V.
            - With a drive, "A": largest magnitude of its current, A, which is (voltage - back-EMF) / resistance.
              "1/A^2": 1 / this size squared; "1/W": 1 / (current * voltage).
        general: Empty without belts; with belts, sizes by key:

            - "m": 99th percentile of the magnitude of the belts' extensions, m. "1/m^2": 1 / this size squared.
            - "N": largest magnitude of a belt's force, N, which is extension * EA / rest length.
    """
    force = typical_force(machine)
    top_speed = np.maximum(np.percentile(np.abs(velocities), 99, axis=0), _NO_MOTION)
    span = np.maximum(np.ptp(positions, axis=0), _NO_MOTION)
    by_coordinate: dict[str, dict[str, float]] = {}
    for i, c in enumerate(machine.coordinates):
        drive = force * c.travel_per_unit  # N, or Nm: force at the belt times the pulley radius
        speed, distance = float(top_speed[i]), float(span[i])
        by_coordinate[c.name] = {"mass": c.mass, "force": drive, "speed": speed, "position": distance}
        by_coordinate[c.name] |= {
            "viscous": drive / speed,
            "drag": drive / speed**2,
            "stiffness": drive / distance,
        }
    for d, voltage in zip(machine.drives, np.concatenate(list(inputs)).T, strict=True):
        i = machine.coordinate_names.index(d.coordinate)
        # Ohm's law with the back-EMF of the motor, which turns gear_ratio times as fast as the coordinate.
        current = (voltage - d.Ke * d.gear_ratio * velocities[:, i]) / d.resistance
        sizes = by_coordinate[d.coordinate]
        for key, values in (("A", current), ("voltage", voltage)):
            sizes[key] = max(float(np.abs(values).max()), sizes.get(key, _NO_MOTION))
        sizes["1/A^2"] = 1.0 / sizes["A"] ** 2
        sizes["1/W"] = 1.0 / (sizes["A"] * sizes["voltage"])
    general: dict[str, float] = {}
    if machine.belts:
        extension = positions @ machine.belt_matrix.T  # (n, belts)
        stiffness = np.array([b.EA / b.rest_length for b in machine.belts])
        largest = max(float(np.percentile(np.abs(extension), 99)), _NO_MOTION)
        general = {"m": largest, "N": float(np.abs(extension * stiffness).max()), "1/m^2": 1.0 / largest**2}
    return TypicalScales(by_coordinate, general)


def typical_scales(current: Fit, data: Dataset) -> TypicalScales:
    """Compute typical forces, speeds and travels of a machine, by which starting values of effects are multiplied.

    Args:
        current: Fit of the machine, which predicts the motion.

    Returns:
        Sizes by coordinate, such as "force" (N, Nm), and of belts, such as "m" (m); `scales_of_motion` lists all.
    """
    motions = list(
        map_runs(
            lambda run: predict(current.machine, run, current.bandwidth, period=data.period, states=True),
            data,
        )
    )
    positions = np.concatenate([motion.positions[0] for motion in motions])
    velocities = np.concatenate([motion.velocities[0] for motion in motions])
    scales = scales_of_motion(current.machine, positions, velocities, [run.inputs for run in data.runs])
    # Of all fitted runs on the clock of the rig, which they share.
    session = max(float(run.time_s[-1]) for run in data.runs) - min(float(run.time_s[0]) for run in data.runs)
    return dataclasses.replace(scales, general={**scales.general, SESSION: session})
