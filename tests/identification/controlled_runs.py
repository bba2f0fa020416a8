"""Runs of a rig that a position controller moves from place to place, one row per controller period."""

from __future__ import annotations

import numpy as np

from hframe_gym.arrays import Array
from hframe_gym.dynamics import rollout
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording

PERIOD = 1e-3  # s, of the controller
_REST_ROWS = 100  # before the first voltage
_ROWS_AT_A_PLACE = 250
_OFFSET = 0.3  # of the sensors, in their rounding steps, so that rest is no edge of a step


def random_places(rng: np.random.Generator, rows: int) -> Array:
    """Return where the controller is told to be, m, shape (rows,): zero, then a new place each 250 ms."""
    places = np.repeat(rng.uniform(-0.05, 0.05, 1 + rows // _ROWS_AT_A_PLACE), _ROWS_AT_A_PLACE)[:rows]
    places[:_REST_ROWS] = 0.0
    return places


def controlled_run(
    name: str, rig: Machine, places: Array, noise: Array, *, window: int, gains: tuple[float, float]
) -> Recording:
    """Return a run in which a proportional-derivative controller follows places by the rounded first sensor.

    Args:
        name: Name of the run.
        rig: Machine with one drive, from rest at zero.
        places: Wanted measurement of the first sensor, m or rad, shape (n,).
        noise: Noise of the sensors before they round, m or rad, shape (n, sensors).
        window: Rows over which a move to the next place extends.
        gains: Gains of position, V/m or V/rad, and speed, Vs/m or Vs/rad.
    """
    rows, count = len(places), len(rig.coordinates)
    goal = np.convolve(places, np.hanning(window) / np.hanning(window).sum(), "full")[:rows]
    speed = np.gradient(goal, PERIOD)
    steps = np.array([sensor.resolution for sensor in rig.sensors])
    rounded = steps > 0.0
    state, last = np.zeros(2 * count), 0.0
    inputs, outputs = np.zeros((rows, 1)), np.zeros((rows, len(steps)))
    for row in range(rows):
        measured = rig.sensor_matrix @ state[:count] + noise[row] + _OFFSET * steps
        measured[rounded] = np.round(measured[rounded] / steps[rounded]) * steps[rounded]
        outputs[row] = measured
        if row >= _REST_ROWS:
            proportional, derivative = gains
            volts = proportional * (goal[row] - measured[0])
            volts += derivative * (speed[row] - (measured[0] - last) / PERIOD)
            inputs[row] = np.clip(volts, -12.0, 12.0)
        last = measured[0]
        interval = np.array([0.0, PERIOD]), np.repeat(inputs[row : row + 1], 2, axis=0)
        state = rollout(rig, *interval, start=state, velocities=True, parallel=False)[0, -1]
    return Recording(name, np.arange(rows) * PERIOD, inputs, outputs)


def every(run: Recording, rows: int) -> Recording:
    """Return a log with every such row of a run."""
    return Recording(run.name, run.time_s[::rows], run.inputs[::rows], run.outputs[::rows])
