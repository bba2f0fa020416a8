"""Policy of SAC that weights feedback laws, with critics of the action. The import needs the extra `agents`.

Such a policy has many outputs, and only the action that results from them acts on the machine. Critics of the
outputs would have to learn, for every state, how the outputs form the action. These critics compute it from
the `ActionParts` in the observation, and the gradient of the policy follows the same way back.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import SquashedDiagGaussianDistribution
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import create_mlp
from stable_baselines3.sac.policies import Actor, MultiInputPolicy
from torch import nn
from typing_extensions import override

from ..errors import InputError
from .differentiable_episode import limited
from .residual_action import ActionParts

# Standard deviation of the actions that are tried, over that of the policy which the critics evaluate: they
# learn what other voltages are worth from noise that would delay the arrival.
EXPLORATION = 3.0


class LawActor(Actor):
    """Actor that explores only with its outputs for the drives, not with the weights of the feedback laws."""

    action_dist: Any  # of the outputs for the drives
    log_std: Any

    @override
    def __init__(self, observation_space: spaces.Dict, *further: Any, **keywords: Any) -> None:
        super().__init__(observation_space, *further, **keywords)
        self._drives = spaces.flatdim(observation_space["action_offset"])
        self.action_dist = SquashedDiagGaussianDistribution(self._drives)
        self.log_std = nn.Linear(self.log_std.in_features, self._drives)

    @override
    def forward(self, obs: Any, deterministic: bool = False) -> Any:
        """Return outputs for drives and laws, dimensionless, shape (batch, drives + laws).

        Args:
            obs: Observation by key, shape (batch, entries) each.
            deterministic: Whether the outputs for the drives are not sampled; those for the laws never are.
        """
        mean, log_std, _ = self.get_action_dist_params(obs)
        wider = log_std + math.log(EXPLORATION)
        explored = self.action_dist.actions_from_params(mean[:, : self._drives], wider, deterministic)
        return self._joined(explored, mean)

    @override
    def action_log_prob(self, obs: Any) -> Any:
        """Sample outputs for an observation, as the training of SAC needs them.

        Returns:
            Outputs for drives and laws, shape (batch, drives + laws), and the log-probability of those for
            the drives alone, shape (batch,).
        """
        mean, log_std, _ = self.get_action_dist_params(obs)
        explored, log_prob = self.action_dist.log_prob_from_params(mean[:, : self._drives], log_std)
        return self._joined(explored, mean), log_prob

    def _joined(self, explored: Any, mean: Any) -> Any:
        """Return the outputs for the drives and those for the laws, (batch, drives + laws)."""
        return torch.cat([explored, torch.tanh(mean[:, self._drives :])], dim=1)


class ActionCritic(ContinuousCritic):
    """Critics of the action that results from the policy's outputs, instead of the outputs themselves."""

    @override
    def __init__(self, **keywords: Any) -> None:
        super().__init__(**keywords)
        layers = {key: keywords[key] for key in ("net_arch", "activation_fn")}
        self.q_networks = [
            nn.Sequential(*create_mlp(keywords["features_dim"], 1, **layers)) for _ in self.q_networks
        ]
        for k, network in enumerate(self.q_networks):
            self.add_module(f"qf{k}", network)

    @override
    def forward(self, obs: Any, actions: Any) -> Any:
        """Estimate the returns of observations and policy outputs by all critics.

        Args:
            obs: Observation by key, with `action_offset`, `authority` and `law_actions`
                (`ResidualAction.history`), shape (batch, entries) each.
            actions: Outputs for drives and laws, dimensionless, shape (batch, drives + laws). If they need a
                gradient, the critics get none.

        Returns:
            One tensor for each critic, shape (batch, 1).
        """
        self.requires_grad_(not actions.requires_grad)  # the loss of the actor does not change the critics
        offset = obs["action_offset"]
        laws = obs["law_actions"].unflatten(1, (-1, offset.shape[1]))
        action = limited(ActionParts(offset, obs["authority"], laws).action(actions))
        features = self.features_extractor({**obs, "action": action})
        return tuple(network(features) for network in self.q_networks)


class LawPolicy(MultiInputPolicy):
    """Policy of SAC with `LawActor` and `ActionCritic`.

    It observes the `ActionParts` and excludes `use_sde`.
    """

    @override
    def __init__(self, *arguments: Any, use_sde: bool = False, **keywords: Any) -> None:
        if use_sde:
            raise InputError(
                "parts = true: the noise of this policy cannot depend on the state; remove use_sde = true"
            )
        super().__init__(*arguments, **keywords)

    @override
    def make_actor(self, features_extractor: Any = None) -> Any:
        """Create a `LawActor`, as stable-baselines3 asks for it."""
        keywords = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return LawActor(**keywords).to(self.device)

    @override
    def make_critic(self, features_extractor: Any = None) -> Any:
        """Create an `ActionCritic`, which observes the action as well, as stable-baselines3 asks for it."""
        known = self.observation_space
        assert isinstance(known, spaces.Dict)
        judged = spaces.Dict({**known.spaces, "action": known["action_offset"]})
        extractor = self.features_extractor_class(judged, **self.features_extractor_kwargs)
        keywords = self._update_features_extractor(self.critic_kwargs, extractor)
        return ActionCritic(**keywords).to(self.device)
