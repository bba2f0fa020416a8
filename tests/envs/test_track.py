"""Task `track`: goals against closed forms, preview, contour error, path files, both environment checkers."""

import warnings
from dataclasses import dataclass
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3.common.env_checker as sb3
from gymnasium.utils import env_checker
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

import hframe_gym  # noqa: F401  (registers the environments)
from hframe_gym.envs import HFrameEnv, HFrameVectorEnv, Reach, Task, Track
from hframe_gym.envs.tasks.curves import SHAPES, Polyline
from hframe_gym.envs.tasks.track import arc_lengths
from hframe_gym.errors import InputError

WORKSPACE = np.array([[-0.28, 0.28], [-0.19, 0.19]])
SHAPE_NAMES = ("circle", "square", "lissajous")


def plans(task, count=8, seed=0):
    uniforms = np.random.default_rng(seed).uniform(size=(count, task.draws))
    return task.begin(WORKSPACE, uniforms)


def distances(times, length=np.inf):
    """Return the distances of a goal at 0.3 m/s along a path, m, shape (n,)."""
    plan = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.3]])
    return arc_lengths(plan, np.array([times], float), 0.2, length)[0]


def write(folder, text):
    path = folder / "path.csv"
    path.write_text(text)
    return path


def test_circle_against_the_closed_form():
    task = Track(centre=(0.1, -0.05), direction=-1, phase=0.25, size=0.05, speed=0.3, lead_s=0.2)
    _, plan = plans(task, 1)
    t = 0.7
    turned = np.pi / 2 - 0.3 * (t - 0.1) / 0.025  # half of the speed-up time is lost
    expected = [0.1 + 0.025 * np.cos(turned), -0.05 + 0.025 * np.sin(turned)]
    np.testing.assert_allclose(task.goal(plan, np.array([t]))[0], expected, atol=1e-14)


@pytest.mark.parametrize("path", SHAPE_NAMES)
def test_goal_starts_at_rest_and_keeps_its_speed(path):
    task = Track(path=path)
    start, plan = plans(task)
    np.testing.assert_array_equal(task.goal(plan, np.zeros(8)), start)
    step = 1e-5

    def speed(t):
        ends = [task.goal(plan, np.full(8, t + d)) for d in (0.0, step)]
        return np.linalg.norm(ends[1] - ends[0], axis=1) / step

    assert speed(0.0).max() < 1e-4
    # Half of the speed is reached half-way through the speed-up. A chord across a corner is slightly too
    # short.
    np.testing.assert_allclose(speed(0.1), 0.15, rtol=1e-3)
    np.testing.assert_allclose(speed(0.61), 0.3, rtol=1e-4)


