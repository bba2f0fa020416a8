"""Compare the force of the drives with the force that the model needs for the measured motion (inverse dynamics)."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ..dynamics import Equations, net_forces
from ..machine import Machine
from .dataset import Dataset, PreparedRecording

Array = NDArray[np.float64]

# As in the EMPS benchmark (Janot, Gautier and Brunot 2019).
_FORCE_CUTOFF = 100.0  # Hz
_FORCE_DECIMATION = 10
_FILTER_TRANSIENT_S = 0.05
_RESOLVED_SPEED = 3.0  # standard deviations of the noise of the speed
_CREEP = 1e-12  # m/s or rad/s; a velocity that has a direction only


def force_error(machine: Machine, data: Dataset) -> float | None:
    """Return the relative error of the drives' force: rms(F_drive - F_model) / rms(F_drive).

    F_drive follows from the voltages. F_model is the force that the machine needs for the measured motion (inverse
    dynamics). Positions are low-pass filtered at 100 Hz without phase lag and differentiated centrally; forces are
    decimated by ten. Where the motion is too slow for the sensor to resolve, dry friction may have any value within its
    limits, and the one that makes the error smallest is used.

    Args:
        machine: Machine to evaluate.
        data: Measured runs (times, voltages, measurements, SI); those with measurements missing after their rest are
            left out.

    Returns:
        Error over all runs, dimensionless. None if the machine has belts, if a coordinate lacks a drive or a sensor
        that measures only this coordinate, or if no run has complete measurements from its rest on.

    References:
        Janot, Gautier and Brunot (2019), the EMPS benchmark.
    """
    direct = {s.coordinate: j for j, s in enumerate(machine.sensors) if len(s.row) == 1}
    driven = {d.coordinate for d in machine.drives}
    if machine.belts or driven != set(machine.coordinate_names) or not driven <= set(direct):
        return None
    noise = data.noise[[direct[name] for name in machine.coordinate_names]]
    squared_error, squared_force = 0.0, 0.0  # sums over runs, drives and samples
    for run in data.runs:
        measured = run.outputs[:, [direct[name] for name in machine.coordinate_names]]
        complete = np.asarray(np.isfinite(measured).all(axis=1))
        first = int(np.argmax(complete))  # a run that began in motion lacks the measurements before its rest
        if not complete[first:].all():
            continue
        measured = measured[first:]
        run = dataclasses.replace(run, time_s=run.time_s[first:], inputs=run.inputs[first:])
        period = float(np.median(np.diff(run.time_s)))
        cutoff = min(0.45 / period, _FORCE_CUTOFF)  # Hz
        position = signal.sosfiltfilt(signal.butter(4, 2 * cutoff * period, output="sos"), measured, axis=0)
        velocity = np.gradient(position, run.time_s, axis=0)
        # Standard deviation of a derivative of white noise below the cut-off frequency, m/s or rad/s.
        velocity_noise = 2 * np.pi * np.sqrt(2.0 / 3.0 * period * cutoff**3) * noise
        velocity = np.where(np.abs(velocity) < _RESOLVED_SPEED * velocity_noise, 0.0, velocity)
        trim = int(_FILTER_TRANSIENT_S / period)
        drive, model = (
            signal.decimate(force[trim:-trim], _FORCE_DECIMATION, ftype="fir", axis=0)
            for force in _inverse_dynamics(machine, run, position, velocity)
        )
        squared_error += float(np.sum((drive - model) ** 2))
        squared_force += float(np.sum(drive**2))
    return float(np.sqrt(squared_error / squared_force)) if squared_force else None


def _inverse_dynamics(
    machine: Machine, run: PreparedRecording, position: Array, velocity: Array
) -> tuple[Array, Array]:
    """Return the forces of the drives and of the model along a measured motion, N or Nm, (n, coordinates) each.

    The force of the drives is that of the machine without effects. All effects, even those on a drive, belong to the
    force of the model. At zero velocity, dry friction has the value within its limits that makes the error smallest.
    """
    delays = Equations(machine).voltage_delays()
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
        net_forces(prompt, run.time_s, position, np.where(velocity == 0.0, direction, velocity), voltages) - inertial
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
