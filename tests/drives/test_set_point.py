"""Drives that follow a set point: against the independent simulator, from the file to control."""

import dataclasses
import json

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym import load_machine, make_controller, simulate
from hframe_gym.data_validation import check_recordings
from hframe_gym.errors import InputError
from hframe_gym.identification import SelectionCriteria, identify, prepare
from hframe_gym.identification.fit.estimation import fit
from hframe_gym.identification.fit.plain_fit import better_start, plain_fit
from hframe_gym.identification.fit.run_differences import find_run_differences
from hframe_gym.identification.predict.free_parameters import default_free_parameters
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.machine import Coordinate, Drive, Machine, Sensor
from hframe_gym.recordings import (
    ImportSettings,
    MappingOptions,
    Recording,
    import_logs,
    load_recording,
    machine_to_dict,
    open_logs,
    propose_columns,
    save_machine,
)
from tests.dynamics.test_reference_step import largest_difference
from tests.reference_simulator.axis import Axis, Servo, held_levels, record

ROWS, PERIOD = 500, 5e-3
KT = 0.02  # Nm/A
# An industrial drive of the speed behind a gear, and a hobby servo: a proportional-derivative loop of the
# position.
SERVOS = {
    "speed": Servo(speed_gain=2e-3, reset_time=0.05, largest_torque=0.03, gear=3.0),
    "position": Servo(position_gain=25.0, speed_gain=2e-3, largest_torque=0.03, gear=3.0),
}
LARGEST = {"speed": 15.0, "position": 1.2}  # rad/s, rad
SENSORS = {
    "speed": Sensor("phi_rad", {"shaft": 1.0}, 0.0, 2 * np.pi / 4096, "encoder"),
    "position": Sensor("phi_rad", {"shaft": 1.0}, 0.0, 2 * np.pi / 4096),
}


def servo_machine(kind: str, servo: Servo, sensor: Sensor | None = None) -> Machine:
    shaft = Coordinate("shaft", 2e-4, 1e-4, 0.004, "rotary", 0.01)
    law = {
        "speed_gain": servo.speed_gain,
        "integral_rate": 1.0 / servo.reset_time,
        "torque_limit": servo.largest_torque,
    }
    if kind == "position":
        law["position_gain"] = servo.position_gain
        if np.isfinite(servo.largest_speed):
            law["speed_limit"] = servo.largest_speed
    drive = Drive(
        "motor", "command", "shaft", 1.0, 0.0, 1.0, servo.gear, LARGEST[kind], kind=kind, law_parameters=law
    )
    return Machine("servo", (shaft,), (), (drive,), (sensor or SENSORS[kind],))


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "servo"),
    [
        ("speed", SERVOS["speed"]),
        ("position", Servo(25.0, 12.0, 2e-3, 0.1, 0.03, 3.0)),  # all limits and the integral act
    ],
)
def test_the_motion_is_that_of_the_independent_simulator(kind: str, servo: Servo) -> None:
    motion = record(Axis(servo=servo), held_levels(1, 400, 20, LARGEST[kind]), 400, PERIOD)
    limited = np.mean(np.abs(motion.current) > 0.999 * servo.largest_torque)
    assert 0.05 < limited < 0.6
    simulated = simulate(servo_machine(kind, servo), motion.time_s, motion.command[:, None])
    assert np.abs(simulated.positions[:, 0] - motion.position).max() < 3e-4 * np.ptp(motion.position)
    assert np.abs(simulated.velocities[:, 0] - motion.speed).max() < 5e-4 * np.ptp(motion.speed)


@pytest.mark.parametrize("kind", ["speed", "position"])
def test_the_generated_step_is_the_specified_one(kind: str) -> None:
    machine = servo_machine(kind, Servo(25.0, 12.0, 2e-3, 0.1, 0.03, 3.0))
    assert largest_difference(machine) < 1e-12


def test_a_torque_limit_that_every_row_reaches_and_leaves_needs_no_short_steps() -> None:
    """A printer's motors follow positions held for 1 ms, each of which needs more than their torque."""
    servo = Servo(position_gain=5000.0, speed_gain=5e-3, largest_torque=0.6)
    machine = servo_machine("position", servo).replace({"shaft.mass": 2e-5})
    time_s = 1e-3 * np.arange(300)
    command = np.interp(time_s, [0.0, 0.05, 0.15, 0.2, 0.3], [0.0, 0.0, 5.0, 5.0, -2.5])[:, None]
    fine, usual = (simulate(machine, time_s, command, longest_step=h).velocities for h in (5e-6, 0.25e-3))
    assert np.std(usual - fine) < 8e-3 * np.std(fine)  # 14e-3 with the torque in the middle of each step


