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
    known_moduli,
    unwrapped,
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
