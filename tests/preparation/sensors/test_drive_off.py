"""Positions that rest where their set point does not lead them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.data_validation import check_before_fit
from hframe_gym.dynamics import simulate
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.preparation.sensors.drive_off import drives_off
from hframe_gym.preparation.session import prepare_session
from hframe_gym.recordings import Recording

OFF = 120  # rows of 10 ms


def servo() -> Machine:
    """Return a servo, which follows a commanded angle."""
    return BUILTIN_MACHINES["servo"]()


def runs() -> list[Recording]:
    """Return two runs in which a servo takes four angles, for 1.2 s each."""
    time_s = np.arange(4 * OFF) * 1e-2
    recorded = []
    for number, angles in enumerate([(0.0, 0.6, -0.4, 0.2), (0.0, -0.5, 0.5, -0.2)]):
        commands = np.repeat(angles, OFF)[:, None]
        outputs = simulate(servo(), time_s, commands).outputs
        noise = 1e-3 * np.random.default_rng(number).normal(size=outputs.shape)
        recorded.append(Recording(f"run_{number}", time_s, commands, outputs + noise))
    return recorded


def with_outputs(recording: Recording, outputs: Array) -> Recording:
    """Return a recording with other measurements."""
    return dataclasses.replace(recording, outputs=outputs)


@pytest.mark.parametrize("begin", [0, 2 * OFF])
def test_rows_in_which_a_servo_is_off_are_not_used(begin: int) -> None:
    """It stays at 0.9 rad while the set points go on, at the beginning of the log or later."""
    first, second = runs()
    outputs = first.outputs.copy()
    outputs[begin : begin + OFF] = 0.9
    recorded = [with_outputs(first, outputs), second]
    [rest] = drives_off(recorded, servo())
    assert (rest.run, rest.first, rest.last) == ("run_0", begin, begin + OFF - 1)
    assert rest.apart == pytest.approx(0.9 - first.inputs[begin, 0], abs=0.05)
    [finding] = [f for f in check_before_fit(recorded, servo()) if "was the drive off" in f.message]
    assert (finding.severity, finding.run) == ("advice", "run_0")
    assert f"rows {begin + 1} to {begin + OFF}" in finding.message
    prepared = prepare_session(recorded, servo(), lambda _: None).data.runs
    assert np.nanmax(prepared[0].outputs) < 0.8
    assert not np.isnan(prepared[1].outputs).any()


def test_a_wrong_scale_and_friction_are_no_drive_that_is_off() -> None:
    """A servo turns 1.3 times as far as commanded, and rests 0.03 rad away from there."""
    recorded = [with_outputs(r, 1.3 * r.outputs + 0.03 * np.sign(r.inputs)) for r in runs()]
    assert drives_off(recorded, servo()) == []
