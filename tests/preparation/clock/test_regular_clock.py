"""Tests of stamps that jitter around equal steps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.preparation.clock.regular_clock import with_regular_clock
from hframe_gym.preparation.usable import usable_run
from hframe_gym.recordings import Recording

AXIS = BUILTIN_MACHINES["axis"]()
PERIOD = 4e-3  # s
ROWS = 600
JITTER = 1e-4  # s


def moving(times: Array) -> Recording:
    """Return a run of the axis that is sampled at given times and stamped with them."""
    rng = np.random.default_rng(1)
    position = 0.05 * np.sin(2.0 * np.pi * 1.3 * times) + rng.normal(0.0, 2e-6, len(times))
    return Recording("run", times, np.cos(times)[:, None], position[:, None])


@pytest.fixture
def late() -> Array:
    """By how much each stamp is late, s."""
    return np.abs(np.random.default_rng(0).normal(0.0, JITTER, ROWS))


def test_stamps_that_jitter_become_equal_steps(late: Array) -> None:
    sampled = moving(PERIOD * np.arange(ROWS))
    stamped = dataclasses.replace(sampled, time_s=sampled.time_s + late)
    regular, jitter_s = with_regular_clock(stamped, AXIS)
    errors = regular.time_s - sampled.time_s
    assert np.ptp(errors) < 0.3 * JITTER  # they are all late by the mean
    assert jitter_s == pytest.approx(late.std(), rel=0.05)
    assert np.array_equal(regular.outputs, stamped.outputs)


@pytest.mark.parametrize("period", [1.2e-3, 1.5e-3, 5e-3 / 3.0, 2.5e-3])
def test_stamps_in_whole_milliseconds_become_the_steps_of_the_controller(period: float) -> None:
    sampled = moving(period * np.arange(ROWS))
    stamped = dataclasses.replace(sampled, time_s=1e-3 * np.floor(1e3 * sampled.time_s + 1e-6))
    regular, _ = with_regular_clock(stamped, AXIS)
    assert np.diff(regular.time_s) == pytest.approx(period, rel=1e-3)


def test_a_row_that_is_missing_among_steps_of_a_millisecond_leaves_its_gap() -> None:
    sampled = moving(1e-3 * np.arange(ROWS))
    kept = np.delete(np.arange(ROWS), [100, 250, 400])
    run = Recording("run", sampled.time_s[kept], sampled.inputs[kept], sampled.outputs[kept])
    assert with_regular_clock(run, AXIS)[0].time_s == pytest.approx(run.time_s, abs=1e-6)


def test_rows_that_are_missing_leave_whole_steps(late: Array) -> None:
    sampled = moving(PERIOD * np.arange(ROWS))
    kept = np.r_[0:300, 312:ROWS]
    stamped = Recording("run", (sampled.time_s + late)[kept], sampled.inputs[kept], sampled.outputs[kept])
    regular, _ = with_regular_clock(stamped, AXIS)
    assert regular.time_s[300] - regular.time_s[299] == pytest.approx(13 * PERIOD, rel=1e-3)


def test_true_stamps_of_samples_that_jitter_are_kept(late: Array) -> None:
    run = moving(PERIOD * np.arange(ROWS) + late)
    assert with_regular_clock(run, AXIS) == (run, 0.0)


def test_stamps_are_kept_where_no_motion_shows_which_times_are_true(late: Array) -> None:
    run = dataclasses.replace(moving(PERIOD * np.arange(ROWS) + late), outputs=np.zeros((ROWS, 1)))
    assert with_regular_clock(run, AXIS) == (run, 0.0)


def test_a_usable_run_has_equal_steps_and_says_so(late: Array) -> None:
    sampled, lines = moving(PERIOD * np.arange(ROWS)), list[str]()
    usable_run(dataclasses.replace(sampled, time_s=sampled.time_s + late), AXIS, lines.append)
    assert any("the stamps jitter by 0.06 ms" in line for line in lines)