def recordings_of(kind: str, servo: Servo, sensors: tuple[Sensor, ...]) -> list[Recording]:
    """Return recordings of the independent simulator with rounded angles and currents."""
    recordings = []
    for run in range(4):
        motion = record(Axis(servo=servo), held_levels(run, ROWS, 40, LARGEST[kind]), ROWS, PERIOD)
        measured = [motion.position, motion.current / KT][: len(sensors)]
        columns = [np.rint(m / s.resolution) * s.resolution for m, s in zip(measured, sensors, strict=True)]
        recordings.append(
            Recording(f"run_{run}", motion.time_s, motion.command[:, None], np.column_stack(columns))
        )
    return recordings


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["speed", "position"])
def test_identification_finds_gains_inertia_friction_and_limit(kind: str) -> None:
    # The hobby servo reports its current, which determines the unit of force.
    sensors = (SENSORS[kind], Sensor("i_A", {"motor": 1.0 / KT}, 0.0, 0.02, "current"))
    sensors = sensors if kind == "position" else sensors[:1]
    recordings = recordings_of(kind, SERVOS[kind], sensors)
    machine = servo_machine(kind, SERVOS[kind]).replace(sensors=sensors)
    true = machine.parameters
    wrong = {"shaft.mass": 1.3, "shaft.coulomb": 1.4, "motor.torque_limit": 0.75}
    if kind == "speed":
        wrong["motor.integral_rate"] = 0.7
    else:
        wrong |= {"motor.position_gain": 0.7, "motor.speed_gain": 1.3}
    declared = machine.replace({name: f * true[name] for name, f in wrong.items()})
    assert [f for f in check_recordings(recordings, declared) if f.severity == "fault"] == []
    result = identify(recordings, declared)
    assert result.verdict == "no_effect"
    found = result.after.machine.parameters
    for name in wrong:
        assert found[name] == pytest.approx(true[name], rel=1e-2), name
    if kind == "speed":  # without a current, this gain sets the unit of force
        assert found["motor.speed_gain"] == true["motor.speed_gain"]
    assert result.after.held_out.channels["phi_rad"].noise_ratio < 1.2


@pytest.mark.parametrize("kind", ["speed", "position"])
def test_a_machine_file_states_kind_and_gains(kind: str, tmp_path) -> None:
    machine = servo_machine(kind, SERVOS[kind])
    content = machine_to_dict(machine)["drives"][0]
    assert content["kind"] == kind
    assert content[f"rated_{kind}"]["unit"] == {"speed": "rad/s", "position": "rad"}[kind]
    assert "Kt" not in content
    assert "speed_limit" not in content["parameters"]  # a default
    save_machine(machine, tmp_path / "servo.json")
    assert load_machine(tmp_path / "servo.json").drives == machine.drives


