"""Residual action: base controller plus policy output, scaled by an authority that shrinks near the goal.

    action = base + held * last action + authority * output + sum of weight * voltage of a feedback law
    authority = min(most, least + distance / full_at_m + speed / full_at_m_s)
    held = max(0, 1 - distance / hold_m - speed / hold_m_s), 0 by default

With the tool at rest at the goal, 0.1 V moves it by 0.1 mm in one control period. A policy explores with the
same noise everywhere; the authority makes that noise small at the goal and large far from it. Where the last
action is held, the policy's output is a change of the voltage, which accumulates until it overcomes friction,
as with an integrator. A feedback law is the first voltage of a motion that brings the tool to rest at its
goal (`TransferBank`, `PlanBank`). The previous observation and action let the policy infer masses and
friction, which it cannot observe; a `ParameterFilter` can add estimates of them. Training and the finished
agent use this one implementation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ..arrays import Actions
from ..controllers import CONTROLLERS, DeadTime, EpisodeStarts, MotionModel, ParameterFilter
from ..errors import InputError
from ..machine import Machine, observed_coordinates
from .action_conversion import ActionConversion
from .feedback_laws import LARGEST_WEIGHTED, FeedbackLaws, PlanBank, TransferBank

Observation = Mapping[str, NDArray[Any]]

# Limit of the held action, fraction of the rated voltage: twice what overcomes Coulomb friction.
LARGEST_HELD = 0.12
# The position error is integrated within this distance of the goal, m, and below this speed, m/s: where
# friction can hold the tool. Farther away or faster, the integral would grow by errors that the motion is
# about to remove.
INTEGRAL_M, INTEGRAL_M_S = 1e-3, 0.015
WEIGHT_SCALE = 5.0  # the weight of a transfer is proportional to exp(WEIGHT_SCALE * output)


@dataclass(frozen=True)
class Authority:
    """Fractions of rated voltage and last action in an action, by distance to the goal and tool speed.

    Attributes:
        least: Fraction of the rated voltage that an output of 1 represents for a tool at rest at its goal, 0
            to 1.
        most: Upper limit of this fraction, 0 to 1.
        full_at_m: Distance to the goal that increases the fraction by 1, m.
        full_at_m_s: Tool speed that increases the fraction by 1, m/s.
        hold_m: Distance to the goal beyond which the last action is not held, m; 0: it is not held anywhere.
        hold_m_s: Tool speed above which the last action is not held, m/s.
    """

    least: float = 1.0
    most: float = 1.0
    full_at_m: float = 5e-3
    full_at_m_s: float = 0.2
    hold_m: float = 0.0
    hold_m_s: float = 0.015

    def __call__(self, distance: Any, speed: Any) -> Any:
        """Compute the fraction of the rated voltage that a policy output of 1 represents, shape (batch, 1).

        It is min(most, least + distance / full_at_m + speed / full_at_m_s) of distances, m, and tool speeds,
        m/s, arrays or torch tensors of shape (batch,).
        """
        return (self.least + distance / self.full_at_m + speed / self.full_at_m_s).clip(max=self.most)[
            :, None
        ]

    def held(self, distance: Any, speed: Any) -> Any:
        """Compute the fraction of the last action that the next action keeps (holds), shape (batch, 1).

        It is max(0, 1 - distance / hold_m - speed / hold_m_s), or the number 0 if `hold_m` is 0, and
        approaches 1 at rest near the goal. The policy's output then changes the action, so that the policy
        acts as an integrator, which can overcome static friction. Distances, m, and tool speeds, m/s, are
        arrays or torch tensors of shape (batch,).
        """
        if not self.hold_m:
            return 0.0
        return (1.0 - distance / self.hold_m - speed / self.hold_m_s).clip(min=0.0)[:, None]


class ActionParts(NamedTuple):
    """Parts from which an action is computed, given a policy's outputs: arrays or torch tensors of a batch.

    Attributes:
        offset: Part that does not depend on the outputs, fractions of the rated voltages,
            shape (batch, drives).
        authority: Fraction of the rated voltage that an output of 1 represents, shape (batch, 1).
        laws: Voltages of K feedback laws, fractions of the rated voltages, shape (batch, K, drives); None
            without laws.
    """

    offset: Any
    authority: Any
    laws: Any = None

    def action(self, output: Any) -> Any:
        """Compute the action for given policy outputs, not limited to [-1, 1], differentiable in torch.

        It is offset + authority * output of each drive. With laws, the mean of their voltages is added, each
        limited to +-1.2, with the weights softmax(5 * outputs for the laws).

        Args:
            output: Policy outputs, dimensionless, shape (batch, drives), or (batch, drives + K) with K laws.
                First one column per drive, then one per law.

        Returns:
            The action, fractions of the rated voltages, of the type of `output`, shape (batch, drives).
        """
        drives = self.offset.shape[1]
        action = self.offset + self.authority * output[:, :drives]
        if self.laws is None:
            return action
        # exp(WEIGHT_SCALE * output), as a power of 2 because this works for arrays and for tensors.
        weights = 2.0 ** (WEIGHT_SCALE / np.log(2.0) * output[:, drives:])
        limited = self.laws.clip(-LARGEST_WEIGHTED, LARGEST_WEIGHTED)
        return action + (weights[..., None] * limited).sum(1) / weights.sum(1)[:, None]


class ResidualAction:
    """Conversion of outputs to actions, action = base + authority * output, for a batch of environments.

    The base is the action of another controller; the authority is a fraction of the rated voltage (see
    `Authority`). The class also adds the previous observation, the previous action and the base controller's
    action to the observations. In every control period, call `augment` first, then `action`.

    Args:
        period: Control period, s.
        base: Name of a registered controller whose action the policy corrects; None: the policy acts alone.
        estimates: Whether to add estimates of friction, masses and belts to the observation also without a
            base.
        integral: Whether to add the integral of the position error to the observation.
        transfers: Durations, in periods beyond the shortest, of motions to rest at the goal that the policy
            weights.
        plans: Durations, in periods, of such motions that are designed for the estimated machine instead.
        parts: Whether to add the `ActionParts` to the observation, so that critics can compute the action.
        conversion: Conversion of the actions that the policy commands and observes, if it was trained on
            another machine; not of a base's. Default: none.
        **authority: Keyword arguments of `Authority`, which limits the policy's part of the action.

    Attributes:
        authority: Fractions of the rated voltage and of the last action, by distance and speed.
        tool_speeds: Columns of the array `observation` that hold the tool velocity along its axes, m/s or
            rad/s.
        meters: Length that one unit of the tool position corresponds to: 1 m, or 0.1 m for a rad of rotary
            axes.
        base: Controller whose action the policy corrects, or None.
        bank: Motions to rest at the goal (`transfers` or `plans`) whose voltages the policy weights, or None.
        laws: Voltages of the bank in this period and their derivatives by the observation; None without a
            bank.

    Raises:
        InputError: If no controller is registered under the name of the base (agents are data: their files
            cannot name a module to import), `plans` are given without `estimates` or together with
            `transfers`, or `parts` without either.
    """

    def __init__(
        self,
        machine: Machine,
        period: float,
        base: str | None = None,
        estimates: bool = False,
        integral: bool = False,
        transfers: Sequence[int] = (),
        plans: Sequence[int] = (),
        parts: bool = False,
        conversion: ActionConversion | None = None,
        **authority: float,
    ) -> None:
        self.authority, self.period = Authority(**authority), period
        if base and base not in CONTROLLERS:
            raise InputError(f"base controller {base!r} is unknown; choose one of {', '.join(CONTROLLERS)}")
        self.base = CONTROLLERS.get(base)(machine, period) if base else None
        # Attributes of an adaptive base that it adds to the observation, with their numbers of columns.
        self._base_features: dict[str, int] = getattr(self.base, "feature_sizes", {})
        self._drives = len(machine.drives)
        first = len(observed_coordinates(machine))  # after all positions
        self.tool_speeds = slice(first, first + len(machine.tool_axes))
        self.meters = 1.0 / machine.axis_unit.per_meter
        self._dead_time = DeadTime(machine, period)  # holds actions instead of volts
        self._model = MotionModel(self._dead_time.machine_without_delay) if estimates else None
        switch_s = self._dead_time.remainder_s
        self._filter = ParameterFilter(self._model, period, switch_s) if self._model else None
        if plans and (transfers or not self._filter):
            raise InputError("plans need estimates = true and no transfers")
        self.bank: TransferBank | PlanBank | None = (
            TransferBank(machine, period, transfers) if transfers else None
        )
        if plans and self._filter:
            self.bank = PlanBank(machine, period, self._filter, plans)
        if parts and not self.bank:
            raise InputError("parts = true needs transfers or plans")
        self._shows_parts = parts
        self._conversion = conversion
        self.laws: FeedbackLaws | None = None
        self._integrates, self._axes = integral, len(machine.tool_axes)
        self._integral = np.zeros((0, 0))  # of the position error, m s, (batch, axes)
        self._starts = EpisodeStarts()
        self._observation: NDArray[Any] = np.zeros((0, 0))  # `observation` of this period, (batch, entries)
        self._last_observation: NDArray[Any] = np.zeros((0, 0))  # and of the previous period
        self._last_action = self._base_action = np.zeros((0, 0))  # (batch, drives)
        self._distance = self._speed = np.zeros(0)  # m and m/s, (batch,)

    def action_space(self) -> spaces.Box:
        """Build the space of the policy's outputs: a box from -1 to 1 with one entry for each drive.

        If the policy weights several transfers (attribute `bank`), one entry for the weight of each follows.
        """
        return spaces.Box(-1.0, 1.0, (self._drives + (self.bank.size if self.bank else 0),), np.float32)

    def observation_space(self, observation_space: spaces.Dict) -> spaces.Dict:
        """Extend the observation space of an environment by the arrays that `augment` adds (`history`)."""
        action_box = spaces.Box(-1.0, 1.0, (self._drives,), np.float32)
        added: dict[str, spaces.Space[Any]] = {
            "last_observation": observation_space["observation"],
            "last_action": action_box,
        }
        if self.base:
            added["base_action"] = action_box
        for key, size in self._base_features.items():
            added[key] = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        if self._filter:
            added["estimates"] = spaces.Box(-np.inf, np.inf, (self._filter.size,), np.float32)
        if self._integrates:
            added["error_integral"] = spaces.Box(-np.inf, np.inf, (self._axes,), np.float32)
        if self._shows_parts and self.bank:
            added["action_offset"] = action_box
            added["authority"] = spaces.Box(0.0, 1.0, (1,), np.float32)
            added["law_actions"] = spaces.Box(-np.inf, np.inf, (self.bank.size * self._drives,), np.float32)
        return spaces.Dict({**observation_space.spaces, **added})

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Clear the memory of the environments in `mask`, shape (batch,).

        If `mask` is None, clear all memory; the number of environments may then change.
        """
        if self.base:
            self.base.reset(mask)
        self._starts.reset(mask)

    def augment(self, observation: Observation) -> dict[str, NDArray[Any]]:
        """Build the observation of the policy and, if there is a base controller, compute its action.

        Call it exactly once per control period: each call stores the observation and advances the base
        controller.

        Returns:
            The arrays of `observation` and those that the method `history` documents, SI, shape (batch,
            entries of the key).

        Raises:
            InputError: If the base controller does not accept the observation.
        """
        state = observation["observation"]
        if self._starts.resize(len(state)):
            self._observation, self._last_action = state, np.zeros((len(state), self._drives))
            self._integral = np.zeros((len(state), self._axes))
        starting = self._starts.mask[:, None]  # (batch, 1)
        if self._filter and self._model:
            before, after = (self._model.state({"observation": rows}) for rows in (self._observation, state))
            self._dead_time.reset(self._starts.mask)
            arrived = self._dead_time.arrived_history()[1][:, :-1]
            self._filter.update(before, after, arrived, self._starts.mask)
            # `replace_last_action` replaces it by the action of this period
            self._dead_time.send(self._last_action)
        self._last_observation = np.where(starting, state, self._observation)
        self._last_action = np.where(starting, 0.0, self._last_action)
        self._starts.clear()
        self._observation = state
        goal = observation["desired_goal"]
        self._distance = self.meters * np.linalg.norm(goal - state[:, : goal.shape[1]], axis=1)
        self._speed = self.meters * np.linalg.norm(state[:, self.tool_speeds], axis=1)
        if self._integrates:
            self._integrate(self.meters * (goal - state[:, : self._axes]), starting)
        if isinstance(self.bank, PlanBank):
            self.laws = self.bank.laws(state, goal, self._last_action)
        elif self.bank:
            self.laws = self.bank.laws(state, goal)
        if self.base:
            self._base_action = np.clip(self.base.act(observation), -1.0, 1.0)
        return {**observation, **self.history()}

    def _integrate(self, error: NDArray[Any], starting: NDArray[np.bool_]) -> None:
        """Add the position error, m, (batch, axes), to its integral, which a change of sign sets to zero."""
        near = (self._distance < INTEGRAL_M)[:, None]
        kept = np.where(near & ~starting & (error * self._integral >= 0.0), self._integral, 0.0)
        slow = (1.0 - self._speed / INTEGRAL_M_S).clip(min=0.0)[:, None]
        self._integral = kept + near * slow * error * self.period

    def history(self) -> dict[str, NDArray[np.float32]]:
        """Return the arrays that the policy receives in addition to the environment's observation.

        They are as the last call of `augment` left them. Only `last_action` changes with a call of `action`:
        it is then the action that was just computed.

        Returns:
            last_observation: `observation` of the previous period, m, rad, m/s and rad/s, shape (batch,
                entries) for a batch of environments.
            last_action: Voltages divided by the rated voltages, shape (batch, drives).
            base_action: Action of the base controller, which the policy corrects, as a fraction of the rated
                voltages, shape (batch, drives); only with a base controller.
            expected_friction: Voltages that compensate the friction expected in the next periods, as
                fractions of the rated voltages, shape (batch, 4 * drives); only with an `AdaptiveController`
                as base, whose attribute documents the columns.
            estimates: Estimated deviations of friction, masses and belts from the model, dimensionless (0.1:
                about 10 % above), shape (batch, parameters); only if the constructor's argument `estimates`
                is True or the base is adaptive or predictive. Attributes of `ParameterFilter` or of the base
                document the columns.
            error_integral: Integral of the position error along each axis while the tool is slow and within 1
                mm of the goal, m s, shape (batch, axes); it begins at zero when the error changes sign. Only
                if the constructor's argument `integral` is True.
            action_offset, authority, law_actions: The `ActionParts` of this period, the laws joined,
                dimensionless, shapes (batch, drives), (batch, 1) and (batch, K * drives); only if the
                constructor's argument `parts` is True.
        """
        added: dict[str, NDArray[Any]] = {
            "last_observation": self._last_observation,
            "last_action": self._last_action,
        }
        if self.base:
            added["base_action"] = self._base_action
        added |= {key: getattr(self.base, key) for key in self._base_features}
        if self._filter:
            added["estimates"] = self._filter.estimates
        if self._integrates:
            added["error_integral"] = self._integral
        if self._conversion:
            added["last_action"] = self._conversion.to_training(self._last_action)
        if self._shows_parts:
            parts = self._parts()
            added |= {"action_offset": parts.offset, "authority": parts.authority}
            added["law_actions"] = parts.laws.reshape(len(parts.laws), -1)
        return {key: values.astype(np.float32) for key, values in added.items()}

    def action(self, output: NDArray[Any]) -> Actions:
        """Convert policy outputs to actions, and record these as applied.

        Without transfers and held actions, the action is base action + authority * output, where the
        authority is the fraction of the rated voltage that an output of 1 represents. The module documents
        the complete formula.

        Args:
            output: Policy outputs, usually in [-1, 1], with the entries of `action_space`,
                shape (batch, entries).
        """
        if self._conversion:
            own = self._conversion.to_machine(output[:, : self._drives])
            output = np.concatenate([own, output[:, self._drives :]], axis=1)
        self.replace_last_action(np.clip(self._parts().action(output), -1.0, 1.0))
        return self._last_action

    def _parts(self) -> ActionParts:
        """Return the parts of the actions of this period, with the base action."""
        volts = self.laws.volts if self.laws else None
        parts = self.parts(self._distance, self._speed, self._last_action, volts)
        return parts._replace(offset=parts.offset + self._base_action) if self.base else parts

    def parts(self, distance: Any, speed: Any, last_action: Any, laws: Any = None) -> ActionParts:
        """Compute the parts of the actions without the base action, from arrays or torch tensors.

        Args:
            distance: Distances to the goal, m, shape (batch,).
            speed: Tool speeds, m/s, shape (batch,).
            last_action: Actions of the previous period, fractions of the rated voltages, shape (batch,
                drives).
            laws: Voltages of K feedback laws, fractions of the rated voltages, shape (batch, K, drives). A
                law is the first voltage of a motion that brings the tool to rest at the goal. Default: none.

        Returns:
            The offset, held * last action, with the last action limited to +-0.12 and held from
            `Authority.held`, shape (batch, drives); the authority, the fraction of the rated voltage that an
            output of 1 represents, shape (batch, 1); and `laws`.
        """
        held = self.authority.held(distance, speed) * last_action.clip(-LARGEST_HELD, LARGEST_HELD)
        return ActionParts(held, self.authority(distance, speed), laws)

    def replace_last_action(self, actions: Actions) -> None:
        """Replace the stored last action with the action that was actually applied.

        Call it if the result of `action` was changed. The next observation contains the replacement, and the
        base controller receives it.
        """
        self._last_action = actions
        if self._filter:
            self._dead_time.replace_last(actions)
        if self.base:
            self.base.replace_last_action(actions)


def residual_action(
    machine: Machine, settings: Mapping[str, Any], period: float, conversion: ActionConversion | None = None
) -> ResidualAction | None:
    """Create the `ResidualAction` of a recipe, or None if the policy's outputs are the actions.

    Args:
        settings: The recipe's table [actuation]: keyword arguments of `ResidualAction` except machine, period
            and conversion.
        period: Control period, s.
        conversion: See `ResidualAction`.

    Raises:
        InputError: See `ResidualAction`.
    """
    return ResidualAction(machine, period, conversion=conversion, **settings) if settings else None
