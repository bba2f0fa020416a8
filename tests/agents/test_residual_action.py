"""Residual actions: authority, history, and the base controller beneath the policy."""

import numpy as np
import pytest

from hframe_gym.agents.feedback_laws import VARIANTS
from hframe_gym.agents.residual_action import LARGEST_HELD, ActionParts, Authority, ResidualAction
from hframe_gym.controllers import CONTROLLERS, MotionModel
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameVectorEnv, observation_space
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from tests.agents.observations import rest_observation

MACHINE = BUILTIN_MACHINES["hframe"]()


@pytest.mark.parametrize(
    ("distance", "fraction"), [(0.0, 0.06), (1e-3, 0.26), (0.1, 1.0)], ids=["at the goal", "near", "far"]
)
def test_authority_grows_with_the_distance(distance, fraction):
    assert Authority(least=0.06)(np.array([distance]), np.zeros(1)) == pytest.approx(fraction, rel=1e-3)


def test_the_last_action_is_held_at_rest_at_the_goal_only():
    mapping = ResidualAction(MACHINE, 0.01, least=0.1, hold_m=5e-4)
    held = {}
    for error in (0.0, 2.5e-4, 1e-3):
        mapping.reset()
        mapping.augment(rest_observation(MACHINE, (0.1, 0.0), (0.1, 0.0)))
        mapping.replace_last_action(np.array([[0.08, -0.5]]))
        mapping.augment(rest_observation(MACHINE, (0.1 + error, 0.0), (0.1, 0.0)))
        held[error] = mapping.action(np.zeros((1, 2)))[0]
    assert held[0.0] == pytest.approx([0.08, -LARGEST_HELD], rel=1e-3)
    assert held[2.5e-4] == pytest.approx([0.04, -0.5 * LARGEST_HELD], rel=1e-3)
    assert held[1e-3] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_the_integral_grows_while_the_tool_rests_near_the_goal():
    mapping = ResidualAction(MACHINE, 0.01, integral=True)
    goal = (0.1, 0.05)

    def integral(*error, speed=0.0):
        observation = rest_observation(MACHINE, np.subtract(goal, error), goal)
        observation["observation"][:, mapping.tool_speeds] = [speed, 0.0]
        return mapping.augment(observation)["error_integral"][0]

    assert integral(2e-3, 0.0) == pytest.approx([0.0, 0.0])  # too far away
    for periods in (1, 2, 3):
        assert integral(1e-4, -5e-5) == pytest.approx([1e-6 * periods, -5e-7 * periods], rel=1e-2)
    assert integral(1e-4, -5e-5, speed=0.1) == pytest.approx([3e-6, -1.5e-6], rel=1e-2)  # moving
    assert integral(-1e-5, -5e-5) == pytest.approx([-1e-7, -2e-6], rel=1e-2)  # x has crossed the goal
    mapping.reset()
    assert integral(1e-4, 0.0) == pytest.approx([1e-6, 0.0], rel=1e-2, abs=1e-9)
    assert integral(2e-3, 0.0) == pytest.approx([0.0, 0.0])
    space = mapping.observation_space(observation_space(MACHINE))
    assert space["error_integral"].shape == (2,)


def test_history_covers_one_period_and_is_cleared_by_a_reset():
    envs = HFrameVectorEnv(3, randomize="none")
    mapping = ResidualAction(MACHINE, 0.01, base="pid", least=0.1)
    first, _ = envs.reset(seed=0)
    augmented = mapping.augment(first)
    assert np.array_equal(augmented["last_observation"], first["observation"])
    assert not augmented["last_action"].any()
    action = mapping.action(np.full((3, 2), 0.5))
    second = envs.step(action)[0]
    augmented = mapping.augment(second)
    assert np.array_equal(augmented["last_observation"], first["observation"])
    assert np.array_equal(augmented["last_action"], action.astype(np.float32))
    mapping.reset(np.array([True, False, False]))
    augmented = mapping.augment(second)
    assert not augmented["last_action"][0].any()
    assert np.array_equal(augmented["last_observation"][0], second["observation"][0])
    assert augmented["last_action"][1:].any()
    space = mapping.observation_space(observation_space(MACHINE))
    assert space.contains({key: values[1] for key, values in augmented.items()})


def test_the_base_controller_builds_on_the_action_that_was_applied():
    """While friction holds the stage, the integral action of the base goes on at the corrected voltage."""
    observation = rest_observation(MACHINE, (0.1, 0.0), (0.10005, 0.0))
    alone = CONTROLLERS.get("pid")(MACHINE, 0.01)
    mapping = ResidualAction(MACHINE, 0.01, base="pid", least=1.0)
    for _ in range(3):
        action_alone = alone.act(observation)
        mapping.augment(observation)
        mapping.action(np.zeros((1, 2)))
    mapping.augment(observation)
    corrected = mapping.action(np.array([[0.05, -0.02]]))
    increment = mapping.augment(observation)["base_action"] - corrected
    assert increment == pytest.approx(alone.act(observation) - action_alone, rel=1e-3)


