"""A task, a reward and a distribution defined in this file alone work through every interface."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import env_checker

from hframe_gym.envs import DISTRIBUTIONS, REWARDS, TASKS, HFrameEnv, HFrameVectorEnv, Task, as_task
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from hframe_gym.errors import InputError
from hframe_gym.evaluation import evaluate


@TASKS.register("test-hop")
@dataclass(frozen=True)
class Hop(Task):
    """Start at the origin; the goal is a fixed distance away in a random direction."""

    distance: float = 0.05
    draws: ClassVar[int] = 1

    @property
    def parameters(self):
        """Return what can be randomized."""
        return {"distance": self.distance}

    def begin(self, workspace, uniforms, parameters: Mapping | None = None):
        """Choose the direction."""
        angle = 2.0 * np.pi * uniforms[:, 0]
        distance = self.distance if parameters is None else parameters["distance"]
        return np.zeros((len(uniforms), 2)), (distance * np.array([np.cos(angle), np.sin(angle)])).T

    def goal(self, plan, elapsed_s):
        """Return the goal."""
        return plan if elapsed_s.ndim == 1 else np.repeat(plan[:, None], elapsed_s.shape[1], axis=1)


@TASKS.register("test-line")
@dataclass(frozen=True)
class Line(Task):
    """A goal that moves along y = 0, without preview."""

    metrics: ClassVar[str] = "track"

    def begin(self, workspace, uniforms, parameters=None):
        """Start at the origin."""
        return np.zeros((len(uniforms), 2)), np.zeros((len(uniforms), 2))

    def goal(self, plan, elapsed_s):
        """Return the goal at 0.1 m/s."""
        return np.stack([0.1 * elapsed_s, np.zeros_like(elapsed_s)], axis=-1)

    def contour(self, plan, points, elapsed_s):
        """Return the distance to the line."""
        return np.abs(points[:, 1])


@dataclass(frozen=True)
class Jump(Task):
    """Stay at the origin; the goal changes its sign after 20 ms. Methods of subclasses are wrong."""

    draws: ClassVar[int] = 2

    def begin(self, workspace, uniforms, parameters=None):
        """Start at the origin."""
        goals = 0.1 * uniforms + 0.01
        return np.zeros_like(goals), goals

    def goal(self, plan, elapsed_s):
        """Return the goal."""
        signs = np.where(elapsed_s < 0.0199, 1.0, -1.0)
        return signs[..., None] * (plan if elapsed_s.ndim == 1 else plan[:, None])


def variant(**methods):
    """Return a task like `Jump` with other attributes."""
    return type("Variant", (Jump,), methods)()


@REWARDS.register("test-manhattan")
@dataclass(frozen=True)
class Manhattan:
    """Minus the sum of the distances along x and y, in bands."""

    band: float

    def __call__(self, achieved, desired):
        """Return the rewards."""
        return -np.abs(achieved.astype(float) - desired).sum(axis=1) / self.band


@DISTRIBUTIONS.register("test-two-values")
@dataclass(frozen=True)
class TwoValues:
    """One of two values."""

    first: float
    second: float
    bounded = True

    def quantile(self, u):
        """Return the first value below the median."""
        return np.where(u < 0.5, self.first, self.second)


@pytest.mark.parametrize("task", ["test-hop", "test-line"])
def test_a_task_works_in_every_environment(task):
    env = gym.make("HFrame-v0", task=task, reward="test-manhattan")
    env_checker.check_env(env.unwrapped, skip_render_check=True)
    observation, _ = env.reset(seed=5)
    envs = gym.make_vec("HFrame-v0", num_envs=3, task=task, reward="test-manhattan")
    many, _ = envs.reset(seed=4)
    adapter = HFrameVecEnv(3, task=task, reward="test-manhattan")
    adapter.seed(4)
    same, _ = adapter.reset(), adapter.reset_infos
    for _ in range(5):
        action = np.full(2, 0.3, np.float32)
        observation, reward, _, _, info = env.step(action)
        many, rewards, _, _, infos = envs.step(np.tile(action, (3, 1)))
        same, *_ = adapter.step(np.tile(action, (3, 1)))
    for key, value in observation.items():
        np.testing.assert_array_equal(many[key][1], value)
        np.testing.assert_array_equal(same[key][1], value)
    assert rewards[1] == reward == env.unwrapped.compute_reward(*(observation[k] for k in GOALS), {})
    assert ("contour_m" in info) == ("contour_m" in infos) == (task == "test-line")
    assert "preview" not in observation


GOALS = ("achieved_goal", "desired_goal")


def test_a_moving_goal_without_preview_moves():
    env = HFrameEnv(task="test-line")
    env.reset(seed=0)
    for step in range(1, 4):
        observation, *_, info = env.step(np.zeros(2))
        np.testing.assert_allclose(observation["desired_goal"], [1e-3 * step, 0.0], atol=1e-9)
        assert info["contour_m"] == 0.0
        assert info["distance_m"] == pytest.approx(1e-3 * step, abs=1e-9)


def test_task_parameters_and_distributions_can_be_used_by_name():
    rule = {"parameter": "task.distance", "distribution": ["test-two-values", 0.5, 2.0]}
    envs = HFrameVectorEnv(60, task="test-hop", randomize=[rule])
    _, info = envs.reset(seed=0)
    assert set(info["parameters"]["task.distance"]) == {0.025, 0.1}
    np.testing.assert_allclose(info["distance_m"], info["parameters"]["task.distance"], atol=1e-7)


def test_names_of_another_module():
    assert isinstance(as_task(f"{__name__}:test-hop"), Hop)
    assert as_task("test-hop", distance=0.1).distance == 0.1
    assert as_task("test-hop").name == "test-hop"
    assert as_task("test-hop").metrics == "reach"
    HFrameEnv(task=f"{__name__}:test-hop", reward=f"{__name__}:test-manhattan")


def test_unknown_names_are_refused_with_the_choices():
    with pytest.raises(InputError, match="task 'juggle' is unknown; choose one of reach, track"):
        HFrameEnv(task="juggle")
    with pytest.raises(InputError, match="reward 'kind' is unknown; choose one of dense, sparse"):
        HFrameEnv(reward="kind")
    with pytest.raises(InputError, match="choose one of reach, track"):
        HFrameEnv(task=3)


@pytest.mark.parametrize(("task", "metric"), [("test-hop", "settling_s"), ("test-line", "contour_mm")])
def test_a_task_is_evaluated_with_its_metrics(task, metric):
    scores, _ = evaluate("pid", task=task, episodes=2, randomize="none", duration_s=0.3)
    assert scores["task"] == task
    assert metric in scores["controllers"]["pid"]


@pytest.mark.parametrize("reward", ["dense", "progress"])
def test_a_goal_moves_without_a_path_or_previews(reward):
    env = HFrameEnv(task=Jump(), reward=reward)
    goals = [env.reset(seed=0)[0]["desired_goal"]]
    for _ in range(3):
        observation, value, _, _, info = env.step(np.zeros(2, np.float32))
        goals.append(observation["desired_goal"])
        assert value == env.compute_reward(observation["achieved_goal"], goals[-1], info)
        assert info["distance_m"] == pytest.approx(np.linalg.norm(goals[-1] - observation["achieved_goal"]))
    np.testing.assert_array_equal(goals, [goals[0], goals[0], -goals[0], -goals[0]])


def test_a_task_can_declare_that_its_goals_do_not_move():
    assert not HFrameEnv(task="reach").batch.references.moving
    assert not HFrameEnv(task=variant(moving=False)).batch.references.moving


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        ({"begin": lambda *_: np.zeros((16, 2))}, "begin must return two arrays"),
        ({"begin": lambda *_: (np.zeros(2), np.zeros(2))}, r"begin must return starts of shape \(16, 2\)"),
        ({"begin": lambda *_: (np.zeros((16, 3)), np.zeros((16, 2)))}, "these are of shape"),
        ({"begin": lambda *_: (np.full((16, 2), np.nan), np.zeros((16, 2)))}, "these are not finite"),
        (
            {"begin": lambda *_: (np.full((16, 2), 5.0), np.zeros((16, 2)))},
            "starts that begin returns must be",
        ),
        ({"begin": lambda *_: (np.zeros((16, 2)), np.zeros(16))}, "begin must return plans"),
        ({"begin": lambda *_: (np.zeros((16, 2)), np.full((16, 2), 5.0))}, "goals must be"),
        ({"goal": lambda self, plan, elapsed_s: plan[0]}, r"for times of shape \(16,\)"),
        ({"goal": lambda self, plan, elapsed_s: plan}, r"for times of shape \(16, 2\)"),
        ({"metrics": "track"}, "must implement contour"),
        ({"metrics": "track", "contour": lambda *_: 0.0}, "contour must return distances"),
    ],
)
def test_a_task_with_a_wrong_method_is_refused(methods, message):
    with pytest.raises(InputError, match=message):
        HFrameEnv(task=variant(**methods))
