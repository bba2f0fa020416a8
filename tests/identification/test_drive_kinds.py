"""Drives that control their current or torque, from the file to identification, environment and control."""

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym import load_machine, make_controller
from hframe_gym.data_validation import check_recordings
from hframe_gym.effects import get_effect
from hframe_gym.errors import InputError
from hframe_gym.identification import identify
from hframe_gym.machine import Coordinate, Drive, Machine, Sensor
from hframe_gym.recordings import Recording, machine_to_dict, save_machine
from tests.reference_simulator.axis import Axis, held_levels, record

ROWS, PERIOD, BANDWIDTH, LIMIT = 1000, 2e-3, 40.0, 1.6
TRUE = Axis(bandwidth_hz=BANDWIDTH, limit_A=LIMIT)
ENCODER = Sensor("phi_rad", {"shaft": 1.0}, 0.0, 2 * np.pi / 20000, "encoder")


def motor(kind: str, inertia: float, viscous: float, coulomb: float, bandwidth: float, limit: float | None) -> Machine:
    shaft = Coordinate("shaft", inertia, viscous, coulomb, "rotary", 0.01)
    Kt, rated = (0.03, 3.0) if kind == "current" else (1.0, 0.09)
    drive = Drive("motor", "command", "shaft", Kt, 0.0, 1.0, 1.0, rated, kind=kind)
    machine = Machine("motor", (shaft,), (), (drive,), (ENCODER,))
    machine = machine.with_effects(get_effect("electrical_lag").at("motor", tau=1.0 / (2.0 * np.pi * bandwidth)))
    return machine if limit is None else machine.with_effects(get_effect("current_limit").at("motor", I=limit))


def runs(kind: str) -> list[Recording]:
    """Return recordings of the independent simulator."""
    recordings = []
    scale = 1.0 if kind == "current" else TRUE.torque_constant
    for run in range(4):
        signs = held_levels(run, ROWS, 10, 2.0)
        motion = record(TRUE, signs, ROWS, PERIOD)
        angle = np.rint(motion.position / ENCODER.resolution) * ENCODER.resolution
        recordings.append(Recording(f"run_{run}", motion.time_s, scale * motion.command[:, None], angle[:, None]))
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


def test_the_file_declares_the_bandwidth_and_refuses_what_the_kind_lacks(tmp_path) -> None:
    import json

    content = machine_to_dict(motor("current", 2e-4, 1e-4, 0.004, 40.0, None))
    content["effects"] = []
    content["drives"][0]["bandwidth"] = {"value": 40.0, "unit": "Hz"}
    path = tmp_path / "motor.json"
    path.write_text(json.dumps(content))
    assert load_machine(path).parameters["electrical_lag@motor.tau"] == pytest.approx(1.0 / (80.0 * np.pi))
    content["drives"][0]["resistance"] = {"value": 1.0, "unit": "ohm"}
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"drives\.motor\.resistance: a drive of the kind 'current' has none"):
        load_machine(path)


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
    controller = make_controller("pid", env)
    errors = []
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        controller.reset()
        for _ in range(150):
            observation, *_ = env.step(controller.act(observation))
        errors.append(np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"]))
    assert max(errors) < 1e-3


@pytest.mark.train
def test_an_agent_trains_by_currents() -> None:
    ppo = pytest.importorskip("stable_baselines3").PPO
    env = gym.make("HFrame-v0", machine=stage(), normalize=True)
    model = ppo("MultiInputPolicy", env, n_steps=128, batch_size=64, n_epochs=1, seed=0, device="cpu").learn(256)
    observation, _ = env.reset(seed=0)
    action, _ = model.predict(observation, deterministic=True)
    assert np.all(np.isfinite(action))
