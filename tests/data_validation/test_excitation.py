"""Excitation: inputs that do not move the machine, and motion in one direction only."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hframe_gym.data_validation import check_before_fit, check_recordings
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import with_change


def test_an_input_that_never_changes_is_advice(runs: list[Recording], hframe: Machine) -> None:
    idle = with_change(runs[:1], lambda u, y: (u * [1.0, 0.0], y))
    assert [f.channel for f in check_before_fit(idle, hframe)] == ["v2_V"]


def test_runs_with_a_single_motor_need_no_advice(runs: list[Recording], hframe: Machine) -> None:
    """A drive without voltage is reported if no run uses it, or if its voltage is another constant."""
    single = with_change(runs, lambda u, y: (u * [1.0, -0.0], y))
    assert not [f for f in check_before_fit([*runs, single[0]], hframe) if "never changes" in f.message]
    texts = {f.message for f in check_before_fit(single, hframe) if "never changes" in f.message}
    assert texts == {"never changes, it is 0 V throughout"}
    held = with_change(runs[:1], lambda u, y: (u * [1.0, 0.0] + [0.0, 3.0], y))
    texts = {f.message for f in check_before_fit([*runs, *held], hframe) if "never changes" in f.message}
    assert texts == {"never changes, it is 3 V throughout"}


def test_inputs_below_coulomb_friction_never_break_away(runs: list[Recording], hframe: Machine) -> None:
    weak = [
        dataclasses.replace(
            r, inputs=0.01 * r.inputs, outputs=hframe.simulate(r.time_s, 0.01 * r.inputs).outputs
        )
        for r in with_change(runs, lambda u, y: (u, y))
    ]
    findings = check_recordings(weak, hframe)
    assert {f.channel for f in findings if f.message.endswith("it never breaks away")} == {"x", "y"}


def test_motion_that_the_inputs_cannot_cause_points_at_their_unit(
    runs: list[Recording], hframe: Machine
) -> None:
    findings = check_recordings(with_change(runs, lambda u, y: (0.01 * u, y)), hframe)
    messages = {f.channel: f.message for f in findings if "never breaks away" in f.message}
    assert set(messages) == {"x", "y"}
    assert re.search(r"but it moves by 0\.\d+ m: is v1_V or v2_V in another unit", messages["x"])


def test_inputs_far_above_the_rated_voltage_are_advice(runs: list[Recording], hframe: Machine) -> None:
    findings = check_recordings(with_change(runs[:1], lambda u, y: (20 * u, y)), hframe)
    assert any(
        f.channel == "v1_V" and "rated 12 V: is the column in another unit" in f.message for f in findings
    )


def test_power_at_the_belt_modes_is_asked_of_forces_and_not_of_set_points() -> None:
    time_s = 1e-3 * np.arange(1500)
    slow = np.outer(np.sin(2.0 * np.pi * 2.0 * time_s), [1.0, 0.5])
    for name, asked in (("corexy", True), ("printer", False)):
        machine = BUILTIN_MACHINES[name]()
        run = Recording("run", time_s, slow, machine.simulate(time_s, slow).outputs)
        power = [f for f in check_recordings([run], machine) if "of its power is below" in f.message]
        assert {f.channel for f in power} == set(machine.input_channels)
        assert {"belts are poorly identifiable" in f.message for f in power} == {asked}


def test_a_duty_cycle_is_reported_as_a_fraction(runs: list[Recording], hframe: Machine) -> None:
    """Recordings hold the voltage that a duty cycle makes of the supply, which may exceed the rated one."""
    drives = tuple(
        dataclasses.replace(d, kind="duty-cycle", channel=f"duty{i}") for i, d in enumerate(hframe.drives)
    )
    machine = hframe.replace(drives=drives)  # rated 12 V
    held = with_change(runs[:1], lambda u, y: (u * [1.0, 0.0] + [0.0, 3.0], y))
    texts = {f.message for f in check_before_fit(held, machine) if "never changes" in f.message}
    assert texts == {"never changes, it is 0.25 of the rated voltage (3 V) throughout"}
    high = check_recordings(with_change(runs[:1], lambda u, y: (20 * u, y)), machine)
    assert any("V, rated 12 V: is the supply in another unit" in f.message for f in high)


def test_a_current_is_reported_in_ampere() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    machine = axis.replace(
        drives=(dataclasses.replace(axis.drives[0], channel="i_A", Ke=0.0, resistance=1.0),)
    )
    time = np.arange(1000) * 1e-3
    inputs = np.where(time > 0.1, 40 * np.sign(np.sin(90 * time)), 0.0)[:, None]
    findings = check_recordings(
        [Recording("r", time, inputs, machine.simulate(time, inputs).outputs)], machine
    )
    assert any(f.message.startswith("reaches 40 A, rated 12 A") for f in findings)


def test_a_set_point_beyond_the_rated_one_may_show_a_rated_one_that_is_too_small() -> None:
    servo = BUILTIN_MACHINES["servo"]()  # rated 1.57 rad
    time = np.arange(1000) * 1e-2
    inputs = np.where(time > 1.0, 1.4 + 1.4 * np.sign(np.sin(2.0 * time)), 0.0)[:, None]
    recording = Recording("r", time, inputs, servo.simulate(time, inputs).outputs)
    (text,) = [f.message for f in check_recordings([recording], servo) if f.message.startswith("reaches 2.8")]
    assert text.endswith("is the column in another unit, or rated_position of the machine file too small?")


def test_motion_in_one_direction_is_advice(hframe: Machine) -> None:
    time = np.arange(1000) * 1e-3
    inputs = np.full((1000, 2), -3.0)
    findings = check_recordings(
        [Recording("push", time, inputs, hframe.simulate(time, inputs).outputs)], hframe
    )
    assert any(f.channel == "y" and "one direction only" in f.message for f in findings)
    assert any(f.channel == "y" and "moves forward 100 %" in f.message for f in findings)


def test_encoders_tell_the_travel_where_a_laser_does_not_measure(
    runs: list[Recording], hframe: Machine
) -> None:
    """Where a laser has no value, as beyond its range, the motion goes on."""
    blind = with_change(runs, lambda u, y: (u, np.where(np.abs(y) > [99, 99, 0.02, 0.02], np.nan, y)))

    def travel(recordings: list[Recording]) -> list[float]:
        texts = [f.message for f in check_recordings(recordings, hframe) if "travels from" in f.message]
        return [float(end) for text in texts for end in re.findall(r"-?\d\.\d+(?:e-\d+)?", text)]

    np.testing.assert_allclose(travel(blind), travel(runs), atol=2e-3)
