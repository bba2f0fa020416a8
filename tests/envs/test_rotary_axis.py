"""Machines with a rotary axis: goals in rad, lengths of tasks and rewards as angles, the same controllers."""

import math
import warnings

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3.common.env_checker as sb3
from gymnasium.utils import env_checker

import hframe_gym  # noqa: F401  (registers the environments)
from hframe_gym.controllers import CONTROLLERS, suited_controllers
from hframe_gym.envs import (
    DisturbanceWrapper,
    HFrameEnv,
    HFrameVectorEnv,
    Reach,
    Track,
    VectorDisturbanceWrapper,
    as_task,
    machine_for_disturbances,
)
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, evaluate, rollout
from hframe_gym.machine import (
    RADIANS,
    Belt,
    Coordinate,
    Drive,
    Machine,
    Sensor,
    drawn_point,
    position_of_point,
    rest_positions_per_axis,
)


def motor(radius: float = 0.1, limits: tuple[float, float] | None = None) -> Machine:
    """Return a small motor with an encoder."""
    return Machine(
        name="small-motor",
        coordinates=(Coordinate("shaft", 2e-5, 1e-6, 2e-3, kind="rotary", radius=radius, range=limits),),
        belts=(),
        drives=(
            Drive(
                "motor", "v_V", "shaft", Kt=0.05, Ke=0.05, resistance=1.0, gear_ratio=1.0, rated_voltage=12.0
            ),
        ),
        sensors=(Sensor("shaft_rad", {"shaft": 1.0}, resolution=2 * math.pi / 4000, kind="encoder"),),
    )


FLEXIBLE_LINK = Machine(
    name="link",
    coordinates=(
        Coordinate("rotor", 1e-4, 1e-4, 2e-3, kind="rotary", radius=0.02),
        Coordinate("load", 1e-3, 1e-4, 1e-3, kind="rotary", radius=0.04),
    ),
    belts=(
        Belt("belt", 5e3, 0.5, {"rotor": 1.0, "load": -1.0}),
        Belt("back", 5e3, 0.5, {"rotor": -1.0, "load": 1.0}),
    ),
    drives=(
        Drive("motor", "v_V", "rotor", Kt=0.05, Ke=0.05, resistance=1.0, gear_ratio=1.0, rated_voltage=12.0),
    ),
    sensors=(Sensor("load_rad", {"load": 1.0}, noise=1e-4),),
)
MOTOR = motor()


def test_a_rotary_axis_is_controlled_in_rad_and_turns_once_to_either_side_unless_declared():
    assert MOTOR.tool_axes == ("shaft",)
    assert MOTOR.axis_unit is RADIANS
    assert MOTOR.axis_ranges == ((-2 * math.pi, 2 * math.pi),)
    assert motor(limits=(-1.0, 2.0)).axis_ranges == ((-1.0, 2.0),)
    assert RADIANS.bands == {"10mrad": 0.01, "2mrad": 0.002, "0.5mrad": 0.0005}


def test_of_a_load_behind_a_belt_the_load_is_the_axis_and_the_rotor_follows():
    assert FLEXIBLE_LINK.tool_axes == ("load",)
    np.testing.assert_allclose(rest_positions_per_axis(FLEXIBLE_LINK)[:, 0], [2.0, 1.0])
    episodes = rollout(
        CONTROLLERS.get("pid")(FLEXIBLE_LINK), Scenario(FLEXIBLE_LINK, episodes=8, randomize="none")
    )
    assert np.quantile(episodes.goal_error[:, -1], 0.9) < 0.01


