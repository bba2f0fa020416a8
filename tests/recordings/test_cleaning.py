"""Repeated measurements of slow sensors, and silences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.machine import BUILTIN_MACHINES, Sensor
from hframe_gym.recordings import Recording, repetitions, without_repetitions, without_silences
from tests.example_runs import example_runs

X = 2  # column of x_m
AXIS = BUILTIN_MACHINES["axis"]()


@pytest.fixture
def run() -> Recording:
    """Return a recorded run of 2.5 s, whose arrays cannot be written."""
    return example_runs("rig_b")[1]


def held(values: np.ndarray, rows: int) -> np.ndarray:
    """Return a channel whose sensor measures only every that many rows; the log repeats the last one."""
    return np.asarray(values[np.arange(len(values)) // rows * rows])


@pytest.mark.parametrize("rows", [2, 5, 8])
@pytest.mark.parametrize("channel", [0, X])  # an encoder, whose measurements are quantized, and a laser
def test_repeated_measurements_of_a_slow_sensor_become_empty(run: Recording, channel: int, rows: int) -> None:
    outputs = run.outputs.copy()
    outputs[:, channel] = held(outputs[:, channel], rows)
    slow = dataclasses.replace(run, outputs=outputs)
    assert repetitions(outputs[:, channel]) == rows
    measured = np.isfinite(without_repetitions(slow).outputs)
    assert not measured[np.arange(len(measured)) % rows > 0, channel].any()
    moving = np.flatnonzero(np.diff(outputs[::rows, channel])) + 1
    assert measured[moving * rows, channel].all()
    assert measured[:200, channel].sum() > 5  # at rest, too
    assert measured[:, [j for j in range(4) if j != channel]].all()


def test_measurements_at_irregular_times_are_kept_where_they_change(run: Recording) -> None:
    rows = np.cumsum(np.random.default_rng(0).integers(6, 10, 400))
    rows = rows[rows < len(run.time_s)]
    outputs = run.outputs.copy()
    first = np.maximum.accumulate(
        np.where(np.isin(np.arange(len(outputs)), rows), np.arange(len(outputs)), 0)
    )
    outputs[:, X] = outputs[first, X]
    cleaned = without_repetitions(dataclasses.replace(run, outputs=outputs))
    measured = np.flatnonzero(np.isfinite(cleaned.outputs[:, X]))
    changed = np.flatnonzero(np.diff(outputs[:, X], prepend=np.nan))
    assert np.isin(changed, measured).all()
    assert len(measured) < 1.05 * len(rows)  # some rows at rest are counted from another row


def test_sensors_that_measure_in_every_row_repeat_nothing() -> None:
    for rig in ("rig_a", "rig_b"):
        for recording in example_runs(rig):
            assert without_repetitions(recording) is recording


def test_a_resting_or_slowly_moving_encoder_repeats_nothing() -> None:
    quantum = 5e-4
    assert repetitions(np.full(1000, 0.7)) == 1
    assert repetitions(np.floor(np.arange(1000) * 0.05) * quantum) == 1
    assert repetitions(np.full(1000, np.nan)) == 1


def test_a_held_sensor_is_found_in_fast_steady_motion() -> None:
    """Every change is of many steps, so that no change is that of a single one."""
    time = np.arange(800) * 5e-3
    x = np.rint(2.0 * np.maximum(time - 0.5, 0.0) ** 1.02 / 2.5e-5) * 2.5e-5  # 400 steps per row
    assert repetitions(x) == 1.0
    assert repetitions(held(x, 4)) == 4.0


def test_a_sensor_whose_period_is_no_whole_number_of_rows_is_held_at_steady_speed() -> None:
    """A bus sends the angle every 4.2 rows; its steps are alike, but no multiples of a quantum."""
    message = (np.arange(1200) / 4.2).astype(int)  # the last one before each row
    sent_s = 0.021 * message + np.random.default_rng(0).uniform(0.0, 3e-4, 286)[message]
    assert repetitions(350.0 * np.maximum(sent_s - 0.2, 0.0)) == 4.0


def test_a_sensor_that_measures_in_four_of_five_rows_is_found() -> None:
    time = np.arange(2000) * 1e-3
    x = np.rint(0.1 * np.sin(8.0 * time) / 1e-5) * 1e-5
    last = (np.arange(2000) * 4 // 5 * 5 + 3) // 4  # row of the last measurement
    assert repetitions(x[np.minimum(last, np.arange(2000))]) == pytest.approx(1.25, abs=0.02)


@pytest.mark.parametrize("speed", [0.2, 0.7, 2.5, 30.0])  # quantization steps per row
@pytest.mark.parametrize("noise", [0.0, 0.5, 2.0])  # quantization steps
@pytest.mark.parametrize("turning", [True, False])
def test_a_coarse_or_noisy_sensor_is_not_held(speed: float, noise: float, turning: bool) -> None:
    rows = np.arange(3000)
    motion = speed * 200 * np.sin(rows / 200) if turning else speed * rows
    steps = np.rint(motion + noise * np.random.default_rng(0).standard_normal(3000))
    assert repetitions(2e-3 * steps) == 1.0


def test_unequal_steps_in_slow_motion_are_no_repetitions() -> None:
    """A cheap encoder's lines are not equally far apart; at a low speed, its value changes in few rows."""
    lines = np.cumsum(np.random.default_rng(1).uniform(0.8e-3, 1.2e-3, 500))
    motion = 0.05 + 0.04 * np.sin(np.arange(4000) / 600)
    assert repetitions(lines[np.searchsorted(lines, motion)]) == 1.0
    assert repetitions(lines[np.searchsorted(lines, 5e-5 * np.arange(4000))]) == 1.0


