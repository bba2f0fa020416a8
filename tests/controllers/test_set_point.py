"""Streaming of set points to drives that follow them: an H-frame as a printer, and single axes."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym import InputError, evaluate, load_machine, make_controller
from hframe_gym.controllers.set_point import SetPointController
from hframe_gym.exporters import EXPORTERS
from hframe_gym.exporters.friction_map import friction_parts
from hframe_gym.machine import Drive, Machine, rest_positions_per_axis
from tests.dynamics.test_derivatives import Case
from tests.identification.control_of_kinds import action_of_a_trained_agent

GAINS = {"speed_gain": 0.02, "integral_rate": 10.0, "torque_limit": 0.5}


def with_loops(kind: str, name: str = "hframe") -> Machine:
    """Return a machine with position or speed drives; rated positions reach the workspace's corners."""
    machine = load_machine(name)
    reach = np.abs(rest_positions_per_axis(machine))
    farthest = np.array([np.abs(machine.coordinate(axis).range).max() for axis in machine.tool_axes])
    drives = []
    for drive in machine.drives:
        rated = float(reach[machine.coordinate_names.index(drive.coordinate)] @ farthest)
        law = {**GAINS, **({"position_gain": 40.0} if kind == "position" else {})}
        drives.append(
            Drive(
                drive.name,
                f"{drive.name}_command",
                drive.coordinate,
                1.0,
                0.0,
                1.0,
                drive.gear_ratio,
                rated if kind == "position" else 10.0 * rated,
                kind=kind,
                law_parameters=law,
            )
        )
    return machine.replace(drives=tuple(drives))


def largest_errors(env: gym.Env, steps: int) -> list[float]:
    """Return the distance from the goal, m, in the periods of an episode."""
    controller = make_controller("set-point", env)
    observation, _ = env.reset(seed=0)
    errors = []
    for _ in range(steps):
        observation, *_ = env.step(controller.act(observation))
        errors.append(float(np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"])))
    return errors


@pytest.mark.integration
@pytest.mark.parametrize("kind", ["position", "speed"])
def test_the_tool_arrives_without_a_lasting_vibration(kind: str) -> None:
    env = gym.make("HFrame-v0", machine=with_loops(kind), randomize="default")
    errors = largest_errors(env, 100)
    assert errors[0] > 0.05
    assert max(errors[60:]) < 2e-4
    assert max(largest_errors(gym.make("HFrame-v0", machine=with_loops(kind, "axis")), 80)[60:]) < 5e-4


@pytest.mark.integration
def test_the_tool_follows_a_moving_goal_from_measurements() -> None:
    env = gym.make("HFrameTrack-v0", machine=with_loops("position"))
    assert max(largest_errors(env, 100)[50:]) < 2e-3


@pytest.mark.integration
def test_an_evaluation_states_no_energy_of_drives_that_take_set_points() -> None:
    result = evaluate(["set-point"], machine=with_loops("position", "axis"), episodes=4, duration_s=0.5)
    score = result.scores["controllers"]["set-point"]
    assert score["success"]["1mm"] == 1.0
    assert "energy_J" not in score


def test_the_means_of_the_reference_excite_no_vibration() -> None:
    hframe = SetPointController(with_loops("position"))
    assert len(hframe.weights) > 5
    assert hframe.weights.sum() == pytest.approx(1.0)
    rigid = SetPointController(with_loops("position", "axis"))
    np.testing.assert_array_equal(rigid.weights, [1.0])


def test_the_reference_keeps_its_limits_and_ends_at_the_goal() -> None:
    controller = SetPointController(with_loops("position", "axis"))
    drive = dataclasses.replace(controller.machine.drives[0], rated_voltage=1.0)
    limited = controller.machine.replace(drives=(drive.with_values({"speed_limit": 0.3}),))
    controller = SetPointController(limited)
    nothing = np.zeros((1, 1))
    observation = {"observation": nothing, "achieved_goal": nothing, "desired_goal": nothing + 0.2}
    references = []
    for _ in range(100):
        controller.act(observation)
        references.append(float(controller._reference[0, 0, 0]))
    speeds = np.diff(references, prepend=0.0) / controller.period
    assert speeds.max() == pytest.approx(0.3, rel=1e-9)
    assert np.abs(np.diff(speeds)).max() <= 1.126 * controller.acceleration[0] * controller.period
    assert max(references) <= 0.2 + 1e-9
    assert references[-1] == pytest.approx(0.2, abs=1e-6)


def test_controllers_refuse_the_drives_that_they_cannot_command() -> None:
    with pytest.raises(InputError, match="use the controller set-point"):
        make_controller("pid", gym.make("HFrame-v0", machine=with_loops("position")))
    with pytest.raises(InputError, match="motor1, motor2 takes another command; use pid"):
        SetPointController(load_machine("hframe"))


def test_a_rated_position_that_is_too_small_is_told() -> None:
    machine = with_loops("position", "axis")
    assert SetPointController(machine).concern() is None
    short = machine.replace({}, drives=(dataclasses.replace(machine.drives[0], rated_voltage=0.1),))
    assert "does not reach all of the workspace" in str(SetPointController(short).concern())


@pytest.mark.parametrize("name", ["c", "st", "fmu", "mjcf"])
def test_files_without_a_place_for_the_loops_are_refused(name: str) -> None:
    machine = with_loops("position")
    exporter = EXPORTERS.get(name)(machine=machine)
    with pytest.raises(InputError, match="no place for the loop of motor1 and motor2"):
        exporter.files(machine)


def test_a_friction_map_is_that_of_the_machine_without_loops() -> None:
    machine = with_loops("speed", "axis")
    speed, position = np.array([-0.2, 0.1]), np.zeros(2)
    plain = machine.replace(
        drives=tuple(dataclasses.replace(drive, kind="torque", law_parameters={}) for drive in machine.drives)
    )
    parts = [np.array(friction_parts(m, 0, speed, None, position, 0.0)) for m in (machine, plain)]
    np.testing.assert_array_equal(*parts)
    assert np.all(parts[0][0] != 0.0)


@pytest.mark.integration
@pytest.mark.parametrize("kind", ["position", "speed"])
def test_the_derivatives_of_motions_contain_the_loops(kind: str) -> None:
    case = Case(with_loops(kind, "axis"))
    case.arrays["inputs"] *= 0.02  # so that not all torques are at their limits
    for name in ("start", "inputs", "parameters"):
        assert max(case.errors(name)) < 1e-6


@pytest.mark.train
def test_an_agent_trains_by_set_points() -> None:
    env = gym.make("HFrame-v0", machine=with_loops("position"), normalize=True)
    assert np.all(np.isfinite(action_of_a_trained_agent(env)))
