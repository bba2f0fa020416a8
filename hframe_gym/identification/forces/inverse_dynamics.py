"""The error of the drives' force: that of the voltages beside the one that the measured motion needs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from scipy import ndimage, signal
from scipy.interpolate import CubicSpline

from ...arrays import Array
from ...dynamics import Equations, net_forces
from ...machine import Machine
from ...preparation.dataset import MIN_ROWS, Dataset, PreparedRecording
from ...recordings import GAP_PERIODS, bridge_blanks

# As in the EMPS benchmark (Janot, Gautier and Brunot 2019).
_FORCE_CUTOFF = 100.0  # Hz
_FORCE_DECIMATION = 10
# Inertial force that the noise of the sensors may cause, of the drives' rms force. The ball-screw axis of the
# EMPS benchmark resolves more than 100 Hz, encoders of some hundred lines a turn 10 to 30 Hz.
_RESOLVED_FORCE = 0.5
_LOWEST_CUTOFF = 2.0  # Hz; what is slower is friction and load, and hardly any motion of a machine
_FILTER_TRANSIENT_S = 0.05
_RESOLVED_SPEED = 3.0  # standard deviations of the noise of the speed
_CREEP = 1e-12  # m/s or rad/s; a velocity that has a direction only


def force_error(machine: Machine, data: Dataset) -> float | None:
    """Return the relative error of the drives' force: rms(F_drive - F_model) / rms(F_drive).

    F_drive follows from the voltages. F_model is the force that the machine needs for the measured motion
    (inverse dynamics), from the least noisy sensor of each coordinate. Positions are interpolated at regular
    times by cubic splines, low-pass filtered at 100 Hz without phase lag and differentiated centrally; forces
    are decimated by ten. The cut-off frequency is lower for a coarse sensor, whose noise would otherwise
    cause an inertial force of more than half of the drives' force. Where the motion is too slow for the
    sensor to resolve, dry friction may have any value within its limits, and the value with the smallest
    error is used.

    Args:
        data: Measured runs. Missing measurements are interpolated between measurements up to 5 ms apart (half
            a period of the filter; more if rows are more than 3 ms apart). Rows near longer gaps are not
            used, nor runs of fewer than 20 rows.

    Returns:
        Error over all rows that are used, dimensionless. None if the machine has belts, if a coordinate lacks
        a drive or a sensor that measures only this coordinate, if an effect other than a delay changes what
        this sensor measures, if no row is used, if F_drive is zero in all of them, or if the sensors resolve
        forces below 2 Hz only.

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
        forces = _compared_forces(
            machine, run, run.outputs[:, sensors] / scales, noise, resolved, sensor_delays
        )
        if forces is not None:
            drive, model = forces
            squared_error += float(np.sum((drive - model) ** 2))
            squared_force += float(np.sum(drive**2))
    return float(np.sqrt(squared_error / squared_force)) if squared_force else None