def test_values_that_are_repeated_while_a_connection_is_lost_are_not_measured() -> None:
    time = np.arange(400) * 5e-3
    x = 0.3 * np.maximum(time - 0.2, 0.0)
    x[200:280] = x[199]
    lost = Recording("run", time, np.ones((400, 1)), x[:, None])
    assert np.flatnonzero(np.isnan(without_silences(lost, AXIS).outputs)).tolist() == list(range(200, 280))
    empty = dataclasses.replace(lost, outputs=np.where(np.arange(400)[:, None] % 3, np.nan, lost.outputs))
    found = np.isnan(without_silences(empty, AXIS).outputs) & np.isfinite(empty.outputs)
    assert np.flatnonzero(found).tolist() == list(range(204, 280, 3))


def test_a_current_that_is_constant_at_standstill_and_jumps_with_the_command_is_not_silent() -> None:
    """The same values of a position are those of a lost connection."""
    time = np.arange(400) * 5e-3
    values = 0.3 * np.maximum(time - 0.2, 0.0)
    values[200:280] = values[199]
    run = Recording("run", time, np.ones((400, 1)), values[:, None])
    current = AXIS.replace(sensors=(Sensor("motor_A", {"motor": 1.0}, kind="current"),))
    assert without_silences(run, current) is run
    assert without_silences(run, AXIS) is not run


def test_a_rest_before_a_step_of_the_command_is_not_silent() -> None:
    """A cylinder creeps by single quantization steps, rests, and is sent to the other end within one row."""
    time = 0.1 * np.arange(60)
    creep = np.where(np.arange(60) < 20, 1e-3 * np.arange(60), 0.02)
    settling = 0.25 + 0.03 * (1.0 - np.exp(-(np.arange(60) - 30) / 5.0))
    x = np.where(np.arange(60) < 30, creep, settling)
    run = Recording("run", time, np.ones((60, 1)), x[:, None])
    assert without_silences(run, AXIS) is run


@pytest.mark.parametrize("quantum", [1e-6, 1e-2])
def test_a_machine_that_stops_and_goes_on_is_not_silent(quantum: float) -> None:
    time = np.arange(400) * 5e-3
    travel = np.interp(time, [0.0, 0.2, 0.7, 1.2, 2.0], [0.0, 0.0, 0.2, 0.2, 0.4])
    x = np.rint(travel / quantum) * quantum
    stopping = Recording("run", time, np.ones((400, 1)), x[:, None])
    assert without_silences(stopping, AXIS) is stopping
