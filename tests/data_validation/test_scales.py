"""Units within reach of a wrong gain, encoders that contradict each other, clocks, speeds as positions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.data_validation import Finding, check_before_fit
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Coordinate, Drive, Machine, Sensor
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import Array, faults, measure

TURN = 2 * np.pi


def motor() -> Machine:
    """Return a motor with an encoder, whose file is right within 30 %."""
    return Machine(
        name="motor",
        belts=(),
        coordinates=(Coordinate("shaft", 5e-4, 1e-4, 0.01, "rotary", 0.02),),
        drives=(
            Drive(
                "motor", "u_V", "shaft", Kt=0.05, Ke=0.05, resistance=2.0, gear_ratio=1.0, rated_voltage=12.0
            ),
        ),
        sensors=(Sensor("angle_rad", {"shaft": 1.0}, resolution=1.5e-3, kind="encoder"),),
    )


def motor_runs(scale: float, *, clock: float = 1.0, machine: Machine | None = None) -> list[Recording]:
    """Return runs of a motor of 30 % more inertia with steps of the voltage; angles and times are scaled."""
    rig = machine or motor().replace({"shaft.mass": 6.5e-4})
    rng = np.random.default_rng(0)
    runs = []
    for k in range(3):
        time = np.arange(1500) * 2e-3
        volts = np.repeat(rng.uniform(-8.0, 8.0, 15), 100)[:, None] * (time > 0.2)[:, None]
        outputs = measure(rig, rig.simulate(time, volts).outputs)
        runs.append(Recording(f"run_{k}", clock * (10.0 * k + time), volts, scale * outputs))
    return runs


def of_channel(findings: list[Finding], channel: str) -> list[Finding]:
    """Return faults and advice about a channel."""
    return [f for f in findings if f.channel == channel and f.severity != "note"]


def test_right_units_are_not_suspected() -> None:
    assert check_before_fit(motor_runs(1.0), motor()) == []


def without_resolution() -> Machine:
    machine = motor()
    return dataclasses.replace(machine, sensors=(dataclasses.replace(machine.sensors[0], resolution=0.0),))


def test_turns_are_suspected_but_may_be_a_wrong_gain() -> None:
    [advice] = of_channel(check_before_fit(motor_runs(1 / TURN), without_resolution()), "angle_rad")
    assert advice.severity == "advice"
    assert (
        "slower than the machine simulates in all 3 runs: is the column in turns, not in rad?"
        in advice.message
    )
    assert "Then multiply it by 6.283; otherwise a gain" in advice.message


def test_steps_of_the_declared_resolution_tell_turns_from_a_wrong_gear() -> None:
    """A gear of 2 pi before the encoder moves it as far as turns, but by steps of the declared resolution."""
    [turns] = of_channel(check_before_fit(motor_runs(1 / TURN), motor()), "angle_rad")
    assert "multiply it by 6.283, which makes its steps those of the declared resolution" in turns.message
    geared = []
    for run in motor_runs(1 / TURN):
        steps = np.round(run.outputs / 1.5e-3) * 1.5e-3
        geared.append(dataclasses.replace(run, outputs=steps))
    [gear] = of_channel(check_before_fit(geared, motor()), "angle_rad")
    assert gear.severity == "advice"
    assert "its steps are those of the declared resolution, in rad: a gain, a mass or a gear" in gear.message
    assert "Then multiply" not in gear.message


def test_degrees_with_steps_of_the_declared_resolution_are_no_fault() -> None:
    """A gear ratio that is wrong by 57 explains them as well."""
    machine = motor()
    coarse = dataclasses.replace(machine.sensors[0], resolution=1.5e-3 * 360.0 / TURN)
    findings = check_before_fit(motor_runs(360.0 / TURN), dataclasses.replace(machine, sensors=(coarse,)))
    [advice] = of_channel(findings, "angle_rad")
    assert advice.severity == "advice"


def test_a_motion_that_a_spring_restrains_is_not_in_turns() -> None:
    """The spring reduces the speed 6 times; inertia and friction agree with the machine file."""
    machine = motor()
    spring = machine.with_effects(EFFECTS["cable_spring"].at("shaft", k=0.4, q0=0.0))
    findings = check_before_fit(motor_runs(1.0, machine=spring), machine)
    assert not any("turns" in finding.message for finding in findings)


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (360.0 / TURN, "degrees, not in rad"),
        (10000 / TURN, "counts of an encoder (about"),
        (
            1 / 1.5e-3,
            "counts of an encoder, of the declared resolution, not in rad? Then multiply it by 0.0015",
        ),
    ],
)
def test_a_unit_far_from_any_gain_is_a_fault_if_inertia_and_friction_agree(factor: float, unit: str) -> None:
    [line] = faults(check_before_fit(motor_runs(factor), motor()))
    assert "angle_rad: moves" in line
    assert unit in line


def test_a_factor_of_no_unit_is_advice() -> None:
    [advice] = of_channel(check_before_fit(motor_runs(15.0), motor()), "angle_rad")
    assert advice.severity == "advice"
    assert (
        "times as fast as a simulation with the machine file: is its unit or gain wrong, or" in advice.message
    )


@pytest.mark.parametrize(("factor", "slower"), [(0.06, "19 times slower"), (2.2e-4, "5,300 times slower")])
def test_a_motion_that_hardly_follows_is_stated_in_plain_numbers(factor: float, slower: str) -> None:
    [advice] = of_channel(check_before_fit(motor_runs(factor), motor()), "angle_rad")
    assert advice.message.startswith(f"moves {slower} than a simulation with the machine file: is its unit")


@pytest.mark.parametrize("clock", [10.0, 0.1])
def test_times_in_a_wrong_unit_are_suspected_from_inertia_and_friction(clock: float) -> None:
    [advice] = of_channel(check_before_fit(motor_runs(1.0, clock=clock), motor()), "time_s")
    assert advice.severity == "advice"
    assert f"the times may be 10 times too {'long' if clock > 1 else 'short'}" in advice.message
    rate = 1.0 / np.median(np.diff(motor_runs(1.0)[0].time_s))
    assert advice.message.endswith(f"--map time_s={rate:.4g}Hz")


def test_a_speed_in_place_of_an_angle_is_named() -> None:
    runs = []
    for run in motor_runs(1.0):
        speed = np.gradient(run.outputs[:, 0], run.time_s) * 60 / TURN  # rpm
        smooth = np.convolve(speed, np.full(11, 1 / 11), "same")
        runs.append(dataclasses.replace(run, outputs=smooth[:, None]))
    [advice] = of_channel(check_before_fit(runs, motor()), "angle_rad")
    assert "looks like a speed, not like a position" in advice.message
    assert "--unit angle_rad=rpm" in advice.message


def two_encoders() -> Machine:
    """Return an axis whose position two encoders measure."""
    axis = BUILTIN_MACHINES["axis"]()
    scale = dataclasses.replace(axis.sensors[0], kind="encoder", noise=0.0, resolution=1e-6)
    return axis.replace(sensors=(scale, dataclasses.replace(scale, channel="motor_m")))


def two_encoder_runs(factors: Array) -> list[Recording]:
    """Return runs of the axis with scaled encoders."""
    machine, time = two_encoders(), np.arange(2000) * 1e-3
    volts = np.where(time > 0.1, 4 * np.sign(np.sin(9 * time)), 0.0)[:, None]
    return [Recording("run", time, volts, machine.simulate(time, volts).outputs * factors)]


@pytest.mark.parametrize("factors", [[2.0, 1.0], [1.0, 0.25], [1.0, 4.0]])
def test_one_of_two_encoders_with_a_wrong_scale_is_a_fault(factors: list[float]) -> None:
    """Counted edges are quadrupled in one place and not in the other."""
    [line] = faults(check_before_fit(two_encoder_runs(np.array(factors)), two_encoders()))
    wrong, right = ("x_m", "motor_m") if factors[0] != 1.0 else ("motor_m", "x_m")
    ratio = max(factors) if max(factors) > 1.0 else min(factors)
    assert line.startswith(f"fault: {wrong}: moves {ratio:g} times as far as {right} measures: a unit")


def test_two_encoders_that_agree_are_no_finding() -> None:
    assert check_before_fit(two_encoder_runs(np.array([1.0, 1.0])), two_encoders()) == []


def test_a_small_deviation_of_two_encoders_is_advice() -> None:
    [advice] = check_before_fit(two_encoder_runs(np.array([1.0, 1.08])), two_encoders())
    assert (advice.severity, advice.channel) == ("advice", "motor_m")
    assert "8.0 % too far for what other sensors measure" in advice.message
