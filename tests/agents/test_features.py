"""Features and actuation: what a policy sees and how its output is scaled."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from hframe_gym.agents.features import StageFeatures, features_for
from hframe_gym.agents.residual_action import Authority, ResidualAction

from hframe_gym.controllers import ModelBasedController
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.envs.spaces import observation_space
from hframe_gym.machine import BUILTIN_MACHINES, rest_state

MACHINE = BUILTIN_MACHINES["hframe"]()


def at_rest(position, goal):
    """An observation of one stage at rest with unstretched belts."""
    full = rest_state(MACHINE, [*position])
    names = MACHINE.coordinate_names
    order = [names.index(c) for c in ("x", "y", *(d.coordinate for d in MACHINE.drives))]
    state = np.concatenate([full[order], np.zeros(4)])
    return {
        "observation": state[None].astype(np.float32),
        "achieved_goal": np.array([position], np.float32),
        "desired_goal": np.array([goal], np.float32),
    }


def features(observation):
    space = observation_space(MACHINE)
    extractor = StageFeatures(space, **features_for(MACHINE))
    return extractor({k: torch.as_tensor(v) for k, v in observation.items()}).numpy()[0]


def test_all_but_the_place_vanish_at_rest_at_the_goal():
    seen = features(at_rest((0.1, -0.05), (0.1, -0.05)))
    # float32 positions are good to some 1e-8 m, a ten-thousandth of the finest scale.
    assert np.abs(seen[2:]).max() < 1e-3
    assert seen[0] > 0.0 > seen[1]


def test_tenth_of_a_millimetre_is_seen():
    near, at = (features(at_rest((0.1 + off, -0.05), (0.1, -0.05))) for off in (1e-4, 0.0))
    assert np.abs(near - at).max() > 0.05


def test_features_are_of_order_one():
    envs = HFrameVectorEnv(64, randomize="default")
    observation, _ = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(30):
        observation = envs.step(rng.uniform(-1.0, 1.0, (64, 2)).round())[0]
    space = envs.single_observation_space
    assert isinstance(space, gym.spaces.Dict)
    extractor = StageFeatures(space, **features_for(MACHINE))
    seen = extractor({k: torch.as_tensor(v) for k, v in observation.items()})
    assert seen.shape == (64, extractor.features_dim)
    assert 0.5 < float(seen.abs().max()) < 1.5


@pytest.mark.parametrize(
    ("distance", "share"), [(0.0, 0.06), (1e-3, 0.26), (0.1, 1.0)], ids=["at the goal", "near", "far"]
)
def test_authority_grows_with_the_distance(distance, share):
    given = Authority(least=0.06)(at_rest((0.1 + distance, 0.0), (0.1, 0.0)), slice(4, 6))
    assert given == pytest.approx(share, rel=1e-3)


def test_actuation_remembers_one_period_and_forgets_at_a_reset():
    envs = HFrameVectorEnv(3, randomize="none")
    actuation = ResidualAction(MACHINE, 0.01, base="pid", least=0.1)
    observation, _ = envs.reset(seed=0)
    seen = actuation.see(observation)
    assert np.array_equal(seen["last_observation"], observation["observation"])
    assert not seen["last_action"].any()
    action = actuation.apply(np.full((3, 2), 0.5))
    moved = envs.step(action)[0]
    seen = actuation.see(moved)
    assert np.array_equal(seen["last_observation"], observation["observation"])
    assert np.array_equal(seen["last_action"], action.astype(np.float32))
    actuation.reset(np.array([True, False, False]))
    seen = actuation.see(moved)
    assert not seen["last_action"][0].any()
    assert np.array_equal(seen["last_observation"][0], moved["observation"][0])
    assert actuation.space(observation_space(MACHINE)).contains({key: values[1] for key, values in seen.items()})


def test_the_base_is_told_what_was_applied():
    """Its next action builds on the voltage that a stage held by friction had, whoever gave it."""
    observation = at_rest((0.1, 0.0), (0.10005, 0.0))
    alone, under = ModelBasedController(MACHINE, 0.01), ResidualAction(MACHINE, 0.01, base="pid", least=1.0)
    for _ in range(3):
        own = alone.act(observation)
        under.see(observation)
        under.apply(np.zeros((1, 2)))
    under.see(observation)
    given = under.apply(np.array([[0.05, -0.02]]))
    more = under.see(observation)["base_action"] - given
    assert more == pytest.approx(alone.act(observation) - own, rel=1e-3)
