"""Tests of stamps that jitter around equal steps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.preparation.clock.regular_clock import stamp_quantum, with_regular_clock
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


@pytest.mark.parametrize("rate", [333.0, 334.0, 249.8, 124.9])  # Hz
@pytest.mark.parametrize("still", [False, True])
def test_rounded_stamps_of_a_period_near_whole_milliseconds_become_equal_steps(
    rate: float, still: bool
) -> None:
    """One step in hundreds differs, which fifth differences of fast motion do not show."""
    sampled = moving(np.arange(1500) / rate)
    stamped = dataclasses.replace(sampled, time_s=1e-3 * np.rint(1e3 * sampled.time_s))
    if still:
        stamped = dataclasses.replace(stamped, outputs=np.zeros_like(stamped.outputs))
    regular, jitter_s = with_regular_clock(stamped, AXIS)
    assert np.diff(regular.time_s) == pytest.approx(1.0 / rate, rel=1e-3)
    assert np.ptp(regular.time_s - sampled.time_s) < 0.4e-3  # the stamps: 1 ms
    assert jitter_s == pytest.approx(1e-3 / np.sqrt(12.0), rel=0.1)


def test_a_cycle_that_a_controller_skipped_is_no_rounding() -> None:
    """The stamps scatter around equal steps as rounded ones do, but the motion follows the stamps."""
    steps = np.full(ROWS, 4e-3)
    steps[[150, 450]] = 5e-3
    run = moving(np.round(np.cumsum(steps), 3))
    assert with_regular_clock(run, AXIS) == (run, 0.0)


def test_samples_that_scatter_more_than_their_stamps_are_rounded_keep_their_stamps() -> None:
    late = np.random.default_rng(2).uniform(-0.5e-3, 0.5e-3, ROWS)
    sampled = moving(3.0005e-3 * np.arange(ROWS) + late)
    stamped = dataclasses.replace(sampled, time_s=np.round(sampled.time_s, 4))
    assert with_regular_clock(stamped, AXIS) == (stamped, 0.0)


@pytest.mark.parametrize("digits", [3, 4, 6])
def test_the_rounding_of_stamps_is_found_in_decimals_of_any_number(digits: int) -> None:
    times = 1234.5 + 3.3337e-3 * np.arange(ROWS)
    assert stamp_quantum(np.round(times, digits)) == pytest.approx(10.0**-digits, rel=1e-6)


def test_equal_steps_and_stamps_in_full_are_not_rounded(late: Array) -> None:
    assert stamp_quantum(np.round(4e-3 * np.arange(ROWS), 3)) == 0.0
    assert stamp_quantum(3.003e-3 * np.arange(ROWS)) == 0.0
    assert stamp_quantum(4e-3 * np.arange(ROWS) + late) == 0.0


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
