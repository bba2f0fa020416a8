"""Tests of fits by instruments to logs that are slower than the controller."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from hframe_gym.dynamics import rollout
from hframe_gym.identification import Dataset, Fit, default_free_parameters, fit, prepare
from hframe_gym.identification.fit.slow_logs import count_updates, fit_slow_log
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording

pytestmark = pytest.mark.unit
Array = NDArray[np.float64]
AXIS = BUILTIN_MACHINES["belt-axis"]()
RIG = AXIS.replace({"x.mass": 1.1 * AXIS.parameters["x.mass"]})
PERIOD = 1e-3  # s, of the controller
ROWS = 1500
RUNS = 6
UPDATES = 4  # of the voltage from one row of the log to the next


def controlled(seed: int) -> Recording:
    """Return a run at the rate of a controller that reads the encoder of the motor, with its rounding errors."""
    rng = np.random.default_rng(seed)
    places = np.repeat(rng.uniform(-0.05, 0.05, 1 + ROWS // 250), 250)[:ROWS]
    places[:100] = 0.0
    window = np.hanning(60) / np.hanning(60).sum()
    goal = np.convolve(places, window, "full")[:ROWS] / AXIS.coordinates[1].radius  # rad
    speed = np.gradient(goal, PERIOD)
    steps = np.array([sensor.resolution for sensor in AXIS.sensors])
    noise = rng.normal(0.0, [sensor.noise for sensor in AXIS.sensors], (ROWS, 2))
    state, last = np.zeros(4), 0.0
    inputs, outputs = np.zeros((ROWS, 1)), np.zeros((ROWS, 2))
    for row in range(ROWS):
        exact = RIG.sensor_matrix @ state[:2] + noise[row] + 0.3 * steps
        angle, outputs[row, 1] = np.round(exact[0] / steps[0]) * steps[0], exact[1]
        outputs[row, 0] = angle
        if row >= 100:
            volts = 10.0 * (goal[row] - angle) + 0.05 * (speed[row] - (angle - last) / PERIOD)
            inputs[row] = np.clip(volts, -12.0, 12.0)
        last = angle
        interval = np.array([0.0, PERIOD]), np.repeat(inputs[row : row + 1], 2, axis=0)
        state = rollout(RIG, *interval, start=state, velocities=True, parallel=False)[0, -1]
    return Recording(f"run_{seed}", np.arange(ROWS) * PERIOD, inputs, outputs)


@cache
def slow_log() -> Dataset:
    """Return logs with every fourth row of the runs."""
    runs = map(controlled, range(RUNS))
    logs = [Recording(r.name, r.time_s[::4], r.inputs[::4], r.outputs[::4]) for r in runs]
    return prepare(logs, AXIS)


@cache
def least_squares() -> Fit:
    """Return the fit to the interpolated voltages."""
    return fit(AXIS, default_free_parameters(AXIS), slow_log().with_updates(UPDATES), SEARCH_BANDWIDTH)


def errors(fitted: Fit) -> Array:
    """Return the relative errors of the masses of carriage and pulley."""
    return np.array([fitted.values[name] / RIG.parameters[name] - 1.0 for name in ("x.mass", "phi.mass")])


def test_instruments_weigh_a_pulley_that_least_squares_find_too_heavy() -> None:
    """The voltage before a row contains the controller's answer to its rounding error."""
    by_instruments = fit_slow_log(least_squares(), slow_log().with_updates(UPDATES))
    assert errors(least_squares())[1] > 0.02
    assert np.all(np.abs(errors(by_instruments)) < 0.5 * np.abs(errors(least_squares())))


def test_instruments_count_the_changes_of_the_voltage() -> None:
    assert count_updates(least_squares(), slow_log(), 20) == UPDATES


def test_a_log_with_held_voltages_is_not_fitted_again() -> None:
    assert fit_slow_log(least_squares(), slow_log()) is least_squares()


def test_a_log_with_few_rows_is_not_fitted_again() -> None:
    short = slow_log().with_updates(UPDATES)
    short = Dataset(
        tuple(run.first_rows(40) for run in short.runs[:1]), short.noise, short.quantum, short.behind_belts
    )
    assert fit_slow_log(least_squares(), short) is least_squares()
    assert count_updates(least_squares(), short, 20) is None
