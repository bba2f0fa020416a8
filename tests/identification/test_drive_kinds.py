"""Kinds of drives (current, torque, duty cycle), from the file to identification, environment and control."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym import load_machine
from hframe_gym.data_validation import check_recordings
from hframe_gym.effects import get_effect
from hframe_gym.errors import InputError
from hframe_gym.identification import SelectionCriteria, identify
from hframe_gym.machine import DRIVE_KINDS, Coordinate, Drive, Machine, Sensor
from hframe_gym.machine.drive_kinds import TorqueDrive
from hframe_gym.recordings import Recording, load_recording, machine_to_dict, save_machine, write_recording
from hframe_gym.recordings.logs.measurement_units import channel_dimension
from tests.identification.control_of_kinds import action_of_a_trained_agent, largest_error_of_pid
from tests.reference_simulator.axis import Axis, Record, held_levels, record

ROWS, PERIOD, BANDWIDTH, LIMIT = 1000, 2e-3, 40.0, 1.6
TRUE = Axis(bandwidth_hz=BANDWIDTH, limit_A=LIMIT)
ENCODER = Sensor("phi_rad", {"shaft": 1.0}, 0.0, 2 * np.pi / 20000, "encoder")


def motor(
    kind: str, inertia: float, viscous: float, coulomb: float, bandwidth: float, limit: float | None
) -> Machine:
    shaft = Coordinate("shaft", inertia, viscous, coulomb, "rotary", 0.01)
    Kt, rated = (0.03, 3.0) if kind == "current" else (1.0, 0.09)
    drive = Drive("motor", "command", "shaft", Kt, 0.0, 1.0, 1.0, rated, kind=kind)
    machine = Machine("motor", (shaft,), (), (drive,), (ENCODER,))
    machine = machine.with_effects(
        get_effect("electrical_lag").at("motor", tau=1.0 / (2.0 * np.pi * bandwidth))
    )
    return (
        machine if limit is None else machine.with_effects(get_effect("current_limit").at("motor", I=limit))
    )


def runs(kind: str) -> list[Recording]:
    """Return recordings of the independent simulator."""
    recordings = []
    scale = 1.0 if kind == "current" else TRUE.torque_constant
    for run in range(4):
        signs = held_levels(run, ROWS, 10, 2.0)
        motion = record(TRUE, signs, ROWS, PERIOD)
        angle = np.rint(motion.position / ENCODER.resolution) * ENCODER.resolution
        recordings.append(
            Recording(f"run_{run}", motion.time_s, scale * motion.command[:, None], angle[:, None])
        )
    return recordings


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["current", "torque"])
def test_identification_finds_inertia_friction_bandwidth_and_limit(kind: str) -> None:
    limit = LIMIT if kind == "current" else LIMIT * TRUE.torque_constant
    declared = motor(kind, 2.6e-4, 5e-5, 0.006, 60.0, 0.9 * limit)
    recordings = runs(kind)
    assert [f for f in check_recordings(recordings, declared) if f.severity == "fault"] == []
    result = identify(recordings, declared)
    found = result.after.machine.parameters
    assert "motor.Ke" not in found
    assert "motor.resistance" not in found
    assert found["shaft.mass"] == pytest.approx(TRUE.inertia, rel=1e-2)
    assert found["shaft.coulomb"] == pytest.approx(TRUE.coulomb, rel=3e-2)
    assert found["electrical_lag@motor.tau"] == pytest.approx(1.0 / (2.0 * np.pi * BANDWIDTH), rel=3e-2)
    assert found["current_limit@motor.I"] == pytest.approx(limit, rel=2e-2)


@pytest.mark.parametrize("kind", ["current", "torque"])
def test_a_machine_file_states_the_kind(kind: str, tmp_path) -> None:
    machine = motor(kind, 2e-4, 1e-4, 0.004, 40.0, None)
    content = machine_to_dict(machine)["drives"][0]
    assert content["kind"] == kind
    assert "Ke" not in content
    assert "resistance" not in content
    assert content[f"rated_{kind}"]["unit"] == {"current": "A", "torque": "Nm"}[kind]
    save_machine(machine, tmp_path / "motor.json")
    assert load_machine(tmp_path / "motor.json").drives == machine.drives


def test_a_registered_kind_that_commands_torques_has_the_torque_constant_of_one(tmp_path) -> None:
    @DRIVE_KINDS.register("servo")
    class Servo(TorqueDrive):
        pass

    try:
        machine = motor("servo", 2e-4, 1e-4, 0.004, 40.0, None)
        assert machine.unit("motor.Kt") == "1"
        save_machine(machine, tmp_path / "motor.json")
        assert load_machine(tmp_path / "motor.json").drives == machine.drives
        assert channel_dimension(machine, "command") == "torque"
    finally:
        DRIVE_KINDS.unregister("servo")


def test_the_file_declares_the_bandwidth_and_refuses_what_the_kind_lacks(tmp_path) -> None:
    content = machine_to_dict(motor("current", 2e-4, 1e-4, 0.004, 40.0, None))
    content["effects"] = []
    content["drives"][0]["bandwidth"] = {"value": 40.0, "unit": "Hz"}
    path = tmp_path / "motor.json"
    path.write_text(json.dumps(content))
    assert load_machine(path).parameters["electrical_lag@motor.tau"] == pytest.approx(1.0 / (80.0 * np.pi))
    content["drives"][0]["resistance"] = {"value": 1.0, "unit": "ohm"}
    path.write_text(json.dumps(content))
    with pytest.raises(
        InputError, match=r"drives\.motor\.resistance: a drive of the kind 'current' has none"
    ):
        load_machine(path)


def duty_motor() -> Machine:
    shaft = Coordinate("shaft", 2.6e-4, 5e-5, 0.006, "rotary", 0.01)
    drive = Drive("motor", "duty_pu", "shaft", 0.03, 0.03, 1.5, 1.0, 12.0, kind="duty-cycle", supply="vbus_V")
    return Machine("motor", (shaft,), (), (drive,), (ENCODER,))


def duty_log(
    path: Path, run: int, header: str = "time_s,duty_pu,vbus_V,phi_rad", full: float = 1.0
) -> Record:
    """Write a run of the independent simulator whose supply sags slowly and with the duty cycle."""
    levels = held_levels(run, ROWS, 40, 0.7)
    duty = np.array([levels(row) for row in range(ROWS)])
    supply = 12.5 - np.linspace(0.0, 2.5, ROWS) - 2.0 * np.abs(duty)
    motion = record(Axis(), lambda row: float(duty[row] * supply[row]), ROWS, PERIOD)
    angle = np.rint(motion.position / ENCODER.resolution) * ENCODER.resolution
    table = np.column_stack([motion.time_s, full * duty, supply, angle])
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header=header, comments="")
    return motion


@pytest.mark.oracle
def test_a_duty_cycle_is_multiplied_by_the_measured_supply(tmp_path) -> None:
    machine = duty_motor()
    motions = [duty_log(tmp_path / f"run_{run}.csv", run) for run in range(4)]
    recordings = [load_recording(tmp_path / f"run_{run}.csv", machine) for run in range(4)]
    for motion, recording in zip(motions, recordings, strict=True):
        np.testing.assert_allclose(recording.inputs[:, 0], motion.command, atol=1e-12)
    assert [f for f in check_recordings(recordings, machine) if f.severity == "fault"] == []
    result = identify(recordings, machine)
    assert result.verdict == "no_effect"
    found = result.after.machine.parameters
    assert found["shaft.mass"] == pytest.approx(2e-4, rel=1e-3)
    assert found["shaft.coulomb"] == pytest.approx(0.004, rel=5e-3)
    # Without the measurement, the sag of the supply remains as an error.
    constant = [
        dataclasses.replace(r, inputs=12.0 * r.inputs / s[:, None]) for r, s in _with_supplies(recordings)
    ]
    refitted = identify(
        constant, machine, criteria=SelectionCriteria(max_effects=0, max_screened_tables=0)
    ).before
    assert refitted.held_out.channels["phi_rad"].noise_ratio > 10.0


def _with_supplies(recordings: list[Recording]) -> list[tuple[Recording, np.ndarray]]:
    """Return each recording with its supply voltage, shape (n,)."""
    pairs = []
    for run, recording in enumerate(recordings):
        levels = held_levels(run, ROWS, 40, 0.7)
        duty = np.abs([levels(row) for row in range(ROWS)])
        pairs.append((recording, 12.5 - np.linspace(0.0, 2.5, ROWS) - 2.0 * duty))
    return pairs


def test_files_have_the_duty_cycle_and_refuse_a_voltage(tmp_path) -> None:
    machine = duty_motor()
    save_machine(machine, tmp_path / "motor.json")
    assert load_machine(tmp_path / "motor.json").drives == machine.drives
    duty_log(tmp_path / "run.csv", 0)
    recording = load_recording(tmp_path / "run.csv", machine)
    write_recording(tmp_path / "written.csv", recording, machine)  # of the rated voltage
    again = load_recording(tmp_path / "written.csv", machine)
    np.testing.assert_allclose(again.inputs, recording.inputs, rtol=1e-15)
    duty_log(tmp_path / "volts.csv", 0, full=12.0)
    with pytest.raises(
        InputError, match=r"volts\.csv, row \d+, column duty_pu: .*is no duty cycle from -1 to 1"
    ):
        load_recording(tmp_path / "volts.csv", machine)


def test_import_maps_duty_cycle_and_supply(tmp_path) -> None:
    machine, out = duty_motor(), tmp_path / "out"
    save_machine(machine, tmp_path / "motor.json")
    motion = duty_log(tmp_path / "log.csv", 0, "Time [s],Duty [%],Battery [V],phi [rad]", 100.0)
    arguments = ["import", "log.csv", "--machine", "motor.json", "--out", str(out)]
    arguments += ["--map", "duty_pu=Duty [%]", "--map", "vbus_V=Battery [V]"]
    run = subprocess.run(
        [sys.executable, "-m", "hframe_gym", *arguments], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr
    (written,) = out.glob("*.csv*")
    recording = load_recording(written, machine)
    np.testing.assert_allclose(recording.inputs[:, 0], motion.command, rtol=1e-12, atol=1e-12)


def test_the_environment_of_duty_cycles_has_the_rated_supply() -> None:
    machine = load_machine("hframe")
    drives = [dataclasses.replace(d, kind="duty-cycle", supply="vbus_V") for d in machine.drives]
    actions = [np.array([0.3, -0.1], np.float32)] * 5
    envs = [gym.make("HFrame-v0", machine=m) for m in (machine, machine.replace(drives=tuple(drives)))]
    ends = []
    for env in envs:
        env.reset(seed=0)
        ends.append([env.step(action)[0]["observation"] for action in actions][-1])
    np.testing.assert_array_equal(*ends)


def stage() -> Machine:
    machine = load_machine("hframe")
    drives = [
        Drive(d.name, f"i{j}_A", d.coordinate, d.Kt, 0.0, 1.0, d.gear_ratio, 12.0, kind="current")
        for j, d in enumerate(machine.drives, start=1)
    ]
    machine = machine.replace(drives=tuple(drives))
    return machine.with_effects(*(get_effect("electrical_lag").at(d.name, tau=5e-4) for d in drives))


@pytest.mark.integration
def test_a_controller_reaches_the_goal_by_currents() -> None:
    env = gym.make("HFrame-v0", machine=stage(), randomize="default")
    assert largest_error_of_pid(env, 150) < 1e-3  # m


@pytest.mark.train
def test_an_agent_trains_by_currents() -> None:
    env = gym.make("HFrame-v0", machine=stage(), normalize=True)
    assert np.all(np.isfinite(action_of_a_trained_agent(env)))
