"""Analytic policy gradient: train a policy by backpropagation through simulated episodes.

PPO estimates the gradient of the return from the noise of its actions. Here the chain rule computes it: an
episode is a chain of policy and machine, and backpropagation through time gives the derivatives of its cost
with respect to the weights of the policy. The derivatives of the machine over one control period are those of
`DifferentiableMotion`.

With exact derivatives, static friction would hide that a higher voltage moves a resting tool, and derivatives
grow from period to period where the tool is close to its goal. Three measures keep the gradient useful: the
derivatives of static friction are smoothed (`dynamics.Friction`); the derivative with respect to the state is
multiplied by a discount in every period; and its norm is limited in every period.

Importing this module needs the extra `agents`.

References:
    Werbos (1990), Backpropagation through time: what it does and how to do it.
    Xu et al. (2022), Accelerated policy learning with parallel differentiable simulation.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.ppo import MultiInputPolicy

from ..controllers import MotionModel
from ..errors import InputError
from .differentiable_episode import (
    SAMPLES,
    SimulatedPeriod,
    differentiable_period,
    limited,
    path_cost,
    path_errors,
    reach_cost,
)
from .sb3_adapters import ResidualActionVecEnv, set_mean_action_to_zero
from .weight_average import update_average

LARGEST_NORM = 1.0  # of the gradient with respect to the weights


class AnalyticPolicyGradient:
    """Analytic policy gradient with the interface that a training run uses of a stable-baselines3 algorithm.

    Every update simulates one episode in each environment. A random number of periods at its beginning are
    not differentiated. This saves time, and lets the later periods, in which the tool arrives, count as much
    as the first.

    Args:
        policy: Name of the policy class; "MultiInputPolicy" is the only one.
        env: Environments whose resets provide machines, starts and goals.
        learning_rate: Learning rate of Adam as a function of the fraction of the run that remains.
        seed: Seed of the weights and of the number of periods at the beginning that are not differentiated.
        policy_kwargs: Keyword arguments of the policy class.
        periods: Control periods of an episode.
        skipped: Largest number of periods at the beginning that are not differentiated.
        discount: Factor, 0 to 1, by which backpropagation multiplies the derivative of the cost with respect
            to the state in every period.
        limit: Largest norm of this derivative, for the cost of one episode, dimensionless, with travel in
            units of 1 mm and velocity in units of 50 mm/s. A longer derivative is scaled to this norm.
        averaging: Factor of the exponential moving average of the weights per update, 0 to below 1.

    Attributes:
        policy: Policy with averaged weights (exponential moving average), which is evaluated and saved.
        num_timesteps: Environment steps so far.
        generators: Generators of all random numbers that do not come from torch or the environment.

    Raises:
        InputError: If there is no action mapping, or it has a base controller without the method `gain`, so
            that its derivatives are not known.
    """

    def __init__(
        self,
        policy: str,
        env: Any,
        learning_rate: Callable[[float], float],
        *,
        seed: int,
        device: str,
        policy_kwargs: Mapping[str, Any],
        periods: int,
        skipped: int,
        discount: float,
        limit: float,
        averaging: float,
    ) -> None:
        inner: Any = getattr(env, "venv", None)
        if not isinstance(env, ResidualActionVecEnv) or (
            env.mapping.base and not hasattr(env.mapping.base, "gain")
        ):
            raise InputError(
                "analytic gradients need an [actuation] without a base controller, or with base predictive"
            )
        torch.manual_seed(seed)
        self.env, self.mapping = env, env.mapping
        self._envs = inner.envs
        self._model = MotionModel(self._envs.machine)
        # Full-state observations are linear in the state: observation = state @ _observed.
        self._observed = torch.from_numpy(self._model.observation(np.eye(2 * len(self._model.mass))))
        self._period = SimulatedPeriod(self._envs.machine, self.mapping.period)
        self._generator = np.random.default_rng(seed)
        self._learning_rate, self._periods, self._skipped = learning_rate, periods, skipped
        self._discount, self._limit, self._averaging = discount, limit, averaging
        space: Any = env.observation_space
        self._trained: Any = MultiInputPolicy(space, env.action_space, lambda _: 0.0, **policy_kwargs)
        if self.mapping.base:
            set_mean_action_to_zero(self._trained)
        self.policy = copy.deepcopy(self._trained)
        self._optimizer = torch.optim.Adam(self._trained.parameters())
        self.num_timesteps, self._updates = 0, 0
        self.logger: Any = None
        self.action_space = env.action_space
        self.generators = (self._generator,)

    def set_logger(self, logger: Any) -> None:
        """Set the attribute `logger`, to which the caller writes scores, as with stable-baselines3."""
        self.logger = logger

    def learn(self, total_timesteps: int, callback: BaseCallback, reset_num_timesteps: bool = False) -> None:
        """Train the policy for a number of further environment steps, rounded up to complete updates.

        An update simulates one episode in every environment and changes the weights once.

        Args:
            total_timesteps: Number of further environment steps, summed over all environments.
            callback: Its `on_rollout_start` is called before each update, its `on_step` after it.
            reset_num_timesteps: Whether to set the attribute `num_timesteps` to zero first.
        """
        if reset_num_timesteps:
            self.num_timesteps = 0
        if self._updates == 0:  # the recipe may have loaded the first weights from an agent
            self._trained.load_state_dict(self.policy.state_dict())
        final = self.num_timesteps + total_timesteps
        callback.init_callback(self)  # type: ignore[arg-type]
        while self.num_timesteps < final:
            callback.on_rollout_start()
            rate = self._learning_rate(1.0 - self.num_timesteps / final)
            for group in self._optimizer.param_groups:
                group["lr"] = rate
            self._update()
            self.num_timesteps += self._envs.num_envs * self._periods
            callback.on_step()

    def _update(self) -> None:
        """Simulate one episode in each environment and change the weights by the gradient of its cost."""
        costs = self._episode_costs(int(self._generator.integers(self._skipped + 1)))
        self._optimizer.zero_grad()
        costs[torch.isfinite(costs)].mean().backward()
        norm = torch.nn.utils.clip_grad_norm_(self._trained.parameters(), LARGEST_NORM)
        if torch.isfinite(norm):
            self._optimizer.step()
        self._updates += 1
        update_average(self.policy, self._trained, self._averaging, self._updates)

    def _episode_costs(self, skipped: int) -> Any:
        """Simulate one episode in each environment; return costs (B,) without the first `skipped` periods."""
        self.env.venv.reset()
        self.mapping.reset()
        batch, model = self._envs.batch, self._model
        parameters = self._envs.parameters
        references = batch.references
        has_path = batch.task.metrics == "track"
        state = torch.from_numpy(model.goal_state(model.axis_travel(batch.simulator.tool_positions())))
        last_observation, last_action, costs = None, None, []
        last_volts = torch.zeros((len(state), len(model.rated)), dtype=torch.float64)
        limit = self._limit / len(state)  # because the mean over the episodes is differentiated
        for k in range(self._periods):
            observation = {"observation": model.observation(state.detach().numpy()).astype(np.float32)}
            references.add_blank(observation)
            references.write(slice(None), observation)
            entries: dict[str, Any] = {
                key: torch.from_numpy(v) for key, v in self.mapping.augment(observation).items()
            }
            with torch.set_grad_enabled(k >= skipped):
                # Tensors with derivatives with respect to the state and earlier actions replace arrays of
                # equal values.
                entries["observation"] = (state @ self._observed).float()
                if last_observation is not None:
                    entries |= {"last_observation": last_observation, "last_action": last_action}
                action = limited(self._action(entries) + self._base_action(entries, state))
                self.mapping.replace_last_action(action.detach().numpy().astype(np.float64))
                last_observation, last_action = entries["observation"], action
                volts = action.double() * torch.from_numpy(model.rated)
                references.advance()
                if k < skipped:
                    motions = self._period.simulate(
                        state.numpy(), volts.numpy(), last_volts.numpy(), parameters
                    )
                    state = torch.from_numpy(self._period.outputs(motions))[:, : state.shape[1]]
                    last_volts = volts
                    continue
                outputs = differentiable_period(
                    state, volts, last_volts, parameters, self._period, limit, self._discount
                )
                last_volts = volts
                state, tool = outputs[:, : state.shape[1]], outputs[:, state.shape[1] :]
                tool = tool.reshape(len(tool), SAMPLES, -1)
                if has_path:
                    costs.append(path_errors(tool, references) * self.mapping.meters**2)
                else:
                    goal = entries["desired_goal"] * self.mapping.meters
                    costs.append(reach_cost(tool * self.mapping.meters, goal))
        by_period = torch.stack(costs, dim=1)
        return path_cost(by_period) * len(costs) if has_path else by_period.sum(1)

    def _action(self, entries: Mapping[str, Any]) -> Any:
        """Return the contribution (B, drives) of the trained policy to the actions."""
        policy = self._trained
        output = policy.action_net(policy.mlp_extractor.forward_actor(policy.extract_features(entries)))
        goal, observation = entries["desired_goal"], entries["observation"]
        meters = self.mapping.meters
        distance = meters * torch.linalg.vector_norm(goal - observation[:, : goal.shape[1]], dim=1)
        speed = meters * torch.linalg.vector_norm(observation[:, self.mapping.tool_speeds], dim=1)
        laws = None
        if self.mapping.laws:  # linear in the state; what they were designed with counts as constant
            volts, gains = (torch.from_numpy(values).float() for values in self.mapping.laws)
            laws = volts + torch.einsum("bkij,bj->bki", gains, observation - observation.detach())
        return self.mapping.parts(distance, speed, entries["last_action"], laws).action(limited(output))

    def _base_action(self, entries: Mapping[str, Any], state: Any) -> Any:
        """Return the actions (B, drives) of the base controller, linear in the state (B, 2 n), or zero."""
        base: Any = self.mapping.base
        if base is None:
            return 0.0
        if not torch.is_grad_enabled():
            return entries["base_action"]
        gain = torch.from_numpy(base.gain() / self._model.rated[:, None])
        return entries["base_action"] + torch.einsum("bij,bj->bi", gain, state - state.detach()).float()

    def save(self, path: str | Path) -> None:
        """Write weights, optimizer and counters of the training to a file; reading it executes no code."""
        state = {
            "trained": self._trained.state_dict(),
            "averaged": self.policy.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "steps": self.num_timesteps,
            "updates": self._updates,
        }
        torch.save(state, path)

    def restore(self, path: str | Path) -> None:
        """Load weights, optimizer and counters from a file that `save` wrote, to continue the training.

        The policy must have the same layers as the saved one. `generators` keep their present states.
        """
        state = torch.load(path, weights_only=True)
        self._trained.load_state_dict(state["trained"])
        self.policy.load_state_dict(state["averaged"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.num_timesteps, self._updates = state["steps"], state["updates"]
