"""Actions of an agent on another machine than that of its training."""

import numpy as np
import pytest

from hframe_gym.agents import Agent, shipped_agent_folder
from hframe_gym.agents.action_conversion import ActionConversion
from hframe_gym.agents.features import feature_parameters
from hframe_gym.controllers import MotionModel
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES

pytest.importorskip("stable_baselines3")

MACHINE = BUILTIN_MACHINES["hframe"]()


def with_motors(*factors):
    """Return the machine with motors whose torque per voltage is multiplied by these factors."""
    constants = {f"motor{i}.Kt": factor for i, factor in enumerate(factors, 1)}
    return MACHINE.replace({name: factor * MACHINE.parameters[name] for name, factor in constants.items()})


def acceleration(machine, actions):
    """Return the accelerations of the tool at rest, m/s^2, without friction and with rigid belts."""
    model = MotionModel(machine)
    mass = (model.rigid.T * model.mass) @ model.rigid
    return np.linalg.solve(mass, model.force_per_volt @ (actions * model.rated).T).T


def test_converted_actions_accelerate_both_machines_equally():
    stronger = with_motors(1.3, 1.8).replace({"y.mass": 0.8 * MACHINE.parameters["y.mass"]})
    conversion = ActionConversion(MACHINE, stronger)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    converted = conversion.to_machine(actions)
    assert acceleration(stronger, converted) == pytest.approx(acceleration(MACHINE, actions))
    assert np.linalg.norm(converted, axis=1).max() < 0.95 * np.linalg.norm(actions, axis=1).max()
    assert conversion.to_training(converted) == pytest.approx(actions)
    periods = np.hstack([actions, 2.0 * actions])
    assert conversion.to_machine(periods) == pytest.approx(np.hstack([converted, 2.0 * converted]))


def test_no_action_becomes_larger_on_a_weaker_machine():
    assert ActionConversion(MACHINE, with_motors(0.5, 0.7)).matrix == pytest.approx(np.eye(2))
    mixed = ActionConversion(MACHINE, with_motors(0.5, 2.0)).matrix
    assert np.linalg.norm(mixed, 2) == pytest.approx(1.0)
    assert np.linalg.svd(mixed)[1][1] < 0.6


def test_features_show_the_voltages_of_the_training():
    stronger = with_motors(1.5, 2.0)
    conversion = ActionConversion(MACHINE, stronger)
    gains = feature_parameters(stronger, preview=5)["gains"]
    converted = conversion.gains(gains)
    rng = np.random.default_rng(0)
    observation = {key: rng.normal(size=(4, np.shape(values)[1])) for key, values in gains.items()}
    shown = {**observation, "last_action": conversion.to_training(observation["last_action"])}
    actions = sum(observation[key] @ np.transpose(values) for key, values in gains.items())
    of_training = sum(shown[key] @ np.transpose(values) for key, values in converted.items())
    assert of_training == pytest.approx(conversion.to_training(actions))
    assert np.abs(of_training - actions).max() > 0.3 * np.abs(actions).max()


def test_a_policy_commands_half_the_voltage_of_motors_that_are_twice_as_strong():
    folder = shipped_agent_folder("ppo", "reach")
    trained_on, other = Agent.load(folder), Agent.load(folder, with_motors(2.0, 2.0))
    envs = HFrameVectorEnv(3)
    observation, _ = envs.reset(seed=1)
    first = trained_on.act(observation)
    assert other.act(observation) == pytest.approx(0.5 * first)
    # Both observe the same voltage of the last period, and so they also agree in the next one.
    following = envs.step(first)[0]
    assert other.act(following) == pytest.approx(0.5 * trained_on.act(following), abs=1e-6)


def test_a_correction_of_a_base_controller_keeps_its_voltages():
    mapping = Agent.load(shipped_agent_folder("residual", "reach"), with_motors(2.0, 2.0)).mapping
    observation, _ = HFrameVectorEnv(8).reset(seed=1)
    mapping.augment(observation)
    base, corrected = (mapping.action(np.full((8, 2), output)) for output in (0.0, 0.1))
    unlimited = np.abs(base) < 0.9
    assert unlimited.sum() > 2
    # Far from its goal, the policy adds the largest fraction of the rated voltage that it may.
    assert (corrected - base)[unlimited] == pytest.approx(0.1 * mapping.authority.most)


def test_outputs_that_are_the_actions_are_converted(untrained_policy):
    conversion = ActionConversion(MACHINE, with_motors(2.0, 2.0))
    card = {"name": "plain", "task": "reach", "period": 0.01}
    observation, _ = HFrameVectorEnv(3).reset(seed=1)
    agents = [Agent(untrained_policy, None, MACHINE, card, of) for of in (None, conversion)]
    plain, converted = (agent.act(observation) for agent in agents)
    assert converted == pytest.approx(0.5 * plain)
    assert np.abs(plain).max() > 0.1


@pytest.fixture
def untrained_policy():
    """Return a policy that takes the error along both axes, divided by 1 m, as its outputs."""

    class Policy:
        observation_space = HFrameVectorEnv(1).single_observation_space

        def predict(self, observation, deterministic):
            return observation["desired_goal"] - observation["observation"][:, :2], None

    return Policy()


def test_an_agent_on_another_machine_is_not_saved(tmp_path):
    agent = Agent.load(shipped_agent_folder("ppo", "reach"), with_motors(2.0, 2.0))
    with pytest.raises(InputError, match="was loaded for another machine than that of its training"):
        agent.save(tmp_path)
    assert not any(tmp_path.iterdir())