def test_distance_is_the_integral_of_the_documented_speed():
    def speed(t):
        u = min(t / 0.2, 1.0)
        return 0.3 * (3 * u**2 - 2 * u**3)

    for t in (0.05, 0.2, 0.9):
        expected = quad(speed, 0.0, t, points=[0.2] if t > 0.2 else None)[0]
        assert distances([t])[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("length", [0.2, 0.01])
def test_an_open_path_ends_at_rest(length):
    t = np.linspace(0.0, 3.0, 3001)
    way = distances(t, length)
    assert np.all(np.diff(way) >= 0.0)
    assert way[-1] == length
    # no jump of the speed anywhere: 1.5 v / lead_s at most
    assert np.abs(np.diff(way, 2)).max() < 2.3e-6 * 1.1


@pytest.mark.parametrize("path", SHAPE_NAMES)
def test_preview_holds_the_future_goals(path):
    env = HFrameEnv(task=Track(path=path), randomize="default")
    observations = [env.reset(seed=3)[0]]
    observations += [env.step(np.zeros(2))[0] for _ in range(20)]
    for k in range(10):
        later = np.concatenate([observations[k + i + 1]["desired_goal"] for i in range(10)])
        np.testing.assert_allclose(observations[k]["preview"], later, atol=1e-7)


@dataclass(frozen=True)
class LongPlan(Track):
    """Follow a path by a plan that has further numbers, as the class of a user may have it."""

    plan_size: ClassVar[int] = 60


@pytest.mark.parametrize("kind", [Track, LongPlan])
@pytest.mark.parametrize("path", [*SHAPE_NAMES, "file"])
def test_goals_of_an_observation_are_those_of_goal(path, kind, tmp_path):
    if path == "file":
        path = write(tmp_path, "x_m,y_m\n0,0\n0.05,0.02\n0.06,0.1\n")  # an open path
    task, count = kind(path=path), 19
    _, plan = plans(task, count)
    elapsed_s, ahead_s = np.linspace(0.0, 2.0, 2 * count)[::2], np.array(task.ahead_s)
    written, expected = (
        [np.empty((count, 2), np.float32), np.empty((count, 10, 2), np.float32)] for _ in range(2)
    )
    task.write_goals(plan, elapsed_s, ahead_s, *written)
    Task.write_goals(task, plan, elapsed_s, ahead_s, *expected)
    for goals, goals_of_default in zip(written, expected, strict=True):
        np.testing.assert_array_equal(goals, goals_of_default)


@pytest.mark.parametrize("path", ["circle", "square"])
def test_contour_error_takes_arrays_of_any_type(path):
    task = Track(path=path, lead_s=1)
    _, plan = plans(task)
    start = task.goal(plan, np.zeros(8))
    points, elapsed_s = (start + 0.0012).astype(np.float32), np.tile([0.0, 1.0], 4)
    expected = task.contour(plan, points.astype(np.float64), elapsed_s)
    for same in (elapsed_s.astype(np.float32), elapsed_s.astype(int), np.repeat(elapsed_s, 2)[::2]):
        np.testing.assert_array_equal(task.contour(plan, points, same), expected)
    origin = np.zeros((8, 2))
    np.testing.assert_array_equal(
        task.contour(plan, origin.astype(int), elapsed_s), task.contour(plan, origin, elapsed_s)
    )


def test_contour_error_is_the_smallest_distance_to_the_curve():
    rng = np.random.default_rng(1)
    for name, make in SHAPES.items():
        curve = make(0.05)
        for s in rng.uniform(0.0, curve.length, 20):
            near = curve.point(np.array([s]))[0] + rng.normal(0.0, 3e-4, 2)
            distance = curve.distance(near[None], np.array([s]))[0]
            window = np.linspace(s - 0.003, s + 0.003, 2001)
            apart = np.linalg.norm(curve.point(window) - near, axis=1)
            i = window[apart.argmin()]
            best = minimize_scalar(
                lambda at: np.linalg.norm(curve.point(np.array([at]))[0] - near),  # noqa: B023
                bounds=(i - 4e-6, i + 4e-6),
                method="bounded",
                options={"xatol": 1e-10},
            ).fun
            assert distance == pytest.approx(best, abs=2e-8), name


def test_contour_error_at_a_corner_is_the_distance_to_the_sides():
    square = SHAPES["square"](0.05)
    assert square.distance(np.array([[0.0245, 0.0243]]), np.array([0.026]))[0] == pytest.approx(0.0005)


def test_a_delayed_tool_on_the_path_has_no_contour_error():
    env = HFrameVectorEnv(4, task=Track(path=SHAPE_NAMES), autoreset_mode="Disabled")
    env.reset(seed=0)
    for _ in range(30):
        *_, info = env.step(np.zeros((4, 2), np.float32))
    assert info["contour_m"].max() < 1e-12
    assert info["distance_m"].min() > 0.01
    assert not info["is_success"].any()


def test_contour_error_of_a_distant_tool():
    figure = SHAPES["lissajous"](0.05)
    points = np.array([[0.2, 0.1], [-0.1, 0.02], [0.0, -0.15]])
    fine = figure.point(np.linspace(0.0, figure.length, 200001))
    expected = [np.linalg.norm(fine - p, axis=1).min() for p in points]
    np.testing.assert_allclose(figure.distance(points, np.zeros(3)), expected, rtol=1e-3)


def test_every_shape_is_chosen_and_stays_in_the_workspace():
    task = Track(path=SHAPE_NAMES, size=0.1)
    _, plan = plans(task, 300)
    assert set(plan[:, 0]) == {0.0, 1.0, 2.0}
    assert set(plan[:, 3]) == {-1.0, 1.0}
    for t in np.linspace(0.0, 1.5, 40):
        goal = task.goal(plan, np.full(300, t))
        assert np.all(goal >= WORKSPACE[:, 0] + 0.02 - 1e-12)
        assert np.all(goal <= WORKSPACE[:, 1] - 0.02 + 1e-12)


def test_a_path_file_is_followed_point_by_point(tmp_path):
    task = Track(path=write(tmp_path, "x_m,y_m\n0,0\n0.1,0\n0.1,0\n0.1,0.05\n"), speed=0.2, lead_s=0.1)
    _, plan = plans(task, 1)
    duration = 0.15 / 0.2 + 0.1
    for t, point in ((0.0, (0.0, 0.0)), (0.55, (0.1, 0.0)), (duration + 1.0, (0.1, 0.05))):
        np.testing.assert_allclose(task.goal(plan, np.array([t]))[0], point, atol=1e-12)


def test_a_path_file_with_times_keeps_its_times(tmp_path):
    task = Track(path=write(tmp_path, "time_s,x_m,y_m\n10,0,0\n10.5,0.1,0\n11,0.1,0\n12,0.1,0.1\n"))
    _, plan = plans(task, 1)
    for t, point in ((0.25, (0.05, 0.0)), (0.75, (0.1, 0.0)), (1.25, (0.1, 0.025)), (9.0, (0.1, 0.1))):
        np.testing.assert_allclose(task.goal(plan, np.array([t]))[0], point, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_m\n0\n1\n", "column y_m: missing"),
        ("x_mm,y_m\n0,0\n", "column x_mm"),
        ("x_m,y_m\n0,0\n", "at least two rows"),
        ("x_m,y_m\n0,0\n0,0\n", "two different points"),
        ("x_m,y_m\n0,0\n0.1,\n", "row 2, column y_m"),
        ("x_m,y_m\n0,0\n0.1,far\n", "row 2, column y_m"),
        ("x_m,y_m\n0,0\n0.1,inf\n", "row 2, column y_m"),
        ("x_m,y_m\n0,0\n0.1,0.3\n", "row 2, column y_m: 0.3 is outside the workspace"),
        ("time_s,x_m,y_m\n0,0,0\n0,0.1,0.1\n", "row 2, column time_s"),
    ],
)
def test_a_faulty_path_file_is_refused_with_row_and_column(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        HFrameEnv(task=Track(path=write(tmp_path, text)))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"path": "spiral"}, "spiral"),
        ({"path": ()}, "empty"),
        ({"path": "no-such.csv"}, "no such file"),
        ({"size": 0.5}, "does not fit"),
        ({"speed": -1.0}, "speed"),
        ({"centre": (0.27, 0.0)}, "centre"),
        ({"direction": 2}, "direction"),
        ({"phase": 1.5}, "phase"),
        ({"previews": 0}, "previews"),
        ({"lead_s": float("nan")}, "lead_s"),
    ],
)
def test_invalid_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        HFrameEnv(task=Track(**settings))


