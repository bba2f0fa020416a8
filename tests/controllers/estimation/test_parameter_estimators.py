"""Extended Kalman filter of friction, masses and belts: how close its estimates come within a motion."""

import numpy as np
import pytest

from hframe_gym.agents.residual_action import ResidualAction
from hframe_gym.controllers import CONTROLLERS, MotionModel, ParameterFilter
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.machine import BUILTIN_MACHINES, Uncertainty

MACHINE = BUILTIN_MACHINES["hframe"]()
PERIOD, PERIODS, COUNT = 0.01, 15, 64


@pytest.fixture(scope="module")
def motion():
    """Return states (PERIODS + 1, B, 8), actions (PERIODS, B, 2) and log parameter ratios by name."""
    envs = HFrameVectorEnv(COUNT, randomize="default")
    model, controller = MotionModel(MACHINE), CONTROLLERS.get("pid")(MACHINE, PERIOD)
    observation, _ = envs.reset(seed=0)
    states, actions = [model.state(observation)], []
    for _ in range(PERIODS):
        actions.append(controller.act(observation))
        observation = envs.step(actions[-1])[0]
        states.append(model.state(observation))
    ratios = np.log(envs.parameters / np.array(list(MACHINE.parameters.values())))
    return np.array(states), np.array(actions), dict(zip(MACHINE.parameters, ratios.T, strict=True))


def estimated(motion, machine=MACHINE):
    """Return the estimates after the motion."""
    states, actions, _ = motion
    parameter_filter = ParameterFilter(MotionModel(machine), PERIOD)
    parameter_filter.update(states[0], states[0], actions[0], np.ones(COUNT, np.bool_))
    assert not parameter_filter.estimates.any()
    for k in range(PERIODS):
        parameter_filter.update(states[k], states[k + 1], actions[k], np.zeros(COUNT, np.bool_))
    return parameter_filter.estimates


def test_estimates_approach_the_parameters_of_each_episode(motion):
    ratios = motion[2]
    belts = [ratios[f"{b.name}.EA"] - ratios[f"{b.name}.rest_length"] for b in MACHINE.belts]
    names = [f"{name}.{kind}" for kind in ("coulomb", "mass") for name in MACHINE.coordinate_names]
    expected = np.stack([*(ratios[name] for name in names), *belts], axis=1)
    error = np.sqrt(np.mean((estimated(motion) - expected) ** 2, axis=0)) / expected.std(axis=0)
    by_kind = {"friction of the motors": error[2:4], "masses": error[4:8], "belts": error[8:]}
    assert by_kind["friction of the motors"].max() < 0.4
    assert by_kind["masses"].max() < 0.6
    assert by_kind["belts"].max() < 0.3


def test_estimates_of_an_identified_machine_stay_closer_to_its_values(motion):
    name, index = "phi1.coulomb", 2
    value = MACHINE.parameters[name]
    spread = [
        estimated(motion, MACHINE.replace(uncertainty=Uncertainty((name,), np.array([[(r * value) ** 2]]))))
        for r in (1e-3, 5.0)  # well identified, and not at all
    ]
    assert np.std(spread[0][:, index]) < 0.8 * np.std(spread[1][:, index])
    np.testing.assert_allclose(spread[1], estimated(motion))


def test_the_observation_of_a_policy_contains_the_estimates(motion):
    states, actions, _ = motion
    model, mapping = MotionModel(MACHINE), ResidualAction(MACHINE, PERIOD, estimates=True)
    for k in range(PERIODS + 1):
        goal = np.zeros((COUNT, 2))
        augmented = mapping.augment({"observation": model.observation(states[k]), "desired_goal": goal})
        if k < PERIODS:
            mapping.replace_last_action(actions[k])
    assert augmented["estimates"] == pytest.approx(estimated(motion), abs=1e-3)


@pytest.mark.parametrize("delay_s", [6e-3, 13e-3])
def test_the_estimates_for_a_policy_account_for_a_dead_time_of_the_drives(delay_s):
    delayed = MACHINE.with_effects(EFFECTS["input_delay"].at("drives", d=delay_s))

    def estimates(machine):
        controller = CONTROLLERS.get("pid")(machine, PERIOD)
        mapping = ResidualAction(machine, PERIOD, estimates=True, plans=(3,))
        envs = HFrameVectorEnv(8, machine=machine)
        observation, _ = envs.reset(seed=0)
        for _ in range(PERIODS):
            actions = controller.act(observation)
            augmented = mapping.augment(observation)
            mapping.replace_last_action(actions)
            observation = envs.step(actions)[0]
        return np.abs(augmented["estimates"]).max()

    # The machines have their declared parameters. With the voltages as sent, estimates reach their limit of
    # 1.2.
    assert estimates(MACHINE) < 0.02
    assert estimates(delayed) < 0.03