def test_the_base_controller_of_an_agent_file_imports_no_module():
    with pytest.raises(InputError, match="base controller 'antigravity:pid' is unknown"):
        ResidualAction(MACHINE, 0.01, base="antigravity:pid")


def test_outputs_weight_the_voltages_of_transfers():
    mapping = ResidualAction(MACHINE, 0.01, least=0.0, full_at_m=np.inf, transfers=[0, 4, 20])
    outputs = mapping.action_space().shape[0]
    assert outputs == 2 + 3 + 3 * len(VARIANTS)
    observation = rest_observation(MACHINE, (0.1, 0.0), (0.095, 0.0))
    mapping.augment(observation)
    shortest, longer, longest = mapping.laws.volts[0, :3]
    assert np.abs(shortest).max() > np.abs(longer).max() > np.abs(longest).max() > 0.0

    def action(index):
        mapping.reset()
        mapping.augment(observation)
        output = -np.ones((1, outputs))
        output[0, 2 + index] = 1.0
        return mapping.action(output)[0]

    # exp(2 * WEIGHT_SCALE) is a weight of 20 000 to 1.
    assert action(1) == pytest.approx(longer, abs=1e-3)
    assert action(2) == pytest.approx(longest, abs=1e-3)
    mapping.reset()
    mapping.augment(rest_observation(MACHINE, (0.1, 0.0), (0.1, 0.0)))
    assert np.abs(mapping.laws.volts).max() < 1e-3


def test_the_shown_parts_give_the_action_that_is_applied():
    mapping = ResidualAction(MACHINE, 0.01, base="pid", hold_m=5e-4, transfers=[0, 4], parts=True)
    mapping.augment(rest_observation(MACHINE, (0.1, 0.0), (0.1, 0.0)))
    mapping.replace_last_action(np.array([[0.08, -0.05]]))
    shown = mapping.augment(rest_observation(MACHINE, (0.1, 0.0), (0.1002, 0.0001)))
    space = mapping.observation_space(observation_space(MACHINE))
    assert {key: values.shape[1:] for key, values in shown.items()} == {k: v.shape for k, v in space.items()}
    output = np.random.default_rng(0).uniform(-1.0, 1.0, (1, *mapping.action_space().shape))
    laws = shown["law_actions"].reshape(1, mapping.bank.size, 2)
    found = ActionParts(shown["action_offset"], shown["authority"], laws).action(output)
    assert np.abs(found).max() > 0.01
    assert mapping.action(output) == pytest.approx(np.clip(found, -1.0, 1.0), abs=1e-5)


def test_parts_without_laws_are_refused():
    with pytest.raises(InputError, match="parts = true needs transfers or plans"):
        ResidualAction(MACHINE, 0.01, parts=True)


def test_plans_follow_the_estimates():
    envs = HFrameVectorEnv(4, randomize="default")
    mapping = ResidualAction(MACHINE, 0.01, least=0.0, full_at_m=np.inf, estimates=True, plans=[3, 6, 20])
    assert mapping.action_space().shape == (2 + 3,)
    observation, _ = envs.reset(seed=0)
    gains = []
    for _ in range(4):
        mapping.augment(observation)
        gains.append(mapping.laws.gains[:, 2])
        observation = envs.step(
            mapping.action(np.tile([0.0, 0.0, -1.0, -1.0, 1.0], (4, 1))).astype(np.float32)
        )[0]
    # The same for all machines at first, then different.
    assert np.ptp(gains[0], axis=0).max() < 0.05 * np.abs(gains[0]).max()
    assert np.ptp(gains[-1], axis=0).max() > 0.05 * np.abs(gains[-1]).max()


def test_plans_are_made_for_a_carriage_with_a_load_that_swings():
    machine = MACHINE.with_effects(EFFECTS["payload_swing"].at("y", f0=1.8, zeta=0.05, r=0.3))
    mapping = ResidualAction(machine, 0.01, estimates=True, plans=[3, 6])
    observation = rest_observation(machine, (0.1, 0.0), (0.1, 1e-3))
    mapping.augment(observation)
    towards_goal = mapping.laws.volts[0] @ MotionModel(machine).force_per_volt.T
    assert (towards_goal[:, 1] > np.abs(towards_goal[:, 0])).all()


@pytest.mark.parametrize(
    "further", [{}, {"estimates": True, "transfers": [0]}], ids=["no estimates", "transfers"]
)
def test_plans_without_estimates_or_beside_transfers_are_refused(further):
    with pytest.raises(InputError, match="plans need estimates = true and no transfers"):
        ResidualAction(MACHINE, 0.01, plans=[4], **further)


def test_transfers_that_the_machine_lacks_are_refused():
    with pytest.raises(InputError, match=r"transfers are .* has those of 0 to"):
        ResidualAction(MACHINE, 0.01, transfers=[0, 999])
