"""Excitation: inputs that do not move the machine, and motion in one direction only."""

from __future__ import annotations

import numpy as np

from hframe_gym.data_validation import check_before_fit, check_recordings
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import with_change


def test_an_input_that_never_changes_is_advice(runs: list[Recording], hframe: Machine) -> None:
    idle = with_change(runs[:1], lambda u, y: (u * [1.0, 0.0], y))
    assert [f.channel for f in check_before_fit(idle, hframe)] == ["v2_V"]


def test_inputs_below_coulomb_friction_never_break_away(runs: list[Recording], hframe: Machine) -> None:
    findings = check_recordings(with_change(runs, lambda u, y: (0.01 * u, y)), hframe)
    assert {f.channel for f in findings if "never breaks away" in f.message} == {"x", "y"}


def test_inputs_far_above_the_rated_voltage_are_advice(runs: list[Recording], hframe: Machine) -> None:
    findings = check_recordings(with_change(runs[:1], lambda u, y: (20 * u, y)), hframe)
    assert any(f.channel == "v1_V" and "rated 12 V: is the column in another unit" in f.message for f in findings)


def test_motion_in_one_direction_is_advice(hframe: Machine) -> None:
    time = np.arange(1000) * 1e-3
    inputs = np.full((1000, 2), -3.0)
    findings = check_recordings([Recording("push", time, inputs, hframe.simulate(time, inputs).outputs)], hframe)
    assert any(f.channel == "y" and "one direction only" in f.message for f in findings)
    assert any(f.channel == "y" and "moves forward 100 %" in f.message for f in findings)