def test_more_axes_than_drives_are_refused_with_the_reason():
    two = MOTOR.replace(coordinates=(*MOTOR.coordinates, Coordinate("fan", 1e-5, kind="rotary", radius=0.1)))
    three = two.replace(coordinates=(*two.coordinates, Coordinate("other", 1e-5, kind="rotary", radius=0.1)))
    assert two.tool_axes == ("fan",)
    with pytest.raises(InputError, match="drives cannot push along fan"):
        CONTROLLERS.get("pid")(two)
    assert three.tool_axes == ("shaft",)
    with pytest.raises(InputError, match="no other coordinates than those of axes and drives"):
        CONTROLLERS.get("pid")(three)
    with pytest.raises(InputError, match="has the rotary coordinates shaft and 0 drives"):
        HFrameEnv(machine=MOTOR.replace(drives=()))


@pytest.mark.parametrize(
    "options",
    [{}, {"task": "track", "normalize": True, "sensors": "machine", "randomize": "wide"}],
    ids=["reach", "track"],
)
def test_the_checkers_pass_and_a_vector_has_the_bits_of_single_environments(options):
    options = {"machine": MOTOR, **options}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sb3.check_env(HFrameEnv(**options), warn=True, skip_render_check=True)
        env_checker.check_env(gym.make("HFrame-v0", **options).unwrapped, skip_render_check=True)
    envs, single = HFrameVectorEnv(2, **options), HFrameEnv(**options)
    observations, first = envs.reset(seed=3)[0], single.reset(seed=4)[0]
    rng = np.random.default_rng(0)
    for _ in range(30):
        for key, values in first.items():
            assert np.array_equal(observations[key][1], values)
        actions = rng.uniform(-1, 1, (2, 1))
        observations, _, _, _, infos = envs.step(actions)
        first, _, _, _, info = single.step(actions[1])
        assert infos["distance_rad"][1] == info["distance_rad"]


def test_named_tasks_have_their_lengths_as_angles_and_objects_keep_theirs():
    assert as_task("reach", RADIANS) == Reach(margin=0.2, band=0.01)
    track = as_task("track", RADIANS, speed=1.0)
    assert (track.size, track.speed, track.margin, track.band) == (0.5, 1.0, 0.2, 0.01)
    assert HFrameEnv(machine=MOTOR, task=Reach(band=0.3)).batch.task.band == 0.3


@pytest.mark.parametrize("reward", ["dense", "progress", "sparse"])
def test_rewards_of_angles_are_those_of_the_way_of_an_arm(reward):
    """Ten times the positions, in rad, earn what the positions in m earn."""
    axis = HFrameEnv(machine="axis", reward=reward, task=Reach(start=(0.0,), target=(0.03,))).unwrapped
    rotary = HFrameEnv(machine=MOTOR, reward=reward, task=Reach((0.0,), (0.3,), 0.2, 0.01)).unwrapped
    goals = np.float32([[0.03]])
    achieved = np.float32([[0.0296]])
    info = [{"previous_achieved_goal": np.float32([0.01])}]
    further = [{"previous_achieved_goal": np.float32([0.1])}]
    expected = axis.compute_reward(achieved, goals, info)
    assert rotary.compute_reward(10 * achieved, 10 * goals, further) == pytest.approx(expected, rel=1e-4)
    for env in (axis, rotary):
        env.reset(seed=0)
    assert rotary.step([0.0])[1] == pytest.approx(axis.step([0.0])[1], rel=1e-6)


def test_the_goal_of_track_swings_and_its_contour_error_is_the_distance(tmp_path):
    env = HFrameEnv(machine=MOTOR, task="track")
    _, info = env.reset(seed=0)
    goals = []
    for _ in range(80):
        observation, _, _, _, info = env.step([0.0])
        goals.append(observation["desired_goal"][0])
        assert info["contour_rad"] == pytest.approx(info["distance_rad"], abs=1e-6)
    assert np.ptp(goals) == pytest.approx(0.5, abs=1e-3)  # a circle seen from the side
    (tmp_path / "points.csv").write_text("x_m,y_m\n0,0\n0.1,0.1\n", encoding="utf-8")
    with pytest.raises(InputError, match="of which it follows the motion along x"):
        HFrameEnv(machine=MOTOR, task=Track(path=str(tmp_path / "points.csv")))