def test_a_target_is_refused():
    env = HFrameEnv(task="track")
    with pytest.raises(ValueError, match="no target"):
        env.reset(seed=0, options={"target": (0.0, 0.0)})


def test_a_refused_target_uses_no_random_numbers():
    refusing, other = HFrameEnv(task="track"), HFrameEnv(task="track")
    for env in (refusing, other):
        env.reset(seed=0)
    with pytest.raises(ValueError, match="no target"):
        refusing.reset(options={"target": (0.0, 0.0)})
    goals = [env.reset()[0]["desired_goal"] for env in (refusing, other)]
    np.testing.assert_array_equal(*goals)


def test_a_path_needs_two_different_points():
    with pytest.raises(ValueError, match="two different"):
        Polyline(np.zeros((3, 2)))


def test_reach_has_no_preview_and_no_contour():
    env = HFrameEnv(task=Reach())
    observation, info = env.reset(seed=0)
    assert "preview" not in observation
    assert "contour_m" not in info


@pytest.mark.parametrize("path", ["circle", SHAPE_NAMES], ids=str)
def test_environment_checkers_pass(path):
    env = gym.make("HFrameTrack-v0", task=Track(path=path), randomize="default")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env_checker.check_env(env.unwrapped, skip_render_check=True)
        sb3.check_env(HFrameEnv(task=Track(path=path)), warn=True, skip_render_check=True)


def test_single_and_vector_environment_are_equal():
    envs = gym.make_vec("HFrameTrack-v0", num_envs=3, randomize="default")
    many, _ = envs.reset(seed=5)
    single = gym.make("HFrameTrack-v0", randomize="default")
    one, _ = single.reset(seed=7)
    for _ in range(20):
        many, rewards, *_, infos = envs.step(np.full((3, 2), 0.2, np.float32))
        one, reward, *_, info = single.step(np.full(2, 0.2, np.float32))
    for key, values in one.items():
        np.testing.assert_array_equal(many[key][2], values)
    assert rewards[2] == reward
    assert infos["contour_m"][2] == info["contour_m"]
    again = envs.unwrapped.compute_reward(many["achieved_goal"], many["desired_goal"], {})
    np.testing.assert_array_equal(again, rewards)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_reset_inside_a_step_begins_a_new_path(mode):
    envs = HFrameVectorEnv(5, task="track", max_episode_steps=4, autoreset_mode=mode)
    envs.reset(seed=0)
    for _ in range(5 if mode == "NextStep" else 4):
        observation, *_, info = envs.step(np.zeros((5, 2), np.float32))
    np.testing.assert_array_equal(observation["achieved_goal"], observation["desired_goal"])
    np.testing.assert_allclose(info["contour_m"], 0.0, atol=1e-12)
    assert np.abs(observation["preview"] - np.tile(observation["desired_goal"], 10)).max() > 1e-4
