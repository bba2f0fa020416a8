"""Motion along which a machine is unstable, such as that of a pendulum swung above the horizontal.

A simulation has no controller. Where a force drives the machine away from its path, an error as small as the
noise grows exponentially, so that the simulation of an exact machine errs as well, by an amount of chance.
Predictions that an observer corrects do not drift away.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...machine.motion import rigid_motions
from ...preparation.dataset import Dataset, PreparedRecording
from ..predict.prediction import POLISH_STEP, SIMULATION, map_runs, predict

_MOMENTS = 16  # An instability that lasts a sixteenth of a run is found; each moment costs half a simulation.


def enlargement(machine: Machine, data: Dataset, bandwidth: float) -> float:
    """Return the factor by which simulations enlarge position errors of the size of the noise.

    The error may arise at any moment of a run, because an error that shrinks at first may grow later. From
    several moments, the machine is simulated to the end of the run, from the state that an observer gives and
    from one that is displaced by one standard deviation of the noise. Without a force that depends on the
    position, the displacement remains as it is; a spring, friction or a weight below its axis reduces it.

    Args:
        machine: Machine that is simulated.
        data: Runs to simulate.
        bandwidth: Bandwidth of the observer, rad/s.

    Returns:
        Error of the measured positions over the complete run / noise, rms, of the moment and motion
        (`rigid_motions`) with the largest one; rms over the runs, dimensionless. Infinite if a simulation
        diverges, 0 if no sensor measures a position.
    """
    of_position = np.array([sensor.of_position for sensor in machine.sensors], dtype=bool)
    if not of_position.any():
        return 0.0
    noise = data.noise[of_position]
    displacements = _displacements(machine, machine.sensor_matrix[of_position] / noise[:, None])

    def of_run(run: PreparedRecording) -> float:
        observed = predict(machine, run, bandwidth, period=data.period, longest_step=POLISH_STEP, states=True)
        states = np.hstack([observed.positions[0], observed.velocities[0]])
        rows, largest = len(run.time_s), 0.0
        for first in np.linspace(0, rows, _MOMENTS, endpoint=False, dtype=int):
            simulated = predict(
                machine,
                run.rows(slice(first, None)),
                SIMULATION,
                period=data.period,
                initial_state=np.vstack([states[first], states[first] + displacements]),
                longest_step=POLISH_STEP,
            ).readings[..., of_position]
            with np.errstate(invalid="ignore", over="ignore"):
                changes = ((simulated[1:] - simulated[0]) / noise) ** 2
            squares = np.sum(np.where(np.isfinite(changes), changes, np.inf), axis=1) / rows
            largest = max(largest, float(np.max(np.mean(squares, axis=1), initial=0.0)))
        return largest

    return math.sqrt(float(np.mean(list(map_runs(of_run, data)))))


def _displacements(machine: Machine, rows: Array) -> Array:
    """Return displaced states, one for each motion that stretches no belt and that a sensor shows.

    Args:
        machine: Machine that is displaced.
        rows: Measurements of positions / noise, per m or rad of each coordinate,
            shape (sensors, coordinates).

    Returns:
        Positions (m, rad) and velocities (zero), each of one standard deviation of the noise of the sensor
        that shows the motion best, shape (motions, 2 * coordinates).
    """
    motions = np.array(list(rigid_motions(machine).values())).reshape(-1, len(machine.coordinates))
    shown = np.max(np.abs(motions @ rows.T), axis=1, initial=0.0)
    visible = shown > 0.0
    positions = motions[visible] / shown[visible, None]
    return np.hstack([positions, np.zeros_like(positions)])
