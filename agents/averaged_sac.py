"""SAC whose averaged actor is evaluated and kept, and which continues an actor. It needs the extra `agents`.

The actor of SAC follows critics that change all the time: settling times of successive evaluations vary by
more than a percent. The average of its weights over some thousand gradient steps is better than all of them.
Weights from which a training continues are those of an actor alone: the critics begin at random, and would
move the actor away from what it has learned before they know anything. `critic_steps` lets them learn first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.utils import update_learning_rate
from typing_extensions import override

from .weight_average import update_average


class AveragedSAC(SAC):
    """SAC with a moving average of its actor, a schedule of its target entropy and a start of its critics.

    Args:
        averaging: Factor of the exponential moving average of the actor's weights per rollout, 0 to below 1;
            with 0, the actor itself is evaluated.
        target_entropy: As for `SAC`, or a function of the fraction of the run that remains.
        critic_steps: Environment steps until which the critics alone learn: actor and entropy coefficient
            stay as they are.
    """

    @override
    def __init__(
        self,
        policy: Any,
        env: Any,
        *,
        averaging: float = 0.0,
        target_entropy: str | float | Callable[[float], float] = "auto",
        critic_steps: int = 0,
        **keywords: Any,
    ) -> None:
        self.averaging, self.critic_steps = averaging, critic_steps
        self.entropy_schedule = target_entropy if callable(target_entropy) else None
        first = target_entropy(1.0) if callable(target_entropy) else target_entropy
        super().__init__(policy, env, target_entropy=first, **keywords)

    @property
    def evaluated_policy(self) -> Any:
        """Policy with the averaged actor, or the trained policy until there is an average."""
        return self._averaged_policy if self.averaging and self._n_updates else self.policy

    @override
    def _setup_model(self) -> None:
        super()._setup_model()
        with torch.random.fork_rng(devices=[]):  # the run draws what it draws without an average
            self._averaged_policy = self.policy_class(
                self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
            ).to(self.device)
        self._averaged_policy.load_state_dict(self.policy.state_dict())

    @override
    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Train as SAC does, with the scheduled target entropy, and update the average of the actor."""
        if self.entropy_schedule:
            self.target_entropy = self.entropy_schedule(self._current_progress_remaining)
        super().train(gradient_steps, batch_size)
        if self.averaging:
            rollouts = self._n_updates // gradient_steps
            update_average(self._averaged_policy.actor, self.actor, self.averaging, rollouts)

    @override
    def _update_learning_rate(self, optimizers: Any) -> None:
        super()._update_learning_rate(optimizers)
        if self.num_timesteps <= self.critic_steps:
            for optimizer in optimizers:
                if optimizer is not self.critic.optimizer:
                    update_learning_rate(optimizer, 0.0)

    @override
    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_averaged_policy"]

    @override
    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        modules, tensors = super()._get_torch_save_params()
        return [*modules, "_averaged_policy"], tensors
