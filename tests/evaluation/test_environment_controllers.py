"""Tests of controllers and agents on environments with `normalize`, `flat` and wrappers."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym.controllers import Controller, EnvironmentController
from hframe_gym.envs import HFrameVectorEnv, Track
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, evaluate, make_controller

FORMATS = [{}, {"normalize": True}, {"flat": True}, {"normalize": True, "flat": True, "error": True}]
PERIODS = 100


def final_distances(controller: Controller, envs: HFrameVectorEnv) -> Any:
    """Return the distances to the goal after `PERIODS` control periods, m."""
    observation, info = envs.reset(seed=3)
    for _ in range(PERIODS):
        observation, *_, info = envs.step(controller.act(observation))
    return info["distance_m"]


@pytest.mark.parametrize("options", FORMATS[1:])
@pytest.mark.parametrize(("name", "sensors"), [("pid", "state"), ("pid", "rig"), ("ppo", "state")])
def test_controllers_work_on_every_form_of_observation(
    name: str, sensors: str, options: dict[str, bool]
) -> None:
    """The rounding of float32 is far below a micrometer, and a learned policy amplifies it little."""
    common = {"randomize": "default", "sensors": sensors}
    plain, other = (HFrameVectorEnv(8, **common, **keywords) for keywords in ({}, options))  # type: ignore[arg-type]
    expected = final_distances(make_controller(name, plain), plain)
    assert np.median(expected) < 2e-4
    np.testing.assert_allclose(final_distances(make_controller(name, other), other), expected, atol=2e-5)


@pytest.mark.parametrize("options", FORMATS)
@pytest.mark.parametrize("name", ["pid", "ppo"])
def test_a_single_environment_needs_no_batch_axis(name: str, options: dict[str, bool]) -> None:
    env = gym.make("HFrame-v0", randomize="default", **options)
    controller = make_controller(name, env)
    observation, info = env.reset(seed=0)
    for _ in range(PERIODS):
        action = controller.act(observation)
        assert env.action_space.contains(action)
        observation, *_, info = env.step(action)
    assert info["distance_m"] < 2e-4


@pytest.mark.parametrize("options", FORMATS[::3])
def test_a_function_of_observations_is_a_controller(options: dict[str, bool]) -> None:
    """It receives observations as the environment returns them, also where an evaluation has others."""
    env = HFrameVectorEnv(1, **options)  # type: ignore[arg-type]
    policy = make_controller("textbook-pid", env).act
    scenario = Scenario("hframe", episodes=4, duration_s=0.3)
    mine, given = evaluate(
        {"mine": make_controller(policy, env), "given": "textbook-pid"}, scenario
    ).episodes.values()
    np.testing.assert_allclose(mine.position, given.position, atol=5e-5)
    assert make_controller(policy, env).act(env.reset(seed=0)[0]).shape == (1, 2)


def test_a_policy_with_a_memory_forgets_when_an_episode_begins() -> None:
    class Counting:
        def reset(self, mask: Any = None) -> None:
            self.steps = np.zeros(4) if mask is None else np.where(mask, 0.0, self.steps)

        def __call__(self, observation: Any) -> Any:
            self.steps = self.steps + 0.125
            return np.repeat(self.steps[:, None], 2, axis=1)

    env = HFrameVectorEnv(4, normalize=True)
    controller = make_controller(Counting(), env)
    observation, _ = env.reset(seed=0)
    controller.reset()
    for _ in range(2):
        actions = controller.act(observation)
    assert actions[:, 0].tolist() == [0.25] * 4
    controller.reset(np.array([False, True, False, False]))
    assert controller.act(observation)[:, 0].tolist() == [0.375, 0.125, 0.375, 0.375]


@pytest.mark.parametrize(
    ("options", "actions", "message"),
    [
        ({}, np.zeros(2), r"shape \(2,\) for 4 observations; return one row"),
        ({}, np.full((4, 2), np.nan), "not finite"),
        ({"privileged": True}, np.zeros((4, 2)), "observes 8 entries of privileged, and there are 0"),
        ({"machine": "axis"}, np.zeros((4, 1)), "observes 1 entries of achieved_goal, and there are 2"),
    ],
)
def test_a_function_that_does_not_fit_is_refused(options: dict[str, Any], actions: Any, message: str) -> None:
    controller = make_controller(lambda _: actions, gym.make("HFrame-v0", **options))
    with pytest.raises(InputError, match=message):
        evaluate({"mine": controller}, Scenario("hframe", episodes=4, duration_s=0.1))


def test_a_function_needs_its_environment_and_a_name() -> None:
    def policy(observation: Any) -> Any:
        return observation

    with pytest.raises(InputError, match=r"give the environment whose observations it takes"):
        make_controller(policy)
    for wrong in (policy, [policy], {"mine": policy}, [make_controller(policy, gym.make("HFrame-v0"))]):
        with pytest.raises(InputError, match=r"make_controller\(policy, env\) makes one"):
            evaluate(wrong, Scenario("hframe", episodes=4, duration_s=0.1))  # type: ignore[arg-type]


def test_the_adapter_of_stable_baselines3_is_an_environment_too() -> None:
    sb3 = pytest.importorskip("stable_baselines3.common.vec_env")
    from hframe_gym.envs.sb3_vec_env import HFrameVecEnv

    envs = HFrameVecEnv(4, normalize=True)
    controller = make_controller("pid", sb3.VecMonitor(envs))
    observation = envs.reset()
    for _ in range(PERIODS):
        observation = envs.step(controller.act(observation))[0]
    assert np.abs(observation["achieved_goal"] - observation["desired_goal"]).max() < 1e-3
    with pytest.raises(InputError, match="the wrapper VecNormalize changes observations"):
        make_controller("pid", sb3.VecNormalize(envs))


@pytest.mark.parametrize(
    "name", ["pid", "textbook-pid", "adaptive-pid", "predictive", "ppo", "sac", "residual"]
)
def test_a_controller_that_does_not_know_the_environment_refuses_normalized_observations(name: str) -> None:
    """Each start away from the center is recognized; one near it is recognized when the tool moves."""
    controller = make_controller(name)
    for seed in range(20):
        env = gym.make("HFrame-v0", normalize=True)
        observation, _ = env.reset(seed=seed, options={"start": (0.15, -0.1)} if seed < 4 else None)
        if np.abs(observation["achieved_goal"]).max() < 0.1:
            continue
        controller.reset()
        with pytest.raises(InputError, match=r"not in SI units.*make_controller\(name, env\)"):
            controller.act({key: values[None] for key, values in observation.items()})


def test_a_machine_without_angles_refuses_goals_outside_its_workspace() -> None:
    observation, _ = HFrameVectorEnv(16, machine="axis", normalize=True).reset(seed=0)
    with pytest.raises(InputError, match="not in SI units: achieved_goal has"):
        make_controller("pid", "axis").act(observation)


@pytest.mark.parametrize(("machine", "position"), [("axis", 0.36), ("pendulum", 7.0)])
def test_an_axis_that_overshoots_its_workspace_is_still_controlled(machine: str, position: float) -> None:
    """A real machine may do so; the message that the observation is normalized would be wrong."""
    observation = {
        "observation": np.array([[position, 0.0]]),
        "achieved_goal": np.array([[position]]),
        "desired_goal": np.array([[0.1]]),
    }
    assert make_controller("pid", machine).act(observation)[0, 0] < 0.0


def test_output_feedback_refuses_normalized_measurements() -> None:
    controller = make_controller("pid", sensors="rig")
    observation, _ = HFrameVectorEnv(32, sensors="rig", normalize=True).reset(seed=0)
    with pytest.raises(InputError, match=r"not in SI units: \w+_goal has [xy] = .*, and the workspace is"):
        controller.act(observation)


@pytest.mark.parametrize("name", ["pid", "ppo"])
def test_flat_and_unbatched_observations_are_refused_by_name(name: str) -> None:
    controller = make_controller(name)
    observation, _ = HFrameVectorEnv(2, flat=True).reset(seed=0)
    with pytest.raises(InputError, match=r"one array of shape \(2, 12\), not a dict"):
        controller.act(observation)
    observation, _ = gym.make("HFrame-v0").reset(seed=0)
    with pytest.raises(InputError, match="without batch axis"):
        controller.act(observation)


def test_a_wrapper_that_changes_observations_is_refused() -> None:
    env = gym.wrappers.FlattenObservation(gym.make("HFrame-v0"))
    with pytest.raises(InputError, match="the wrapper FlattenObservation changes observations or actions"):
        make_controller("pid", env)
    with pytest.raises(InputError, match="is not an environment of this package"):
        make_controller("pid", gym.make("Pendulum-v1"))


def test_a_preview_at_other_times_is_refused() -> None:
    env = gym.make("HFrameTrack-v0", task=Track(preview_s=0.02))
    with pytest.raises(
        InputError, match=r"one goal per control period of 0\.01 s; make the environment with task="
    ):
        make_controller("pid", env)
    assert isinstance(
        make_controller("pid", gym.make("HFrameTrack-v0", normalize=True)), EnvironmentController
    )


def test_a_controller_that_was_made_for_an_environment_is_evaluated_as_the_one_inside_it() -> None:
    made = {
        "made": make_controller("pid", gym.make("HFrame-v0", normalize=True)),
        "pid": make_controller("pid"),
    }
    scores = evaluate(made, episodes=4).scores["controllers"]
    assert scores["made"] == scores["pid"]


def test_an_agent_runs_beside_the_array_for_a_critic() -> None:
    env = gym.make("HFrame-v0", randomize="default", privileged=True, normalize=True)
    controller = make_controller("ppo", env)
    observation, _ = env.reset(seed=0)
    assert env.action_space.contains(controller.act(observation))
