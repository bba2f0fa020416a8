"""The variables on which a missing force may depend: positions, velocities, currents, loads, heat, time."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import signal

from ...arrays import Array
from ...dynamics.motion_forces import law_torques
from ...machine import Drive, Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..predict.prediction import SEARCH_BANDWIDTH, predict
from .missing_force import low_pass

_HEAT_S = 2.0  # time constant of a winding's heat; small motors have 1 to 30 s, recordings last a few seconds
_CONTACT_M = 0.3e-3  # travel after which the contacts of two surfaces are renewed; 0.01 to 1 mm
_SLOW = 0.03  # fraction of the rms speed below which the direction of a measured velocity is uncertain


def dependence_variables(machine: Machine, run: PreparedRecording, data: Dataset) -> dict[str, Array]:
    """Return the variables of a run on which the force of a missing effect may depend.

    Args:
        machine: Machine that predicts positions and velocities, corrected by an observer at every sample.
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period.

    Returns:
        By name, shape (n,) each, as `variables_of_motion`.
    """
    motion = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, states=True)
    return variables_of_motion(machine, run, data, motion.positions[0], motion.velocities[0])


def variables_of_motion(
    machine: Machine, run: PreparedRecording, data: Dataset, positions: Array, velocities: Array
) -> dict[str, Array]:
    """Return the variables of a run on which a missing force may depend, for given positions and velocities.

    Args:
        machine: Machine, whose parameters give currents and loads.
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period.
        positions: Positions, m or rad, shape (n, coordinates).
        velocities: Velocities, m/s or rad/s, shape (n, coordinates).

    Returns:
        By name, shape (n,) each.

        - Of each coordinate C, with u for m or rad: "position of C" (u), "velocity of C" (u/s), "acceleration
          of C" (u/s^2) below 30 Hz, "path of C" (u), the distance traveled since the start of the run, and
          "dwell of C" (s), the age of its contacts.
        - Of each drive D: "current of D" (A), (voltage - back-EMF) / resistance, without the inductance, or,
          of a drive that does not command a current or voltage, "torque of D" (Nm), that of the motor shaft
          (`motor_variable`); "heat of D" (A^2 or (Nm)^2), the mean of its square over the last seconds; "load
          of D" (N or Nm), the drive's force minus what accelerates its coordinate and overcomes its friction;
          "impulse of D" (Ns or Nms), the integral of the load.
        - Sums over the drives: "current of drives" (A) and "torque of drives" (Nm), of those drives that have
          one; "power of drives" (W), electrical where the voltage is the command, otherwise mechanical; "load
          of drives" (N or Nm), and "tension rate of belts" (N/s or Nm/s), the derivative of that load below
          30 Hz.
        - Each input channel, in its unit; "time", that of the recording's clock, and "time in the run" (s).
    """
    names, period = machine.coordinate_names, data.period
    accelerations = np.gradient(low_pass(velocities, period), run.time_s, axis=0)
    variables: dict[str, Array] = {}
    for i, name in enumerate(names):
        speed = np.abs(velocities[:, i])
        variables[f"position of {name}"] = positions[:, i]
        variables[f"velocity of {name}"] = velocities[:, i]
        variables[f"acceleration of {name}"] = accelerations[:, i]
        variables[f"path of {name}"] = np.cumsum(speed) * period
        variables[f"dwell of {name}"] = _contact_age(speed * machine.travel_per_unit[i], period)
    power, rate, loads = np.zeros((3, len(run.time_s)))
    torques = law_torques(machine, run.time_s, positions, velocities, run.inputs)
    kept = np.exp(-period / _HEAT_S)  # fraction of the heat after one row
    for j, drive in enumerate(machine.drives):
        i = names.index(drive.coordinate)
        coordinate = machine.coordinates[i]
        if drive.law:
            motor = torques[:, j]
            force = drive.gear_ratio * motor
        else:
            motor = (run.inputs[:, j] - drive.emf_constant * velocities[:, i]) / drive.resistance
            force = drive.gain * drive.resistance * motor
        load = force - coordinate.mass * accelerations[:, i] - coordinate.viscous * velocities[:, i]
        load -= coordinate.coulomb * smooth_sign(velocities[:, i])
        variables[machine.input_channels[j]] = run.inputs[:, j]
        of_motor = motor_variable(drive)
        variables[f"{of_motor} of {drive.name}"] = motor
        variables[f"heat of {drive.name}"] = signal.lfilter([1.0 - kept], [1.0, -kept], motor**2)
        variables[f"load of {drive.name}"] = load
        variables[f"impulse of {drive.name}"] = np.cumsum(load) * period
        loads += load
        power += run.inputs[:, j] * motor if drive.command == "voltage" else force * velocities[:, i]
        variables[f"{of_motor} of drives"] = motor + variables.get(f"{of_motor} of drives", 0.0)
        rate += np.gradient(low_pass(load[:, None], period)[:, 0], run.time_s)
    variables |= {"power of drives": power, "load of drives": loads, "tension rate of belts": rate}
    return variables | {"time": run.time_s, "time in the run": run.time_s - run.time_s[0]}


def motor_variable(drive: Drive) -> Literal["current", "torque"]:
    """Return which variable of a drive's motor is known.

    It is "current" if the drive's command is a voltage or a current, else "torque".
    """
    return "current" if drive.command in ("voltage", "current") else "torque"


def smooth_sign(velocity: Array) -> Array:
    """Return the direction of a `velocity`, m/s or rad/s, as numbers from -1 to 1, shape (n,).

    It is near -1 or 1, and between them below a few percent of the root mean square velocity. All values are
    0 if nothing moves.
    """
    slow = _SLOW * float(np.sqrt(np.mean(velocity**2)))
    return velocity / (np.abs(velocity) + slow) if slow > 0.0 else np.zeros_like(velocity)


def _contact_age(speed: Array, period: float) -> Array:
    """Return the age of a coordinate's contacts, s, shape (n,).

    It grows with time at rest, and travel by the distance D = `_CONTACT_M` renews the contacts:
    d age / dt = 1 - speed age / D. It is 0 before the first row.

    Args:
        speed: Magnitude of the velocity, m/s, shape (n,).
        period: Sampling period, s.
    """
    age, ages = 0.0, np.empty(len(speed))
    for row, kept in enumerate(np.exp(-speed * period / _CONTACT_M)):
        ages[row] = age = (age + period) * kept
    return ages
