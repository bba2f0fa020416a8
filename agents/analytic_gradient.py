"""Analytic policy gradient: train a policy by backpropagation through simulated episodes.

PPO estimates the gradient of the return from the noise of its actions. Here the chain rule computes it: an episode is a
chain of policy and machine, and backpropagation through time gives the derivatives of its cost by the weights. The
derivatives of the machine over one control period are finite differences of the compiled simulator: 11 simulations of
10 ms for a state of 8 and an action of 2 entries, which take about as long as the network.

Static friction makes the motion depend discontinuously on state and voltage, and small errors at the goal grow over
many periods. Three measures keep the gradient useful: the differences have random steps, which smooths the derivatives;
the derivative by the state is discounted per period; and it is limited in every episode.

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
from numpy.typing import NDArray
from stable_baselines3.ppo import MultiInputPolicy

from ..controllers import MotionModel
from ..dynamics import simulate_batch
from ..envs.end_stops import with_end_stops
from ..errors import InputError
from ..machine import Machine
from .sb3_adapters import ResidualActionVecEnv

Array = NDArray[np.float64]
SAMPLES = 2  # samples of the tool position per control period that enter the cost
INTEGRATION_STEP = 1e-3  # s, twice that of the environment; the gradient needs no higher accuracy
# Steps of the finite differences: belt travel, m, its rate, m/s, and the range of the voltages, V. Friction takes up to
# 0.7 V; steps of this size show a policy at rest that a higher voltage moves the tool.
TRAVEL_STEP, RATE_STEP, VOLTAGE_STEPS = 2e-5, 5e-3, (0.05, 0.3)
# Units of travel, m, and rate, m/s, in which the derivative by the state is limited: typical changes in one period.
TRAVEL_UNIT, RATE_UNIT = 1e-3, 0.05
# Lengths s, m, and weights w of the cost sum w d / (d + s) of a distance d: the reward "dense", with more weight on the
# last tenths of a millimeter.
COST_SCALES, COST_WEIGHTS = (2e-1, 2e-2, 2e-3, 2e-4, 2e-5), (0.1, 0.1, 0.2, 0.34, 0.26)
SMALLEST_DISTANCE = 1e-6  # m, below which the cost is smooth
LARGEST_NORM = 1.0  # of the gradient by the weights


class SimulatedPeriod:
    """One control period of B machines with n coordinates and d drives, and its derivatives by finite differences.

    Args:
        machine: Machine that is simulated, with end stops.
        period: Control period, s.
        seed: Seed of the random steps of the differences.
    """

    def __init__(self, machine: Machine, period: float, seed: int) -> None:
        self._machine = with_end_stops(machine)
        self._coordinates, self._drives = len(machine.coordinates), len(machine.drives)
        self._tool = [machine.coordinate_names.index(name) for name in machine.tool_axes]
        self._units = np.tile(machine.travel_per_unit, 2)
        self._end_stops = np.array(list(self._machine.parameters.values()))[len(machine.parameters) :]
        self._time_s = np.linspace(0.0, period, SAMPLES + 1)
        self._generator = np.random.default_rng(seed)

    def outputs(self, state: Array, volts: Array, parameters: Array) -> Array:
        """Simulate one period.

        Args:
            state: Belt travel (radius * angle if rotary) of the coordinates and its rate, m and m/s, shape (B, 2 n).
            volts: Voltages of the drives, V, shape (B, d).
            parameters: Parameters of the machines in the order of `Machine.parameters`, SI, shape (B, P).

        Returns:
            State at the end of the period, then the tool positions at SAMPLES equally spaced times, the last of which
            is the end, m; shape (B, 2 n + 2 SAMPLES).
        """
        motion = simulate_batch(
            self._machine,
            self._time_s,
            np.broadcast_to(volts[:, None], (len(volts), len(self._time_s), self._drives)),
            parameters=np.hstack([parameters, np.tile(self._end_stops, (len(parameters), 1))]),
            start=state / self._units,
            longest_step=INTEGRATION_STEP,
            readings=False,
            parallel=False,
        )
        end = np.concatenate([motion.positions[:, -1], motion.velocities[:, -1]], axis=1) * self._units
        return np.hstack([end, motion.positions[:, 1:, self._tool].reshape(len(state), -1)])

    def differences(self, state: Array, volts: Array, parameters: Array) -> tuple[Array, Array]:
        """Simulate one period, and again with every entry of state and voltages changed by a random step.

        Args:
            state: As for `outputs`.
            volts: As for `outputs`.
            parameters: As for `outputs`.

        Returns:
            outputs: Result of `outputs`, shape (B, o).
            derivatives: Difference quotients of the outputs by the entries of state and voltages, shape
                (2 n + d, B, o).
        """
        inputs = np.hstack([state, volts])
        batch, entries = inputs.shape
        steps = np.tile(np.repeat([TRAVEL_STEP, RATE_STEP, 1.0], [self._coordinates] * 2 + [self._drives]), (batch, 1))
        lowest, highest = np.log(VOLTAGE_STEPS)
        steps[:, -self._drives :] = np.exp(self._generator.uniform(lowest, highest, volts.shape))
        steps *= np.where(self._generator.random(steps.shape) < 0.5, -1.0, 1.0)
        changed = np.tile(inputs, (1 + entries, 1, 1))
        for i in range(entries):
            changed[1 + i, :, i] += steps[:, i]
        rows = changed.reshape(-1, entries)
        split = state.shape[1]
        results = self.outputs(rows[:, :split], rows[:, split:], np.tile(parameters, (1 + entries, 1)))
        results = results.reshape(1 + entries, batch, -1)
        return results[0], (results[1:] - results[0]) / steps.T[:, :, None]


class _Period(torch.autograd.Function):
    """Outputs of `SimulatedPeriod` as a differentiable function of state and voltages."""

    @staticmethod
    def forward(
        ctx: Any, state: Any, volts: Any, parameters: Array, period: SimulatedPeriod, limit: float, discount: float
    ) -> Any:
        outputs, ctx.derivatives = period.differences(state.detach().numpy(), volts.detach().numpy(), parameters)
        ctx.limit, ctx.discount, ctx.states = limit, discount, state.shape[1]
        return torch.from_numpy(outputs)

    @staticmethod
    def backward(ctx: Any, gradient: Any) -> Any:  # type: ignore[override]
        change = np.nan_to_num(np.einsum("bo,ibo->bi", gradient.numpy(), ctx.derivatives))
        by_state = change[:, : ctx.states] * np.repeat([TRAVEL_UNIT, RATE_UNIT], ctx.states // 2)
        norm = np.linalg.norm(by_state, axis=1, keepdims=True)
        change *= np.minimum(1.0, ctx.limit / np.maximum(norm, 1e-12))
        change[:, : ctx.states] *= ctx.discount
        by_state, by_volts = change[:, : ctx.states], change[:, ctx.states :]
        return torch.from_numpy(by_state), torch.from_numpy(by_volts), None, None, None, None


class _Limit(torch.autograd.Function):
    """Limit to [-1, 1] whose gradient is zero only where a descent step would lead farther outside."""

    @staticmethod
    def forward(ctx: Any, values: Any) -> Any:
        ctx.save_for_backward(values)
        return values.clamp(-1.0, 1.0)

    @staticmethod
    def backward(ctx: Any, gradient: Any) -> Any:  # type: ignore[override]
        (values,) = ctx.saved_tensors
        return gradient * ((values.abs() <= 1.0) | (values * gradient > 0.0))


_differentiable_period: Any = _Period.apply
_limited: Any = _Limit.apply


def distance_cost(distance: Any) -> Any:
    """Compute the cost sum w d / (d + s) of distances d over the lengths s of `COST_SCALES` with `COST_WEIGHTS`.

    Args:
        distance: Distances, m, tensor of any shape.

    Returns:
        Costs, 0 to 1, tensor of the same shape.
    """
    scales, weights = (torch.tensor(values, dtype=distance.dtype) for values in (COST_SCALES, COST_WEIGHTS))
    return (weights * distance[..., None] / (distance[..., None] + scales)).sum(-1)


class AnalyticPolicyGradient:
    """Analytic policy gradient with the interface that a training run uses of a stable-baselines3 algorithm.

    Every update simulates one episode in each environment. The first periods are not differentiated: their number is
    random, which saves time and lets later periods, in which the tool arrives, count as much as the first ones.

    Args:
        policy: Name of the policy class; "MultiInputPolicy" is the only one.
        env: Environments whose resets provide machines, starts and goals.
        learning_rate: Learning rate of Adam as a function of the fraction of the run that remains.
        seed: Seed of weights and finite differences.
        device: "cpu".
        policy_kwargs: Keyword arguments of the policy class.
        periods: Control periods of an episode.
        skipped: Largest number of periods at the beginning that are not differentiated.
        discount: Factor per period of the derivative by the state, 0 to 1.
        limit: Limit of this derivative per episode, in costs of a period per 1 mm and 50 mm/s.
        averaging: Fraction of the averaged weights that remains in an update, 0 to below 1.

    Attributes:
        policy: Policy with averaged weights (exponential moving average), which is evaluated and saved.
        num_timesteps: Environment steps so far, without the additional simulations of the differences.
        logger: Logger of stable-baselines3.

    Raises:
        InputError: If the goal moves, or the action mapping has a base controller, whose derivatives are not known.
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
        if not isinstance(env, ResidualActionVecEnv) or env.mapping.base or inner.envs.batch.references.moving:
            raise InputError("analytic gradients need a goal at rest and an [actuation] without a base controller")
        torch.manual_seed(seed)
        self.env, self.mapping = env, env.mapping
        self._envs = inner.envs
        self._model = MotionModel(self._envs.machine)
        # Full-state observations are linear in the state: observation = state @ _observed.
        self._observed = torch.from_numpy(self._model.observation(np.eye(2 * len(self._model.mass))))
        self._period = SimulatedPeriod(self._envs.machine, self.mapping.period, seed)
        self._generator = np.random.default_rng(seed)
        self._learning_rate, self._periods, self._skipped = learning_rate, periods, skipped
        self._discount, self._limit, self._averaging = discount, limit, averaging
        space: Any = env.observation_space
        self._trained: Any = MultiInputPolicy(space, env.action_space, lambda _: 0.0, **policy_kwargs)
        self.policy = copy.deepcopy(self._trained)
        self._optimizer = torch.optim.Adam(self._trained.parameters())
        self.num_timesteps, self._updates = 0, 0
        self.logger: Any = None

    def set_logger(self, logger: Any) -> None:
        """Set the logger.

        Args:
            logger: Logger of stable-baselines3.
        """
        self.logger = logger

    def learn(self, total_timesteps: int, callback: Callable[..., bool], reset_num_timesteps: bool = False) -> None:
        """Train for a number of environment steps, rounded up to complete updates.

        Args:
            total_timesteps: Number of environment steps.
            callback: Function that is called after every update with local and global variables.
            reset_num_timesteps: Whether to count the steps from zero.
        """
        if reset_num_timesteps:
            self.num_timesteps = 0
        final = self.num_timesteps + total_timesteps
        while self.num_timesteps < final:
            rate = self._learning_rate(1.0 - self.num_timesteps / final)
            for group in self._optimizer.param_groups:
                group["lr"] = rate
            self._update()
            self.num_timesteps += self._envs.num_envs * self._periods
            callback(locals(), globals())

    def _update(self) -> None:
        """Simulate one episode in each environment and change the weights by the gradient of its cost."""
        costs = self._episode_costs(int(self._generator.integers(self._skipped + 1)))
        self._optimizer.zero_grad()
        costs[torch.isfinite(costs)].mean().backward()
        norm = torch.nn.utils.clip_grad_norm_(self._trained.parameters(), LARGEST_NORM)
        if torch.isfinite(norm):
            self._optimizer.step()
        self._updates += 1
        # The first weights are random: the average forgets them faster.
        kept = min(self._averaging, self._updates / (self._updates + 9.0))
        with torch.no_grad():
            for average, weights in zip(self.policy.parameters(), self._trained.parameters(), strict=True):
                average.lerp_(weights, 1.0 - kept)

    def _episode_costs(self, skipped: int) -> Any:
        """Simulate one episode in each environment; return the costs (B,) of its periods from `skipped` on."""
        self.env.venv.reset()
        self.mapping.reset()
        batch, model = self._envs.batch, self._model
        parameters, references = self._envs.parameters, batch.references
        state = torch.from_numpy(model.goal_state(batch.simulator.tools()))
        last_observation, last_action, costs = None, None, []
        limit = self._limit / len(state)  # the mean over the episodes is differentiated
        for k in range(self._periods):
            observation = {"observation": model.observation(state.detach().numpy()).astype(np.float32)}
            references.add_blank(observation)
            references.write(slice(None), observation)
            entries: dict[str, Any] = {key: torch.from_numpy(v) for key, v in self.mapping.augment(observation).items()}
            with torch.set_grad_enabled(k >= skipped):
                # What depends on the state and on earlier actions replaces the arrays of the same values.
                entries["observation"] = (state @ self._observed).float()
                if last_observation is not None:
                    entries |= {"last_observation": last_observation, "last_action": last_action}
                action = self._action(entries)
                self.mapping.replace_last_action(action.detach().numpy().astype(np.float64))
                last_observation, last_action = entries["observation"], action
                volts = action.double() * torch.from_numpy(model.rated)
                references.advance()
                if k < skipped:
                    arrays = self._period.outputs(state.numpy(), volts.numpy(), parameters)
                    state = torch.from_numpy(arrays)[:, : state.shape[1]]
                    continue
                outputs = _differentiable_period(state, volts, parameters, self._period, limit, self._discount)
                state, tool = outputs[:, : state.shape[1]], outputs[:, state.shape[1] :]
                costs.append(self._period_cost(tool.reshape(len(tool), SAMPLES, -1), entries["desired_goal"]))
        return torch.stack(costs, dim=1).sum(1)

    def _action(self, entries: Mapping[str, Any]) -> Any:
        """Compute the actions (B, drives) of the policy that is trained, limited to [-1, 1]."""
        policy = self._trained
        output = policy.action_net(policy.mlp_extractor.forward_actor(policy.extract_features(entries)))
        goal, observation = entries["desired_goal"], entries["observation"]
        distance = torch.linalg.vector_norm(goal - observation[:, : goal.shape[1]], dim=1)
        speed = torch.linalg.vector_norm(observation[:, self.mapping.tool_speeds], dim=1)
        return _limited(self.mapping.combine(_limited(output), distance, speed, entries["last_action"]))

    def _period_cost(self, tool: Any, goal: Any) -> Any:
        """Return the cost (B,) of tool positions (B, SAMPLES, axes), m, with goals (B, axes)."""
        squares = ((tool - goal.double()[:, None]) ** 2).sum(2)
        return distance_cost(torch.sqrt(squares + SMALLEST_DISTANCE**2)).mean(1)

    def save(self, path: str | Path) -> None:
        """Write the state of the training to a file that `load` reads without executing code.

        Args:
            path: File.
        """
        state = {
            "trained": self._trained.state_dict(),
            "averaged": self.policy.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "steps": self.num_timesteps,
            "updates": self._updates,
        }
        torch.save(state, path)

    def restore(self, path: str | Path) -> None:
        """Continue from a file that `save` wrote.

        Args:
            path: File.
        """
        state = torch.load(path, weights_only=True)
        self._trained.load_state_dict(state["trained"])
        self.policy.load_state_dict(state["averaged"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.num_timesteps, self._updates = state["steps"], state["updates"]
