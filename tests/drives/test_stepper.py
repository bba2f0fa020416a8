"""Stepper motors: against the independent simulator, from file to control; the sine alone loses steps."""

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym import load_machine, make_controller, simulate
from hframe_gym.controllers.set_point import SetPointController
from hframe_gym.data_validation import check_recordings
from hframe_gym.identification import identify
from hframe_gym.machine import Coordinate, Drive, Machine, Sensor, rest_positions_per_axis
from hframe_gym.recordings import Recording, machine_to_dict, save_machine
from tests.dynamics.test_reference_step import largest_difference
from tests.reference_simulator.axis import Axis, Record, Stepper, record

ROWS, PERIOD = 500, 1e-3
FULL_STEP = 2 * np.pi / 200  # rad
HOLDING = 0.4  # Nm
TRUE = Axis(inertia=1.5e-4, viscous=1e-3, coulomb=0.02, servo=Stepper(HOLDING, gear=2.0))
RESOLUTION = 2 * np.pi / 16384


def stepper() -> Machine:
    shaft = Coordinate("shaft", TRUE.inertia, TRUE.viscous, TRUE.coulomb, "rotary", 0.0064)
    return Machine(
        "stepper",
        (shaft,),
        (),
        (drive("motor", "shaft", 2.0, 12.0),),
        (Sensor("phi_rad", {"shaft": 1.0}, 0.0, RESOLUTION),),
    )


def drive(name: str, coordinate: str, gear: float, rated: float) -> Drive:
    law = {"holding_torque": HOLDING}
    return Drive(
        name, f"{name}_command", coordinate, 1.0, 0.0, 1.0, gear, rated, kind="stepper", law_parameters=law
    )


def ramps(seed: int) -> np.ndarray:
    """Return commanded angles of random speeds, rad, with limited acceleration, after 50 rows at rest."""
    generator = np.random.default_rng(seed)
    speeds = np.repeat(generator.uniform(-6.0, 6.0, ROWS // 90 + 1), 90)[: ROWS - 50]
    speed, moved = 0.0, [0.0] * 50
    for wanted in speeds:
        speed += np.clip(wanted - speed, -0.3, 0.3)
        moved.append(moved[-1] + speed * PERIOD)
    return np.array(moved)


def motion(command: np.ndarray) -> Record:
    return record(TRUE, lambda row: float(command[row]), len(command), PERIOD)


@pytest.mark.oracle
def test_the_rotor_follows_ramps_as_in_the_independent_simulator() -> None:
    expected = motion(ramps(1))
    found = simulate(stepper(), expected.time_s, expected.command[:, None]).positions[:, 0]
    assert np.ptp(found) > 0.3
    assert np.abs(found - expected.command).max() < 0.5 * FULL_STEP  # no step is lost
    assert np.abs(found - expected.position).max() < 0.02 * FULL_STEP


@pytest.mark.oracle
@pytest.mark.parametrize(("jump", "lost"), [(1.5, 0), (3.0, 4), (-5.5, -4)])
def test_four_full_steps_are_lost_where_the_command_jumps_over_the_top_of_the_sine(
    jump: float, lost: int
) -> None:
    command = np.where(np.arange(ROWS) < 20, 0.0, jump * FULL_STEP / 2.0)  # the motor turns twice as far
    expected = motion(command)
    found = simulate(stepper(), expected.time_s, command[:, None]).positions[:, 0]
    steps = 2.0 * (command[-1] - np.array([found[-1], expected.position[-1]])) / FULL_STEP
    np.testing.assert_allclose(steps, lost, atol=0.1)  # friction holds the rest


def test_the_generated_step_is_the_specified_one() -> None:
    assert largest_difference(stepper()) < 1e-12


@pytest.mark.oracle
def test_identification_finds_inertia_and_friction() -> None:
    recordings = []
    for run in range(4):
        recorded = motion(ramps(run))
        angle = np.rint(recorded.position / RESOLUTION) * RESOLUTION
        recordings.append(Recording(f"run_{run}", recorded.time_s, recorded.command[:, None], angle[:, None]))
    true = stepper().parameters
    wrong = {"shaft.mass": 1.3, "shaft.coulomb": 0.7}
    declared = stepper().replace({name: f * true[name] for name, f in wrong.items()})
    assert [f for f in check_recordings(recordings, declared) if f.severity == "fault"] == []
    result = identify(recordings, declared)
    assert result.verdict == "no_effect"
    found = result.after.machine.parameters
    for name in wrong:
        assert found[name] == pytest.approx(true[name], rel=3e-2), name
    assert found["motor.holding_torque"] == HOLDING  # it sets the unit of force
    assert result.after.held_out.channels["phi_rad"].noise_ratio < 1.2


def test_a_machine_file_states_the_holding_torque(tmp_path) -> None:
    content = machine_to_dict(stepper())["drives"][0]
    # 50 periods are the default
    assert content["parameters"] == {"holding_torque": {"value": HOLDING, "unit": "Nm"}}
    assert content["rated_position"]["unit"] == "rad"
    save_machine(stepper(), tmp_path / "stepper.json")
    assert load_machine(tmp_path / "stepper.json").drives == stepper().drives


def printer() -> Machine:
    """Return an H-frame whose motors are steppers without gears."""
    machine = load_machine("hframe")
    rows = [machine.coordinate_names.index(d.coordinate) for d in machine.drives]
    reach = np.abs(rest_positions_per_axis(machine)[rows]).sum(axis=1) * 0.3
    return machine.replace(
        drives=tuple(
            drive(d.name, d.coordinate, 1.0, float(rated))
            for d, rated in zip(machine.drives, reach, strict=True)
        )
    )


@pytest.mark.integration
def test_a_printer_reaches_the_goal_and_loses_no_step() -> None:
    env = gym.make("HFrame-v0", machine=printer(), period=1e-3, max_episode_steps=4000)
    controller = make_controller("set-point", env)
    observation, _ = env.reset(seed=0)
    for _ in range(3000):
        observation, *_ = env.step(controller.act(observation))
    assert np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"]) < 2e-4


def test_a_period_is_told_in_which_a_held_set_point_would_lose_steps() -> None:
    assert "without losing steps" in str(SetPointController(printer(), 0.01).concern())