@pytest.mark.parametrize(("radius", "limits"), [(0.1, None), (0.02, (-1.0, 2.0))])
def test_all_controllers_reach_and_score_in_mrad_whatever_the_radius(radius, limits):
    machine = motor(radius, limits)
    suited = suited_controllers(machine)  # other tests may have registered controllers of their own
    names = [name for name in suited if CONTROLLERS.get(name).__module__.startswith("hframe_gym.")]
    scores = evaluate(names, machine, episodes=8, duration_s=0.5).scores["controllers"]
    assert len(names) > 2
    for name, score in scores.items():
        assert score["success"]["2mrad"] == 1.0, name
        assert score["settling_s"]["10mrad"]["mean"] < 0.3, name
        assert "final_error_mrad" in score
    tracking = evaluate(["pid", "predictive"], machine, task="track", episodes=8, duration_s=0.7).scores[
        "controllers"
    ]
    assert tracking["pid"]["tracking_mrad"]["rms"]["mean"] < 5.0
    assert tracking["predictive"]["tracking_mrad"]["rms"]["mean"] < 1.0


def test_a_controller_runs_from_the_encoder():
    scenario = Scenario(MOTOR, episodes=8, sensors="machine", duration_s=0.5)
    score = evaluate("pid", scenario).scores["controllers"]["pid"]
    assert score["success"]["10mrad"] == 1.0


def test_an_impact_at_full_speed_stays_within_the_bounds():
    env = HFrameEnv(machine=MOTOR, task=Reach((6.0,), (0.0,), 0.2, 0.01))
    env.reset(seed=0)
    positions = [env.step([1.0])[0]["achieved_goal"][0] for _ in range(40)]
    assert 2 * math.pi < max(positions) < 2 * math.pi + 0.5
    assert abs(positions[-1] - positions[-2]) < 0.05  # it rests on the buffer


def test_the_dial_shows_an_angle_and_reads_it_back_with_its_turns():
    for angle in (0.3, -2.0, 5.9):
        point = drawn_point(RADIANS, (angle,))
        assert math.hypot(*point) == pytest.approx(0.1)
        assert position_of_point(RADIANS, point, (angle + 2.0,))[0] == pytest.approx(angle)
    env = HFrameEnv(machine=MOTOR, render_mode="rgb_array", task=Reach((0.0,), (1.0,), 0.2, 0.01))
    env.reset(seed=0)
    before = env.render()
    for _ in range(3):
        env.step([0.5])
    assert (env.render() != before).any(axis=2).sum() > 300


def test_the_observed_error_has_the_scale_of_an_angle():
    env = gym.make("HFrame-v0", machine=MOTOR, error=True)
    observation, _ = env.reset(seed=0, options={"start": [0.0], "target": [1e-3]})
    span = env.observation_space["desired_goal"].high - env.observation_space["desired_goal"].low
    np.testing.assert_allclose(observation["error"], np.log(2.0) / np.log1p(span / 1e-3), rtol=1e-3)


@pytest.mark.parametrize("count", [None, 3])
def test_a_disturbance_of_a_rotary_axis_is_a_torque_in_nm(count):
    machine = machine_for_disturbances(MOTOR)
    if count is None:
        env = DisturbanceWrapper(HFrameEnv(machine=machine), "white", std=0.01)
    else:
        env = VectorDisturbanceWrapper(HFrameVectorEnv(count, machine=machine), "white", std=0.01)
    env.reset(seed=1)
    applied = env._forces.forces.copy()
    info = env.step(np.zeros(env.action_space.shape, np.float32))[-1]
    assert "disturbance_N" not in info
    np.testing.assert_array_equal(np.reshape(info["disturbance_Nm"], (-1, 1)), applied)
    assert machine.unit("constant_force@shaft.size") == "Nm"
