"""SAC's policy that weights feedback laws: what its critics evaluate, and where its noise is."""

import pytest
import torch

from hframe_gym.agents.agent import policy_class, policy_keywords
from hframe_gym.agents.features import feature_parameters
from hframe_gym.agents.law_policy import EXPLORATION
from hframe_gym.agents.residual_action import ResidualAction
from hframe_gym.envs import observation_space
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from tests.agents.observations import rest_observation

MACHINE = BUILTIN_MACHINES["hframe"]()
ACTUATION = {"least": 0.1, "transfers": [0, 4], "parts": True}


def new_policy(mapping, **further):
    """Return a policy with random weights."""
    return policy_class("sac", ACTUATION)(
        mapping.observation_space(observation_space(MACHINE)),
        mapping.action_space(),
        lambda _: 1e-3,
        **policy_keywords({"net_arch": [16]}, feature_parameters(MACHINE, transfers=[0, 4])),
        **further,
    )


@pytest.fixture(scope="module")
def mapping():
    return ResidualAction(MACHINE, 0.01, **ACTUATION)


@pytest.fixture(scope="module")
def law_policy(mapping):
    """Return a policy, and the observation of a tool 2 mm from its goal."""
    torch.manual_seed(0)
    policy = new_policy(mapping)
    shown = mapping.augment(rest_observation(MACHINE, (0.1, 0.0), (0.102, 0.0)))
    return policy, {key: torch.from_numpy(shown[key]) for key in policy.observation_space.spaces}


def test_critics_evaluate_the_action_that_results(law_policy):
    policy, observation = law_policy
    outputs = torch.zeros(1, *policy.action_space.shape)
    more_weight, other = outputs.clone(), outputs.clone()
    more_weight[:, 2:] += 0.3  # of all laws: the same mean
    other[:, 2] += 0.3
    for critic in (policy.critic, policy.critic_target):
        value, same, differing = (torch.cat(critic(observation, o)) for o in (outputs, more_weight, other))
        assert torch.allclose(value, same, atol=1e-6)
        assert not torch.allclose(value, differing, atol=1e-4)


def test_only_the_outputs_for_the_drives_are_random(law_policy):
    policy, observation = law_policy
    many = {key: values.expand(64, -1) for key, values in observation.items()}
    sampled, log_prob = policy.actor.action_log_prob(many)
    spread = sampled.std(dim=0)
    assert spread[:2].min() > 0.1
    assert spread[2:].max() < 1e-6
    assert log_prob.shape == (64,)
    assert torch.allclose(policy.actor(many, deterministic=True)[:, 2:], sampled[:, 2:])
    assert sampled.abs().max() <= 1.0


def test_tried_actions_vary_more_than_those_that_the_critics_evaluate(law_policy, mapping):
    _, observation = law_policy
    actor = new_policy(mapping).actor
    torch.nn.init.constant_(actor.log_std.bias, -5.0)  # no saturation
    many = {key: values.expand(4096, -1) for key, values in observation.items()}
    tried, evaluated = actor(many), actor.action_log_prob(many)[0]
    ratio = tried[:, :2].std(dim=0) / evaluated[:, :2].std(dim=0)
    torch.testing.assert_close(ratio, torch.full((2,), EXPLORATION), rtol=0.1, atol=0.0)


def test_the_gradient_of_the_policy_reaches_the_weights_of_the_laws(law_policy):
    policy, observation = law_policy
    outputs, _ = policy.actor.action_log_prob(observation)
    outputs.retain_grad()
    policy.critic(observation, outputs)[0].sum().backward()
    assert outputs.grad[:, 2:].abs().max() > 0.0


def test_noise_that_depends_on_the_state_is_refused(mapping):
    with pytest.raises(InputError, match="remove use_sde = true"):
        new_policy(mapping, use_sde=True)
