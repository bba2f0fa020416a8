"""Wiring: planted swaps, signs, units and radii are named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.data_validation import check_before_fit, check_recordings
from hframe_gym.machine import BUILTIN_MACHINES, Belt, Coordinate, Drive, Machine, Sensor
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import (
    PHI1,
    PHI2,
    Array,
    X,
    Y,
    faults,
    measure,
    with_change,
    with_column,
)

REMEDY = "correct the columns of the file, or the declaration in machine.json"


@pytest.mark.parametrize("column", [PHI1, PHI2, X, Y])
def test_a_channel_that_counts_backwards_is_named(
    column: int, runs: list[Recording], hframe: Machine
) -> None:
    lines = faults(check_recordings(with_column(runs, column, lambda y: -y), hframe))
    assert lines == [f"fault: {hframe.output_channels[column]} has the wrong sign: {REMEDY}"]


@pytest.mark.parametrize(
    ("pair", "names"), [((PHI1, PHI2), "phi1_rad and phi2_rad"), ((X, Y), "x_m and y_m")]
)
def test_swapped_outputs_are_named(
    pair: tuple[int, int], names: str, runs: list[Recording], hframe: Machine
) -> None:
    def swap(u: Array, y: Array) -> tuple[Array, Array]:
        y[:, list(pair)] = y[:, list(reversed(pair))]
        return u, y

    assert f"fault: {names} are swapped: {REMEDY}" in faults(
        check_recordings(with_change(runs, swap), hframe)
    )


def test_swapped_outputs_of_runs_in_different_directions_are_no_run_in_another_unit(hframe: Machine) -> None:
    """The ratio of the swapped sensors differs between runs in which one or the other motor pulls more."""
    time_s = 0.002 * np.arange(1000)
    ramp = np.where(time_s > 0.1, 2.1 * (time_s - 0.1), 0.0)
    runs = []
    for k, pulls in enumerate([(1.0, 0.0), (0.9, 0.0), (0.8, 0.1), (0.1, 1.0)]):
        volts = np.outer(ramp, pulls)
        outputs = measure(hframe, hframe.simulate(time_s, volts).outputs, seed=k)
        runs.append(Recording(f"run_{k}", time_s, volts, outputs))
    assert faults(check_recordings(runs, hframe)) == []
    swapped = with_change(runs, lambda u, y: (u, y[:, [PHI2, PHI1, X, Y]]))
    assert faults(check_recordings(swapped, hframe)) == [
        f"fault: phi1_rad and phi2_rad are swapped: {REMEDY}"
    ]


def test_a_motor_with_the_wrong_sign_and_swapped_motors_are_named(
    runs: list[Recording], hframe: Machine
) -> None:
    negated = with_change(runs, lambda u, y: (u * [1.0, -1.0], y))
    assert faults(check_recordings(negated, hframe)) == [f"fault: v2_V has the wrong sign: {REMEDY}"]
    swapped = with_change(runs, lambda u, y: (u[:, ::-1], y))
    assert faults(check_recordings(swapped, hframe)) == [f"fault: v1_V and v2_V are swapped: {REMEDY}"]


def test_on_a_single_axis_the_sign_of_sensor_and_motor_cannot_be_distinguished() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    time = np.arange(2000) * 1e-3
    inputs = np.where(time > 0.1, 4 * np.sign(np.sin(9 * time)), 0.0)[:, None]
    outputs = axis.simulate(time, inputs).outputs
    assert faults(check_recordings([Recording("r", time, inputs, outputs)], axis)) == []
    lines = faults(check_recordings([Recording("r", time, inputs, -outputs)], axis))
    assert lines == [f"fault: x_m has the wrong sign or v_V has the wrong sign: {REMEDY}"]


@pytest.mark.parametrize(
    ("column", "factor", "unit"), [(Y, 1000.0, "millimeters"), (PHI1, 57.2958, "degrees")]
)
def test_a_wrong_unit_is_named(
    column: int, factor: float, unit: str, runs: list[Recording], hframe: Machine
) -> None:
    lines = faults(check_recordings(with_column(runs, column, lambda y: factor * y), hframe))
    assert any(hframe.output_channels[column] in line and unit in line for line in lines)


def test_the_name_of_a_channel_decides_which_unit_is_suspected(
    runs: list[Recording], hframe: Machine
) -> None:
    first, *others = hframe.sensors
    machine = hframe.replace(sensors=(dataclasses.replace(first, channel="belt_m"), *others))
    lines = faults(check_recordings(with_column(runs, PHI1, lambda y: 57.3 * y), machine))
    assert any("belt_m: moves" in line for line in lines)
    assert not any("degrees" in line for line in lines)


@pytest.mark.parametrize("factor", [20.0, 40.0, 57.3, 1000.0])
def test_degrees_are_never_suspected_in_a_column_in_meters(
    factor: float, runs: list[Recording], hframe: Machine
) -> None:
    lines = faults(check_recordings(with_column(runs, Y, lambda y: factor * y), hframe))
    assert any("y_m: moves" in line for line in lines)
    assert not any("degrees" in line for line in lines)


def test_a_single_run_with_a_wrong_sign_is_named(runs: list[Recording], hframe: Machine) -> None:
    one = [*runs[:2], *with_column(runs[2:3], X, lambda y: -y), *runs[3:]]
    assert faults(check_before_fit(one, hframe)) == [f"fault: run_03: x_m has the wrong sign: {REMEDY}"]


def test_a_machine_that_hardly_moves_as_simulated_has_no_certain_fault(hframe: Machine) -> None:
    """Friction of three times the declared one: speeds are a small fraction of the simulated ones."""
    friction = {
        f"{name}.coulomb": 3 * hframe.parameters[f"{name}.coulomb"] for name in ("x", "y", "phi1", "phi2")
    }
    machine = hframe.replace(friction)
    time = np.arange(2000) * 1e-3
    inputs = np.column_stack([4 * np.sin(9 * time), 3 * np.sin(7 * time)])
    outputs = measure(machine, machine.simulate(time, inputs).outputs)
    assert faults(check_before_fit([Recording("r", time, inputs, outputs)], hframe)) == []


def test_a_pulley_of_another_radius_is_measured(runs: list[Recording], hframe: Machine) -> None:
    larger = with_change(runs, lambda u, y: (u, y / [1.05, 1.05, 1.0, 1.0]))
    findings = [f for f in check_recordings(larger, hframe) if "a radius of" in f.message]
    assert {f.severity for f in findings} == {"advice"}  # a scale error of the lasers looks alike
    assert [f.channel for f in findings] == ["phi1_rad", "phi2_rad"]
    radii = [float(f.message.split("a radius of ")[1].split(" m")[0]) for f in findings]
    np.testing.assert_allclose(radii, 1.05 * 0.0194, rtol=3e-3)


@pytest.mark.parametrize(
    ("factor", "text"),
    [(3.0, "moves 3 times as far"), (1.1, "moves 10.0 % too far"), (0.9, "moves 10.0 % too little")],
)
def test_an_encoder_that_contradicts_a_scale_is_named(factor: float, text: str) -> None:
    """A gear ratio that nobody converted is a fault; a small error may be one of the scale."""
    axis = BUILTIN_MACHINES["axis"]()
    scale = axis.sensors[0]
    encoder = dataclasses.replace(scale, channel="x_encoder_m", kind="encoder", noise=0.0, resolution=1e-6)
    machine = axis.replace(sensors=(encoder, dataclasses.replace(scale, kind="laser")))
    time = np.arange(2000) * 1e-3
    inputs = np.where(time > 0.1, 4 * np.sign(np.sin(9 * time)), 0.0)[:, None]
    outputs = machine.simulate(time, inputs).outputs * [factor, 1.0]
    findings = check_recordings([Recording("r", time, inputs, outputs)], machine)
    [finding] = [f for f in findings if text in f.message]
    assert finding.channel == "x_encoder_m"
    assert finding.severity == ("fault" if factor == 3.0 else "advice")


@pytest.mark.parametrize("rows", [17, 50])
def test_the_sign_of_a_sensor_that_is_slower_than_the_log_is_checked(rows: int) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    time = np.arange(4000) * 2e-3
    inputs = np.where(time > 0.1, 4 * np.sign(np.sin(3 * time)), 0.0)[:, None]
    outputs = np.full((4000, 1), np.nan)
    outputs[::rows] = -axis.simulate(time, inputs).outputs[::rows]
    findings = check_recordings([Recording("r", time, inputs, outputs)], axis)
    assert faults(findings) == [f"fault: x_m has the wrong sign or v_V has the wrong sign: {REMEDY}"]
    assert any(f.channel == "x" and f.message.startswith("speeds up to 0.8 m/s") for f in findings)


@pytest.mark.parametrize(("sign", "named"), [(1.0, False), (-1.0, True)])
def test_two_inertias_on_an_elastic_shaft_turn_together(sign: float, named: bool) -> None:
    """Above the resonance, the load moves against the motor, and their sum explains less of the torque."""
    rotor, load = (
        Coordinate(n, m, 1e-3, 0.01, kind="rotary") for n, m in (("rotor", 5e-4), ("load", 1.5e-3))
    )
    shaft = Belt("shaft", 4.0, 1.0, {"rotor": 1.0, "load": -1.0})
    sensors = tuple(Sensor(f"{n}_rad", {n: 1.0}, 0.0, 4e-4, kind="encoder") for n in ("rotor", "load"))
    drive = Drive("motor", "torque_Nm", "rotor", 1.0, 0.0, 1.0, 1.0, rated_voltage=0.5)
    machine = Machine("elastic-shaft", (rotor, load), (shaft,), (drive,), sensors)
    time_s = np.arange(3000) * 1e-3
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, (14, 1))
    torque = 0.09 * np.sin(2.0 * np.pi * np.geomspace(0.6, 35.0, 14)[:, None] * time_s + phases).sum(axis=0)
    torque[time_s < 0.15] = 0.0
    outputs = measure(machine, machine.simulate(time_s, torque[:, None]).outputs) * [1.0, sign]
    recording = Recording("run_1", time_s, torque[:, None], outputs)
    found = faults(check_recordings([recording], machine))
    assert any("load_rad has the wrong sign" in line for line in found) == named
    assert bool(found) == named
