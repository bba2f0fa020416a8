"""Wrapped angles and counters are recognized by their jumps and unwrapped; other jumps are left alone."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from hframe_gym.machine import Machine
from hframe_gym.preparation.usable import usable_run
from hframe_gym.recordings import (
    Recording,
    exact_quantum,
    find_wrap,
    jumps_between_ends,
    known_moduli,
    shared_wraps,
    unwrapped,
    without_shared_wraps,
    without_wraps,
    wraps_of,
)
from tests.example_runs import example_runs

PHI1 = 0  # column of phi1_rad
TIME = np.arange(4000) * 1e-3
MOTION = 40.0 * np.sin(2.0 * TIME) + 3.0 * TIME**2  # rad; several turns in both directions, with reversals


@pytest.mark.parametrize("low", [0.0, -math.pi])  # 0 to 2 pi, and -pi to pi
@pytest.mark.parametrize(
    ("modulus", "scale"), [(2 * math.pi, 1.0), (360.0, 180 / math.pi), (1.0, 1 / (2 * math.pi))], ids=str
)
def test_an_angle_within_one_turn_is_unwrapped(modulus: float, scale: float, low: float) -> None:
    angle = scale * MOTION
    wrapped = (angle - low) % modulus + low
    wrap = find_wrap(wrapped, known_moduli(0.0, angle=True))
    assert wrap is not None
    assert wrap.modulus == modulus
    assert wrap.jumps == np.count_nonzero(np.diff(np.floor((angle - low) / modulus)))
    np.testing.assert_allclose(
        unwrapped(wrapped, modulus, TIME) - wrapped[0], angle - angle[0], atol=1e-9 * scale
    )


@pytest.mark.parametrize("bits", [12, 16])
@pytest.mark.parametrize("signed", [False, True])
def test_a_counter_is_unwrapped(bits: int, signed: bool) -> None:
    counts = np.rint(MOTION * 2**bits / 30.0)
    low = -(2 ** (bits - 1)) if signed else 0
    wrapped = (counts - low) % 2**bits + low
    wrap = find_wrap(wrapped, known_moduli(1.0, angle=False))
    assert wrap is not None
    assert (wrap.modulus, wrap.name) == (2**bits, f"a counter of {bits} bits")
    np.testing.assert_array_equal(unwrapped(wrapped, wrap.modulus, TIME) - wrapped[0], counts - counts[0])


def test_counts_per_turn_are_told_from_a_power_of_two() -> None:
    counts = np.rint(MOTION * 4000 / (2 * math.pi))
    wrap = find_wrap(counts % 4000, known_moduli(1.0, angle=False))
    assert wrap is not None
    assert wrap.modulus == 4000


def test_a_first_value_left_from_the_run_before_does_not_hide_a_wrap() -> None:
    counts = np.rint(60000.0 + 10000.0 * TIME)
    counts[0] = 8.0
    wrap = find_wrap(counts % 2**16, known_moduli(1.0, angle=False))
    assert wrap is not None
    assert (wrap.modulus, wrap.jumps) == (2**16, 1)


def test_noise_at_the_end_of_the_turn_is_unwrapped() -> None:
    """A shaft that stands at the end of the turn jumps back and forth by noise alone, then it moves away."""
    angle = 1e-3 * np.random.default_rng(0).standard_normal(4000) + np.maximum(TIME - 2.0, 0.0)
    wrapped = angle % (2 * math.pi)
    wrap = find_wrap(wrapped, known_moduli(0.0, angle=True))
    assert wrap is not None
    np.testing.assert_allclose(np.ptp(unwrapped(wrapped, wrap.modulus, TIME)), np.ptp(angle), atol=1e-9)


def test_repeated_and_missing_measurements_are_unwrapped() -> None:
    held = MOTION[np.arange(len(MOTION)) // 4 * 4]
    wrapped = held % (2 * math.pi)
    wrapped[100:120] = np.nan
    wrap = find_wrap(wrapped, known_moduli(0.0, angle=True))
    assert wrap is not None
    measured = np.isfinite(wrapped)
    np.testing.assert_allclose(
        unwrapped(wrapped, wrap.modulus, TIME)[measured] - wrapped[0], held[measured] - held[0], atol=1e-9
    )
    assert np.isnan(unwrapped(wrapped, wrap.modulus, TIME)[~measured]).all()


@pytest.mark.parametrize(
    "values",
    [
        MOTION,  # many turns, counted
        np.where(TIME < 1.0, 0.0, 2 * math.pi),  # a step of one turn, without motion
        np.where(np.arange(4000) == 2000, 2 * math.pi, 0.4 * np.sin(2.0 * TIME)),  # an outlier
        np.where(TIME < 2.0, TIME, TIME + 2 * math.pi),  # a jump in the direction of the motion
        np.where(TIME < 2.0, TIME, TIME - 2 * math.pi)[::-1] * 3.0,  # a jump of another size
        (2500.0 * TIME) % (2 * math.pi),  # too fast
        np.full(4000, np.nan),
    ],
    ids=["counted", "step", "outlier", "forward", "size", "fast", "empty"],
)
def test_other_motions_and_jumps_do_not_wrap(values: np.ndarray) -> None:
    assert find_wrap(values, known_moduli(0.0, angle=True)) is None


def test_recorded_runs_do_not_wrap(hframe: Machine) -> None:
    for rig in ("rig_a", "rig_b"):
        assert all(without_wraps(run, hframe) is run for run in example_runs(rig))


@pytest.mark.parametrize("modulus", [2 * math.pi, 2**12 * 0.002])
def test_a_recording_is_unwrapped_before_it_is_cleaned(modulus: float, hframe: Machine) -> None:
    run = example_runs("rig_b")[1]
    quantum = 0.002
    outputs = run.outputs.copy()
    outputs[:, PHI1] = np.rint(40.0 * np.sin(3.0 * run.time_s) / quantum) * quantum
    wrapped = outputs.copy()
    wrapped[:, PHI1] = np.round(outputs[:, PHI1] % modulus, 5)
    logged = dataclasses.replace(run, outputs=wrapped)
    assert list(wraps_of(logged, hframe)) == ["phi1_rad"]
    cleaned = usable_run(logged, hframe).measured.outputs[:, PHI1]
    expected = outputs[:, PHI1] - outputs[0, PHI1] + wrapped[0, PHI1]
    assert np.isfinite(cleaned).all()
    np.testing.assert_allclose(cleaned, expected, atol=0.1 * quantum)


def test_a_rounded_quantum_is_determined_exactly() -> None:
    """A file with six digits states a step of 2 pi / 4096 with an error of 1e-4, thousands by 1e-7."""
    steps = np.random.default_rng(0).integers(0, 4096, 500)
    values = np.round(steps * 2 * math.pi / 4096, 4)
    assert exact_quantum(values, 0.0015) == pytest.approx(2 * math.pi / 4096, rel=1e-5)
    assert exact_quantum(np.random.default_rng(0).standard_normal(500), 0.1) == 0.0


def test_too_short_runs_do_not_wrap() -> None:
    empty = Recording("a", TIME[:3], np.zeros((3, 1)), np.array([[0.1], [6.2], [0.1]]))
    assert find_wrap(empty.outputs[:, 0], known_moduli(0.0, angle=True)) is None
    assert np.array_equal(
        unwrapped(np.full(3, np.nan), 1.0, np.arange(3.0)), np.full(3, np.nan), equal_nan=True
    )


def test_a_wrap_is_described_in_one_clause() -> None:
    wrap = find_wrap((40.0 * np.sin(TIME)) % 360.0, {360.0: "one turn in degrees"})
    assert wrap is not None
    assert wrap.describe("rad") == "wraps once at one turn in degrees (360 rad) and is unwrapped"


def test_turns_during_a_gap_follow_from_the_speeds_around_it() -> None:
    kept = (TIME < 1.0) | (TIME > 2.0)
    angle = 30.0 * TIME + 2.0 * TIME**2
    wrapped = angle % (2 * math.pi)
    np.testing.assert_allclose(unwrapped(wrapped[kept], 2 * math.pi, TIME[kept]), angle[kept], atol=1e-9)


def test_values_on_the_way_between_the_ends_are_not_measured() -> None:
    angle = 5.0 * np.sin(1.5 * TIME) + 3.0
    values = angle % (2 * math.pi)
    jumps = np.flatnonzero(np.abs(np.diff(values)) > math.pi)
    values[jumps[0]], values[jumps[1]] = 2.0, 4.5
    wrap = find_wrap(values, known_moduli(0.0, angle=True))
    assert wrap is not None
    assert (wrap.jumps, wrap.lost) == (len(jumps), 2)
    assert "2 rows in which it switches" in wrap.describe("rad")
    continuous = unwrapped(values, wrap.modulus, TIME)
    kept = np.isfinite(continuous)
    np.testing.assert_array_equal(np.flatnonzero(~kept), jumps[:2])
    np.testing.assert_allclose((continuous - values[0])[kept], (angle - angle[0])[kept], atol=1e-9)


def test_a_potentiometer_rests_in_its_dead_angle() -> None:
    """Its range of one turn ends 0.3 rad before the next one begins; it rests at the lower end meanwhile."""
    angle = 5.0 * np.sin(1.5 * TIME) + 3.0
    position = angle % (2 * math.pi + 0.3)
    values = np.maximum(position - 0.3, 0.0)
    down = np.flatnonzero(np.diff(values) < -math.pi)
    values[down[::2] + 1] = 0.005  # it settles at its end
    wrap = find_wrap(values, known_moduli(0.0, angle=True))
    assert wrap is not None
    assert wrap.modulus == 2 * math.pi
    continuous = unwrapped(values, wrap.modulus, TIME)
    np.testing.assert_array_equal(np.isnan(continuous), position <= 0.3)
    assert np.nanmax(np.abs(np.diff(continuous))) < 0.01


def test_an_encoder_in_slow_motion_has_no_dead_angle() -> None:
    values = np.rint(1000.0 * np.sin(1.5 * TIME)) % 720
    wrap = find_wrap(values, {720.0: "one turn"})
    assert wrap is not None
    assert wrap.lost == 0


def test_a_wrap_that_another_run_shows_is_unwrapped(hframe: Machine) -> None:
    """A single jump with disturbed values before it does not tell the size of the turn."""
    angle = 5.0 * np.sin(1.5 * TIME) + 3.0
    first, second = (angle % (2 * math.pi) for _ in range(2))
    jumps = np.flatnonzero(np.abs(np.diff(second)) > math.pi)
    second[jumps[0] - 1 : jumps[0] + 1] = 5.9, 5.95
    end = jumps[1] - 100
    template = example_runs("rig_a")[0]
    runs = []
    for name, values, rows in (("a", first, len(TIME)), ("b", second, int(end))):
        outputs = np.zeros((rows, 4))
        outputs[:, PHI1] = values[:rows]
        inputs = np.zeros((rows, template.inputs.shape[1]))
        runs.append(Recording(name, TIME[:rows], inputs, outputs))
    assert find_wrap(runs[1].outputs[:, PHI1], known_moduli(0.0, angle=True)) is None
    [(key, wrap)] = shared_wraps(runs, hframe).items()
    assert key == ("b", "phi1_rad")
    assert wrap.modulus == 2 * math.pi
    untouched, changed = without_shared_wraps(runs, hframe)
    assert untouched is runs[0]
    kept = ~np.isin(np.arange(end), [jumps[0] - 1, jumps[0]])
    expected = angle[:end] - angle[0] + second[0]
    np.testing.assert_allclose(changed.outputs[kept, PHI1], expected[kept], atol=1e-9)


@pytest.mark.parametrize("speed", [1.0, 300.0])
def test_jumps_between_ends_are_found_whatever_the_turn(speed: float) -> None:
    values = np.minimum((3.0 * speed * TIME) % 5.5, 5.0)
    jumps = jumps_between_ends(values, 0.0, 5.0)
    if speed == 1.0:
        assert jumps is not None
        assert (len(jumps.rows), jumps.before, round(jumps.after, 2)) == (2, 5.0, 0.0)
    else:
        assert jumps is None


@pytest.mark.parametrize(
    "values",
    [
        np.where(np.arange(4000) == 2000, 5.0, 0.4 * np.sin(2.0 * TIME)),  # an outlier
        np.clip(5.0 * np.sin(40.0 * TIME) + 2.5, 0.0, 5.0),  # a fast motion
        np.where(TIME < 2.0, 1.5, 4.5) + 0.1 * np.sin(TIME),  # a step within the range
    ],
    ids=["outlier", "motion", "step"],
)
def test_other_jumps_are_not_between_ends(values: np.ndarray) -> None:
    assert jumps_between_ends(values, 0.0, 5.0) is None


def test_a_table_that_rests_after_each_step_has_no_dead_angle() -> None:
    """It moves by a third of a turn in a few rows, and rests at other angles next to the end of the turn."""
    step = np.repeat(np.clip(np.arange(40) / 4.0, 0.0, 1.0)[None], 30, axis=0) + np.arange(30)[:, None]
    values = (step.ravel() / 3.0 + 0.9) % 1.0
    wrap = find_wrap(values, {1.0: "one turn"})
    assert wrap is not None
    assert wrap.lost == 0