def _compared_forces(
    machine: Machine,
    run: PreparedRecording,
    measured: Array,
    noise: Array,
    resolved: float,
    sensor_delays: Mapping[str, float],
) -> tuple[Array, Array] | None:
    """Return the forces of drives and model, N or Nm, at every tenth row, (rows, coordinates) each.

    Positions resolve forces up to the frequency `resolved`, Hz. Rows near long gaps and at the ends of the
    run are left out; None if too few remain.
    """
    complete = np.flatnonzero(np.isfinite(measured).all(axis=1))
    if not len(complete) or complete[-1] + 1 - complete[0] < MIN_ROWS:
        return None
    # a run that began in motion lacks the measurements before its rest
    rows = slice(complete[0], complete[-1] + 1)
    run = dataclasses.replace(run, time_s=run.time_s[rows], inputs=run.inputs[rows])
    usual = float(np.median(np.diff(run.time_s)))
    duration = run.time_s[-1] - run.time_s[0]
    time_s = np.linspace(run.time_s[0], run.time_s[-1], 1 + round(duration / usual))
    period = duration / (len(time_s) - 1)
    cutoff = min(0.45 / period, _FORCE_CUTOFF, resolved)  # Hz
    # s; 1 % more than 5 ms, because times are rounded
    longest_gap = max(0.505 / cutoff, GAP_PERIODS * period)
    measured = bridge_blanks(measured[rows], run.time_s, longest_gap)
    nearest = np.searchsorted(0.5 * (run.time_s[1:] + run.time_s[:-1]), time_s)
    known = np.isfinite(measured[nearest]).all(axis=1)
    known &= np.abs(run.time_s[nearest] - time_s) <= 0.5 * longest_gap
    measured = CubicSpline(run.time_s, bridge_blanks(measured, run.time_s, np.inf))(time_s)
    low_pass = signal.butter(4, 2 * cutoff * period, output="sos")
    position = signal.sosfiltfilt(low_pass, measured, axis=0)
    velocity = np.gradient(position, period, axis=0)
    # Standard deviation of a derivative of white noise below the cut-off frequency, m/s or rad/s.
    velocity_noise = 2 * np.pi * np.sqrt(2.0 / 3.0 * period * cutoff**3) * noise
    velocity = np.where(np.abs(velocity) < _RESOLVED_SPEED * velocity_noise, 0.0, velocity)
    trim = int(_FILTER_TRANSIENT_S / period)
    known = ndimage.minimum_filter1d(known, 2 * trim + 1)[trim : len(known) - trim : _FORCE_DECIMATION]
    forces = _inverse_dynamics(machine, run, time_s, position, velocity, sensor_delays)
    if resolved < _FORCE_CUTOFF:  # the forces of the drives have frequencies that the positions now lack
        forces = tuple(signal.sosfiltfilt(low_pass, force, axis=0) for force in forces)
    drive, model = (
        signal.decimate(force[trim : len(force) - trim], _FORCE_DECIMATION, ftype="fir", axis=0)[known]
        for force in forces
    )
    return drive, model


def _resolved_frequency(machine: Machine, data: Dataset, noise: Array) -> float:
    """Return the frequency up to which positions of that noise (coordinates,) resolve the drives' force, Hz.

    The acceleration of white noise below a cut-off frequency f has the variance (2 pi)^4 2 noise^2 period f^5
    / 5.
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
    """Return the index of each coordinate's least noisy sensor, empty if one lacks a sensor without effects.

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
    time_s: Array,
    position: Array,
    velocity: Array,
    sensor_delays: Mapping[str, float],
) -> tuple[Array, Array]:
    """Return the forces of drives and model along a measured motion, N or Nm, (n, coordinates) each.

    The motion is given at n regular times, the voltages in the rows of the run. They are delayed as much as
    each coordinate's sensor, s. All effects, even those on a drive, belong to the force of the model. At zero
    velocity, dry friction has the value within its limits that makes the error smallest.
    """
    drives = zip(Equations(machine).voltage_delays(), machine.drives, strict=True)
    delays = [delay + sensor_delays[drive.coordinate] for delay, drive in drives]
    mean_voltages = [_centered_mean(run, j, time_s - delay) for j, delay in enumerate(delays)]
    voltages = np.column_stack(mean_voltages)
    # The voltages are delayed already.
    prompt = dataclasses.replace(machine, effects=tuple(e for e in machine.effects if not e.definition.delay))
    coordinates = tuple(dataclasses.replace(c, viscous=0.0, coulomb=0.0) for c in machine.coordinates)
    frictionless = dataclasses.replace(machine, coordinates=coordinates, effects=())
    drive = net_forces(frictionless, time_s, position, velocity, voltages)
    mass = np.array([c.mass for c in machine.coordinates])
    inertial = mass * np.gradient(np.gradient(position, time_s, axis=0), time_s, axis=0)
    # Excess force with dry friction at its lower and at its upper limit; both are equal where the machine
    # moves.
    lower, upper = (
        net_forces(prompt, time_s, position, np.where(velocity == 0.0, direction, velocity), voltages)
        - inertial
        for direction in (_CREEP, -_CREEP)
    )
    return drive, drive - np.maximum(lower, 0.0) - np.minimum(upper, 0.0)


def _centered_mean(run: PreparedRecording, j: int, time_s: Array) -> Array:
    """Return the mean of a held input over one period around each of n regular times, shape (n,).

    A central difference of the measured motion shows the force around its sample, half of which the previous
    input still determines.
    """
    period = float(np.median(np.diff(time_s)))
    integral = np.concatenate([[0.0], np.cumsum(run.inputs[:-1, j] * np.diff(run.time_s))])
    edges = np.concatenate([time_s - period / 2, time_s + period / 2])
    before, after = np.interp(edges, run.time_s, integral).reshape(2, -1)
    return (after - before) / period