@pytest.mark.parametrize(
    ("kind", "header", "factor"),
    [("position", "goal [deg]", 180.0 / np.pi), ("speed", "velocity command [rpm]", 30.0 / np.pi)],
)
def test_import_takes_the_set_point_and_not_the_measurement(
    kind: str, header: str, factor: float, tmp_path
) -> None:
    machine, time_s = servo_machine(kind, SERVOS[kind]), np.arange(60) * PERIOD
    command, angle = np.sin(7.0 * time_s), np.sin(5.0 * time_s)
    table = np.column_stack([time_s, angle, factor * command])
    names = f"time [s],angle [rad],{header}"
    np.savetxt(tmp_path / "log.csv", table, fmt="%.17g", delimiter=",", header=names, comments="")
    (log,) = open_logs(tmp_path / "log.csv")
    assert propose_columns(log, machine).proposed == {"command": header, "phi_rad": "angle [rad]"}
    settings = ImportSettings(MappingOptions({"command": header, "phi_rad": "angle [rad]"}))
    (written,) = import_logs(tmp_path / "log.csv", tmp_path / "out", machine, settings, lambda line: None)
    recording = load_recording(written, machine)
    np.testing.assert_allclose(recording.inputs[:, 0], command, atol=1e-12)
    np.testing.assert_allclose(recording.outputs[:, 0], angle, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parameters": {}}, r"drives\.motor\.parameters\.position_gain: missing"),
        ({"Kt": {"value": 1.0, "unit": "1"}}, r"drives\.motor\.Kt: a drive of the kind 'position' has none"),
        (
            {"current_limit": {"value": 1.0, "unit": "A"}},
            r"drives\.motor\.current_limit: a drive of the kind 'position' has none",
        ),
        ({"rated_position": {"value": 1.0, "unit": "m"}}, r"rated_position: unit is 'm', must be 'rad'"),
    ],
)
def test_the_file_refuses_what_the_kind_lacks(change: dict, message: str, tmp_path) -> None:
    content = machine_to_dict(servo_machine("position", SERVOS["position"]))
    content["drives"][0] |= change
    (tmp_path / "servo.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        load_machine(tmp_path / "servo.json")


def test_unknown_and_wrong_parameters_of_the_law_are_named(tmp_path) -> None:
    content = machine_to_dict(servo_machine("position", SERVOS["position"]))
    parameters = content["drives"][0]["parameters"]
    parameters["gain"] = {"value": 1.0, "unit": "1"}
    (tmp_path / "servo.json").write_text(json.dumps(content))
    with pytest.raises(
        InputError, match=r"parameters\.gain: the kind 'position' has no such parameter; it has"
    ):
        load_machine(tmp_path / "servo.json")
    del parameters["gain"]
    parameters["speed_gain"]["value"] = -1.0
    (tmp_path / "servo.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"drives\.motor\.parameters: .*speed_gain = -1 is outside"):
        load_machine(tmp_path / "servo.json")


@pytest.mark.integration
@pytest.mark.parametrize("kind", ["position", "speed"])
def test_a_servo_turns_to_its_goal(kind: str) -> None:
    machine = servo_machine(kind, SERVOS[kind])
    shaft = dataclasses.replace(machine.coordinates[0], range=(-1.2, 1.2))
    env = gym.make("HFrame-v0", machine=machine.replace(coordinates=(shaft,)), randomize="default")
    controller = make_controller("set-point", env)
    observation, _ = env.reset(seed=2)
    for _ in range(60):
        observation, *_ = env.step(controller.act(observation))
    # Without an integral, friction holds the shaft within Coulomb friction over stiffness, 9 mrad.
    error = abs(float((observation["achieved_goal"] - observation["desired_goal"])[0]))
    assert error < (0.02 if kind == "position" else 1e-3)


def test_the_friction_that_differs_between_runs_is_found():
    servo, sensor = SERVOS["position"], SENSORS["position"]
    machine, recordings = servo_machine("position", servo), []
    for run, dry in enumerate((0.003, 0.006, 0.009)):
        motion = record(Axis(servo=servo, coulomb=dry), held_levels(run, 400, 40, 1.0), 400, PERIOD)
        angle = np.rint(motion.position / sensor.resolution) * sensor.resolution
        recordings.append(Recording(f"run_{run}", motion.time_s, motion.command[:, None], angle[:, None]))
    data = prepare(recordings, machine)
    fitted = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    found = find_run_differences(fitted, data, SelectionCriteria())
    assert found is not None
    assert found.quantity.name == "shaft.coulomb"
    assert list(found.amounts.values()) == pytest.approx([0.0, np.log(2.0), np.log(3.0)], abs=0.1)


def displaced_runs(first_row: int, place: float = 5.0) -> tuple[Machine, list[Recording]]:
    """Return a servo and its runs from a row on; commands around a place, rad; an encoder with 2 rad more."""
    servo, sensor, recordings = SERVOS["position"], SENSORS["speed"], []
    for run in range(3):
        motion = record(Axis(servo=servo), held_levels(run, 400, 40, 1.0), 400, PERIOD)
        angle = np.rint((motion.position + place + 2.0) / sensor.resolution) * sensor.resolution
        columns = (motion.time_s, motion.command[:, None] + place, angle[:, None])
        recordings.append(Recording(f"run_{run}", *(column[first_row:] for column in columns)))
    return servo_machine("position", servo, sensor), recordings


@pytest.mark.parametrize(("first_row", "tolerance"), [(0, 0.03), (100, 0.3)])
def test_an_encoder_counts_from_the_place_that_the_command_holds(first_row, tolerance):
    machine, recordings = displaced_runs(first_row)
    initial = prepare(recordings, machine).runs[0].initial
    assert initial.zeros == pytest.approx([2.0], abs=tolerance)
    assert initial.position == pytest.approx(recordings[0].outputs[0] - 2.0, abs=tolerance)


def test_a_command_far_from_zero_is_no_wrong_unit():
    machine, recordings = displaced_runs(0, 500.0)
    found = check_recordings(recordings, machine)
    assert not [f for f in found if f.channel == "phi_rad" and f.severity != "note"]


def test_a_refit_starts_from_the_output_error_fit_where_the_file_is_wrong_by_a_factor():
    servo, sensors = SERVOS["position"], (SENSORS["position"],)
    declared = servo_machine("position", servo).replace({"shaft.mass": 2e-5, "shaft.coulomb": 4e-4})
    run = recordings_of("position", servo, sensors)[0]
    data = prepare([Recording("run", run.time_s[:200], run.inputs[:200], run.outputs[:200])], declared)
    plain = plain_fit(declared, data)
    assert plain is not None
    start = better_start(declared, data, plain)
    assert start.parameters["shaft.mass"] == pytest.approx(2e-4, rel=0.1)
    assert not start.effects
