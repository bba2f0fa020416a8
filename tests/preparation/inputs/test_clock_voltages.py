"""Tests of what the jitter of a controller's clock does to the voltages of a slow log."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.preparation.inputs.clock_voltages import (
    clock_voltages,
    updated_inputs_of_clock,
    with_clock_voltages,
)
from hframe_gym.preparation.inputs.interpolated_voltages import update_times, updated_inputs

PERIOD, ROWS = 1e-3, 1500  # s, of the controller; rows of a log
LOGS = 40  # one log alone tells the mean within a third
ANSWER = -30.0  # V/rad


def controlled(
    updates: int, *, jitter: float, stamps: float = 0.0, answer: float = ANSWER, seed: int = 0
) -> tuple[Array, ...]:
    """Return stamps, voltages and angles of a log, with all times, all voltages and speeds of its controller.

    Args:
        updates: Changes of the voltage from one row of the log to the next.
        jitter: Standard deviation of the times at which the controller reads, s.
        stamps: Standard deviation of the errors of the stamps, s.
        answer: Voltage per angle that the sensor is farther on than expected, V/rad.
        seed: Seed of times and noise.
    """
    rng = np.random.default_rng(seed)
    nominal = np.arange(ROWS * updates + 1) * PERIOD
    time_s = nominal + np.clip(rng.normal(0.0, jitter, len(nominal)), -0.4 * PERIOD, 0.4 * PERIOD)
    speed = 10.0 * np.sin(2.0 * np.pi * 0.7 * nominal)  # rad/s
    farther = speed * (time_s - nominal)
    angle = np.cumsum(speed) * PERIOD + farther
    inputs = (0.2 * speed + answer * farther + rng.normal(0.0, 5e-3, len(nominal)))[:, None]
    logged = time_s[::updates] + rng.normal(0.0, stamps, ROWS + 1) if stamps else time_s[::updates]
    return logged, inputs[::updates], angle[::updates, None], time_s, inputs, speed


def missing_back_emf(updates: int, *, corrected: bool) -> float:
    """Return the mean voltage, per speed, that interpolated voltages of some logs lack, V s/rad."""

    def of_log(seed: int) -> float:
        stamps, logged, angles, time_s, inputs, speed = controlled(updates, jitter=100e-6, seed=seed)
        clock = clock_voltages(stamps, logged, angles) if corrected else None
        changing = updated_inputs_of_clock(stamps, logged, clock, updates)
        between = changing[:-1, 0] * np.diff(update_times(stamps, updates))
        lacking = inputs[:-1, 0] * np.diff(time_s) - between
        return float(np.sum(lacking * speed[:-1]) / np.sum(speed[:-1] ** 2 * PERIOD))

    return float(np.mean([of_log(seed) for seed in range(LOGS)]))


@pytest.mark.parametrize("updates", [2, 4, 8])
def test_interpolated_voltages_have_the_mean_that_the_jitter_causes(updates: int) -> None:
    lacking = -ANSWER * (100e-6) ** 2 / PERIOD * (1.0 - updates**-2.0)
    assert missing_back_emf(updates, corrected=False) == pytest.approx(lacking, rel=0.2)
    assert abs(missing_back_emf(updates, corrected=True)) < 0.2 * lacking


@pytest.mark.parametrize(
    ("jitter", "stamps", "answer"),
    [
        (0.0, 0.0, ANSWER),  # equal steps
        (0.0, 100e-6, ANSWER),  # only the stamps err: the controller does not know them
        (100e-6, 0.0, 0.0),  # the controller divides by the time that has passed
    ],
)
def test_without_answers_to_jitter_nothing_changes(jitter: float, stamps: float, answer: float) -> None:
    log = controlled(4, jitter=jitter, stamps=stamps, answer=answer)
    clock = clock_voltages(*log[:3])
    assert np.abs(clock.impulses).max() < 0.03 * 10.0 * abs(ANSWER) * (100e-6) ** 2
    assert clock.answers.std() < 0.03 * 10.0 * abs(ANSWER) * 100e-6


def test_the_rounding_of_equal_steps_is_no_jitter() -> None:
    _, logged, angles, *_ = controlled(2, jitter=0.0)
    for start in (0.0, 1000.3, 1046.0):  # s
        stamps = start + np.arange(len(logged)) * 2.0 * PERIOD
        clock = clock_voltages(stamps, logged, angles)
        assert not clock.impulses.any()
        assert not clock.answers.any()


def test_interpolated_voltages_lack_the_answers_to_the_jitter_of_the_rows() -> None:
    stamps, inputs, angles, *_, speed = controlled(4, jitter=100e-6)
    rows = with_clock_voltages(inputs, clock_voltages(stamps, inputs, angles), stamps, 4)
    smooth = 0.2 * speed[::4, None]
    assert (inputs - smooth).std() > 0.015  # V; noise and converter have 5 mV
    assert (rows - smooth).std() < 0.007


@pytest.mark.parametrize(("updates", "most"), [(2, 0.8), (4, 0.9)])
def test_the_voltage_of_a_row_acts_until_it_changes(updates: int, most: float) -> None:
    """Interpolated voltages had lacked the answer of each row altogether."""
    stamps, inputs, angles, time_s, complete, _ = controlled(updates, jitter=100e-6)
    clock = clock_voltages(stamps, inputs, angles)
    means = np.add.reduceat(complete[:-1, 0] * np.diff(time_s), np.arange(0, ROWS * updates, updates))
    means /= np.diff(stamps)

    def error(changing: Array) -> float:
        return float(np.std(changing[:-1, 0].reshape(ROWS, updates).mean(axis=1) - means))

    without = updated_inputs(stamps, with_clock_voltages(inputs, clock, stamps, updates), updates)
    changing = updated_inputs_of_clock(stamps, inputs, clock, updates)
    assert error(changing) < most * error(without)
    first = changing[::updates] - without[::updates]
    np.testing.assert_allclose(first, clock.answers, atol=1e-12)


def test_a_clock_that_wanders_shows_no_answers_of_rows() -> None:
    stamps, _, angles, *_, speed = controlled(4, jitter=0.0)
    late = np.cumsum(np.random.default_rng(1).normal(0.0, 100e-6, ROWS + 1))  # s
    inputs = ANSWER * (speed[::4] * late)[:, None]
    angles = angles + (speed[::4] * late)[:, None]
    clock = clock_voltages(stamps + late, inputs, angles)
    assert clock.impulses.any()
    assert not clock.answers.any()
    # The rows keep their answers, and with them the 1 / 4 of an impulse that interpolation then contains.
    added = with_clock_voltages(inputs, clock, stamps + late, 4) - inputs
    np.testing.assert_allclose(added, 3.75 * clock.impulses / np.median(np.diff(stamps + late)))


def test_a_log_with_all_voltages_or_few_rows_stays_as_it_is() -> None:
    stamps, inputs, angles, *_ = controlled(1, jitter=100e-6)
    clock = clock_voltages(stamps, inputs, angles)
    np.testing.assert_array_equal(with_clock_voltages(inputs, clock, stamps, 1), inputs)
    for unknown in (
        clock_voltages(stamps[:50], inputs[:50], angles[:50]),
        clock_voltages(stamps, inputs, np.full_like(angles, np.nan)),
    ):
        assert not np.any(unknown)
