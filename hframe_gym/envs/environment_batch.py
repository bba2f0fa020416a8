"""A batch of environments without Gymnasium's interface: behind `HFrameEnv` and the vector environments.

`reset` samples the machine parameters, the start position and the plan of an episode (numbers that define its
goal at all times) and puts the machine at rest. Each `step` advances all machines by one control period. The
caller decides when an episode ends.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from gymnasium import error
from numpy.typing import NDArray

from ..arrays import Array, GoalPlans, Index
from ..dynamics import LANES, NotFiniteError, in_parallel
from ..errors import InputError, is_integer
from .actuation.actuators import check_actions, with_actuators
from .batched_simulator import BatchedSimulator, block_ranges
from .config import EnvConfig, as_machine
from .observation.observations import Observation, ObservationBuilder
from .observation.sensors import as_sensors
from .observation.spaces import ObservationFormat, observation_signals
from .randomization.machine_sampler import MachineSampler
from .rewards import PenalizedReward, as_reward, distances
from .step_rewards import StepRewards
from .tasks import as_task
from .tasks.base import ReferenceTrajectories
from .tasks.trial import check_task
from .workspace import outside_workspace, workspace_of

Flags = NDArray[np.bool_]
# With fewer environments, one thread finishes before a second one has started.
_COUNT_FOR_THREADS = 512


class StepResult(NamedTuple):
    """Arrays into which a step of `count` environments writes everything but the observation.

    Attributes:
        terminated: Whether `achieved_goal` is outside the workspace, bool, shape (count,); always False
            unless `ends` is "terminate".
        reward: Rewards, dimensionless, shape (count,).
        distance: Distance of the true tool position to the goal, m or rad, shape (count,).
        contour: Distance of the true tool position to the path, m or rad, shape (count,); None for a task
            without a path.
    """

    reward: Array
    terminated: Flags
    distance: Array
    contour: Array | None


class EnvironmentBatch:
    """Advance, observe and reset many environments with the same options.

    Args:
        config: Options of the environments.
        count: Number of environments, at least 1.

    Attributes:
        machine: Machine with the chosen sensors and actuators.
        task: Chooses starts and goals.
        sampler: Samples the parameters of episodes.
        simulator: Simulates the machines.
        references: Goals of the running episodes.
        rewards: Computes the rewards of steps.
        workspace: One row per axis of the tool (x and y), columns low and high, m or rad, shape (axes, 2).
        distance_key: Key of an info with the distance to the goal: "distance_m", or "distance_rad" for rotary
            axes.
        contour_key: Key of an info with the distance to the path, "contour_m" or "contour_rad".
        observations: Computes observations from states or measurements.
        format: Converts observations, SI, to the form that `normalize`, `flat` and `error` select.
        values: All N parameters of the running episodes, SI, order of `sampler.space.names`,
            shape (count, N).
        clipped: Number of action entries outside [-1, 1] in each running episode, shape (count,).

    Raises:
        InputError: If an option is invalid or options do not fit together.
    """

    def __init__(self, config: EnvConfig, count: int) -> None:
        if not is_integer(count) or count < 1:
            raise InputError(f"num_envs is {count!r}, it must be an integer, at least 1")
        self.config, self.count = config, count
        sensors = as_sensors(config.sensors)
        machine = as_machine(config.machine)
        self.workspace = workspace_of(machine)
        self.distance_key = f"distance_{machine.axis_unit.name}"
        self.contour_key = f"contour_{machine.axis_unit.name}"
        machine = with_actuators(machine, config.drives)
        self.machine = machine if sensors is None else sensors.apply(machine)
        self.task = as_task(config.task, machine.axis_unit)
        check_task(self.task, self.workspace)
        reward = as_reward(config.chosen_reward, self.task.band, len(self.workspace), machine.axis_unit)
        self._ends, self._edges = config.ends == "terminate", self.workspace.astype(np.float32)
        if self._ends:
            reward = PenalizedReward(reward, self._edges, config.penalty)
        self.sampler = MachineSampler(self.machine, config.randomize, count, self.task.parameters)
        self.simulator = BatchedSimulator(
            self.machine,
            count,
            self.sampler.space,
            period=config.period,
            longest_step=config.longest_step,
            end_stops=config.ends == "stops",
            sensors=sensors is not None,
        )
        observed = None if sensors is None else sensors.observed(self.machine)
        builder = ObservationBuilder(self.simulator, observed, self.sampler, privileged=config.privileged)
        previews, entries = len(self.task.ahead_s), builder.entries
        signals = observation_signals(self.machine, previews, observed=entries, privileged=builder.privileged)
        self.observations = builder
        self._no_arrays = {key: np.empty((count, 0), np.float32) for key in sorted(signals)}
        self.format = ObservationFormat(
            signals, normalize=config.normalize, flat=config.flat, error=config.error
        )
        # Values that every step needs, looked up once: look-ups are a large part of a step of a single
        # environment.
        self._expected_shape = count, len(self.machine.drives)
        self._has_path = self.task.metrics == "track"
        self.references = ReferenceTrajectories(self.task, count, config.period, axes=len(self.workspace))
        self.rewards = StepRewards(reward, self.format, count=count, moving=self.references.moving)
        self.clipped = np.zeros(count, np.int64)
        self.values = np.tile(self.sampler.space.nominal, (count, 1))
        self._was_reset = False

    @property
    def elapsed(self) -> NDArray[np.int64]:
        """Number of control periods since the reset of each of the `count` environments, shape (count,)."""
        return self.references.elapsed

    @cached_property
    def fingerprint(self) -> str:
        """Hash of machine, task's name, number of environments and options, 16 hexadecimal digits.

        `set_state` refuses a state of environments with another fingerprint.
        """
        # Pydantic takes long to import, and few save states.
        from ..recordings import machine_to_dict

        config = self.config
        options = {
            field.name: value
            for field in dataclasses.fields(config)
            if isinstance(value := getattr(config, field.name), bool | int | float | str)
            and field.name != "machine"
        }
        content = [self.count, options, self.task.name, machine_to_dict(self.machine)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    # -- reset -----------------------------------------------------------------------------------------------

    def reset(
        self,
        index: Index,
        start: Array | None = None,
        plan: GoalPlans | None = None,
        parameters: Mapping[str, Array] | None = None,
        motion: Array | None = None,
    ) -> None:
        """Begin a new episode in k environments, with new parameters, start position and goal.

        Args:
            start: Tool positions at the start, m or rad, shape (k, axes). Default: the task chooses them.
            plan: Plans of the goals. Default: the task chooses them.
            parameters: Values by full name, SI, shape (k,) each, in place of those that are sampled.
            motion: Positions of the n coordinates, then their velocities, in their units, shape (k, 2 n), in
                place of `start` and rest.

        Raises:
            InputError: If a sampled parameter is outside its limits.
        """
        keys, uniforms, values = self.sampler.sample(index, self.task.draws)
        names = self.sampler.space.names
        for name, column in (parameters or {}).items():
            values[:, names.index(name)] = column
        of_task = {name: values[:, names.index(f"task.{name}")] for name in self.task.parameters}
        position, chosen = self.task.begin(self.workspace, uniforms, of_task)
        self.clipped[index] = 0
        self.values[index] = values
        self.references.begin(index, chosen if plan is None else plan)
        self.simulator.reset(index, position if start is None else start, values, motion)
        self.observations.begin(index, keys, values, self.sampler, self.elapsed)
        if self.rewards.compares_steps:
            observation = self.blank()
            self._write_rows(index, observation)
            self.rewards.begin(index, observation)
        self._was_reset = True

    def randomized(self, index: Index) -> dict[str, Array]:
        """Return the randomized parameters of k environments by full name, SI, shape (k,) each."""
        columns = zip(self.sampler.names, self.sampler.columns, strict=True)
        return {name: self.values[index, column] for name, column in columns}

    # -- step ------------------------------------------------------------------------------------------------

    def check_actions(self, actions: Any, *, single: bool = False) -> NDArray[Any]:
        """Check that `reset` was called; check and convert actions, shape (count, drives), for `step`.

        Args:
            single: Whether messages speak of the action of a single environment.

        Returns:
            Actions, shape (count, drives), also of a single environment: float32 as they are, others as
            float64. Values beyond -1 and 1 remain.

        Raises:
            gymnasium.error.ResetNeeded: Before `reset`.
            ValueError: If actions are no finite numbers or have another shape.
        """
        if not self._was_reset:
            raise error.ResetNeeded("call reset before step")
        return check_actions(actions, self._expected_shape, self.machine, single=single)

    def require_reset(self, method: str) -> None:
        """Raise gymnasium.error.ResetNeeded if `reset` was not called; the message names the method."""
        if not self._was_reset:
            raise error.ResetNeeded(f"call reset before {method}")

    def result(self) -> StepResult:
        """Allocate the arrays into which `step` writes, shape (count,).

        `terminated` is False everywhere; the other arrays are not initialized.
        """
        count = self.count
        contour = np.empty(count) if self._has_path else None
        return StepResult(np.empty(count), np.zeros(count, np.bool_), np.empty(count), contour)

    def step(self, actions: NDArray[Any], observation: Observation, result: StepResult) -> None:
        """Advance all environments by one control period.

        Args:
            actions: Voltages as fractions of the rated voltages, shape (count, drives), as `check_actions`
                returns them.
            observation: Output, observations after the step, in arrays that hold the goals already if they
                do not move: those of `blank`, or of `observe` after the last reset.
            result: Output: rewards, terminations, and distances to goal and path.

        Raises:
            NotFiniteError: If a position or velocity is not finite; the message names the environment.
        """
        self.references.advance()
        self.simulator.begin_period()
        tool = self.observations.tool_array(observation)
        if self.count < _COUNT_FOR_THREADS:
            broken = self._advance_blocks(actions, observation, tool, result, 0, self.simulator.blocks)
        else:
            broken = self._advance_in_threads(actions, observation, tool, result)
        if broken >= 0:
            raise NotFiniteError(
                f"environment {broken}: the motion of machine {self.machine.name!r} is not finite; its "
                "parameters are impossible, or it needs a smaller longest_step"
            )
        if self.rewards.compares_steps:
            self.rewards.keep_goals(observation)
        if not self.rewards.compiled:
            result.distance[:] = distances(tool, observation["desired_goal"])
            result.reward[:] = self.rewards.of_step(observation)
        if self._ends:
            result.terminated[:] = outside_workspace(observation["achieved_goal"], self._edges)

    def _advance_in_threads(
        self, actions: NDArray[Any], observation: Observation, tool: NDArray[np.float32], result: StepResult
    ) -> int:
        """Do `_advance_blocks` for all blocks in several threads."""
        found: list[int] = []

        def advance(first: int, last: int) -> None:
            found.append(self._advance_blocks(actions, observation, tool, result, first, last))

        in_parallel(advance, self.simulator.blocks)
        return min((b for b in found if b >= 0), default=-1)

    def _advance_blocks(
        self,
        actions: NDArray[Any],
        observation: Observation,
        tool: NDArray[np.float32],
        result: StepResult,
        first: int,
        last: int,
    ) -> int:
        """Advance blocks first..last-1 of environments by a control period, and evaluate the new states.

        observation, tool (count, axes) in m and result are outputs. Return the index of a broken environment,
        or -1.
        """
        self.simulator.advance(actions, self.clipped, first, last)
        rows = slice(first * LANES, min(last * LANES, self.count))
        if self.observations.measured:
            self.observations.measure(first, last, self.elapsed)
        if self.references.moving:
            self.references.write(rows, observation)
        rewards, evaluation = self.rewards, None
        if rewards.depends_on_distance:
            evaluation = rewards.evaluation(result.distance, result.reward)
        broken = self.observations.write(first, last, observation, tool, evaluation)
        if rewards.compiled and evaluation is None:
            rewards.write(rows, observation, tool, result.distance, result.reward)
        if result.contour is not None and broken < 0:
            result.contour[rows] = self.references.contour(rows, self.simulator.tool_positions(first, last))
        return broken

    def restart(self, index: Index, observation: Observation, result: StepResult) -> None:
        """Begin new episodes in k environments whose episodes ended, and write their first observations.

        Args:
            result: Result of the last `step`. In rows `index`, the distances to goal and path are overwritten
                with those at the start of the new episodes. Rewards and terminations remain those of the
                step.

        Raises:
            InputError: If an unbounded distribution yields a value outside the limits of a parameter.
        """
        self.reset(index)
        tool = self._write_rows(index, observation)
        result.distance[index] = distances(tool[index], observation["desired_goal"][index])
        if result.contour is not None:
            result.contour[index] = self.contour(index)

    def observe(self, observation: Observation | None = None) -> Observation:
        """Compute all present observations, SI, shape (count, entries of the key); by default, new arrays.

        They contain the true states or, with the option `sensors`, the measurements of the last step or
        reset. The options `normalize` and `flat` are not applied.
        """
        observation = self.blank() if observation is None else observation
        self._write_rows(np.arange(self.count), observation)
        return observation

    def _write_rows(self, index: Index, observation: Observation) -> NDArray[np.float32]:
        """Write present observations of environments (k,); return true tool positions, m, (count, axes)."""
        tool = self.observations.tool_array(observation)
        self.references.write(index, observation)
        for first, last in block_ranges(index):
            self.observations.write(first, last, observation, tool)
        return tool

    def blank(self) -> Observation:
        """Allocate arrays for `step`, by key in the order of the observation space.

        They have the shape (count, entries of the key) and are not initialized, except for goals that do not
        move.
        """
        observation = self._no_arrays.copy()
        self.observations.add_blank(observation)
        self.references.add_blank(observation)
        return observation

    def contour(self, index: Index | slice) -> Array | None:
        """Compute k environments' contour errors, m or rad, shape (k,); None for a task without a path."""
        return (
            self.references.contour(index, self.simulator.tool_positions()[index]) if self._has_path else None
        )

    def distance(self, index: Index) -> Array:
        """Compute distances of k environments' true tool positions to their goals, m or rad, shape (k,)."""
        tool = np.empty((self.count, len(self.workspace)), np.float32)
        for first, last in block_ranges(index):
            self.observations.write_tool(first, last, tool)
        return distances(tool[index], self.references.goals(index))


def batch_of(environment: Any) -> EnvironmentBatch:
    """Return the batch of an environment: a single one, a vector, one for stable-baselines3, or wrapped.

    Raises:
        InputError: If the environment is not one of this package.
    """
    native = environment.unwrapped
    batch = getattr(getattr(native, "envs", native), "batch", None)
    if not isinstance(batch, EnvironmentBatch):
        raise InputError(f"{environment!r} is not an environment of this package")
    return batch
