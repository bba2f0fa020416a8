"""Wrappers for rewards, costs and observations of quantities of a step.

Each works on a single environment (`HFrameEnv`, also from `gym.make`) and, with the prefix `Vector`, on
`HFrameVectorEnv`. An environment without them computes nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from typing_extensions import override

from ...arrays import Array
from ...errors import InputError, is_number
from ..environment_batch import batch_of
from .quantities import QUANTITIES, Quantity, StepRecord

KEY = "quantities"  # of the observation entry that `ObserveQuantities` adds
_LIMIT = 10.0  # of observed quantities, in multiples of their typical largest value


class _Recorder:
    """Makes the record of each step of a batch, and remembers the actions of the step before."""

    def __init__(self, env: Any, names: Sequence[str]) -> None:
        if not names:
            raise InputError(f"name at least one quantity of {', '.join(QUANTITIES)}")
        self.batch = batch_of(env)
        self.quantities: dict[str, Quantity] = {name: QUANTITIES.get(name) for name in names}
        self._last = np.zeros((self.batch.count, len(self.batch.machine.drives)))

    def begin(self, mask: Any = slice(None)) -> None:
        """Forget the actions of environments in which an episode begins."""
        self._last[mask] = 0.0

    def values(self, actions: Any) -> dict[str, Array]:
        """Return quantities of the step that these actions, (count, drives), caused, shape (count,) each."""
        limited = np.clip(np.asarray(actions, dtype=np.float64).reshape(self._last.shape), -1.0, 1.0)
        record = StepRecord(self.batch, limited, self._last.copy())
        self._last = limited
        return {name: np.asarray(q.function(record), np.float64) for name, q in self.quantities.items()}

    def first_values(self) -> dict[str, Array]:
        """Return the quantities of the start, with actions of zero, shape (count,) each."""
        return self.values(np.zeros(self._last.shape))


def _finite(numbers: Mapping[str, float], meaning: str) -> dict[str, float]:
    """Check numbers by name of a quantity."""
    for name, value in numbers.items():
        if not is_number(value):
            raise InputError(f"the {meaning} of {name!r} is {value!r}, it must be a finite number")
    return dict(numbers)


class _Wrapper:
    """Base of the wrappers: what they do with a step's quantities, numbers or arrays of shape (count,)."""

    def __init__(self, env: Any, names: Sequence[str]) -> None:
        super().__init__(env)  # type: ignore[call-arg]  # of Gymnasium's wrapper
        self._recorder = _Recorder(env, names)

    def _changed(self, result: tuple[Any, ...], values: Mapping[str, Any]) -> tuple[Any, ...]:
        """Return the result of a step with what follows from its quantities."""
        raise NotImplementedError

    def _begun(self, observation: Any, first_values: Callable[[], Mapping[str, Any]]) -> Any:
        """Return the first observation of an episode."""
        return observation


class _Penalty(_Wrapper):
    """Weighted quantities are subtracted from the reward."""

    def __init__(self, env: Any, weights: Mapping[str, float]) -> None:
        super().__init__(env, list(weights))
        self._weights = _finite(weights, "weight")

    @override
    def _changed(self, result: tuple[Any, ...], values: Mapping[str, Any]) -> tuple[Any, ...]:
        observation, reward, terminated, truncated, info = result
        info.update({f"quantity_{name}": value for name, value in values.items()})
        penalty = sum(self._weights[name] * value for name, value in values.items())
        return observation, reward - penalty, terminated, truncated, info


class _Cost(_Wrapper):
    """The number of quantities that exceed their limits is reported."""

    def __init__(self, env: Any, limits: Mapping[str, float], *, six_values: bool = False) -> None:
        super().__init__(env, list(limits))
        self._limits, self._six_values = _finite(limits, "limit"), six_values

    @override
    def _changed(self, result: tuple[Any, ...], values: Mapping[str, Any]) -> tuple[Any, ...]:
        observation, reward, terminated, truncated, info = result
        exceeded = {name: 1.0 * (value > self._limits[name]) for name, value in values.items()}
        cost = sum(exceeded.values())
        info.update({f"quantity_{name}": value for name, value in values.items()})
        info.update({f"cost_{name}": value for name, value in exceeded.items()}, cost=cost)
        if self._six_values:
            return observation, reward, cost, terminated, truncated, info
        return result


class _Observed(_Wrapper):
    """The quantities are entries of the observation."""

    def __init__(self, env: Any, names: Sequence[str]) -> None:
        super().__init__(env, names)
        self._scales = np.array([QUANTITIES.get(name).largest for name in names])

    def _extended_space(self, inner: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the observation space of one environment with the quantities."""
        added = spaces.Box(-_LIMIT, _LIMIT, self._scales.shape, np.float32)
        if isinstance(inner, spaces.Dict):
            return spaces.Dict({**inner.spaces, KEY: added})
        assert isinstance(inner, spaces.Box)
        low, high = np.concatenate([inner.low, added.low]), np.concatenate([inner.high, added.high])
        return spaces.Box(low, high, dtype=np.float32)

    @override
    def _changed(self, result: tuple[Any, ...], values: Mapping[str, Any]) -> tuple[Any, ...]:
        observation, *others = result
        return self._extended(observation, values), *others

    @override
    def _begun(self, observation: Any, first_values: Callable[[], Mapping[str, Any]]) -> Any:
        return self._extended(observation, first_values())

    def _extended(self, observation: Any, values: Mapping[str, Any]) -> Any:
        """Return an observation with the quantities."""
        scaled = np.stack(list(values.values()), axis=-1) / self._scales
        added = np.clip(scaled, -_LIMIT, _LIMIT).astype(np.float32)
        if isinstance(observation, dict):
            return {**observation, KEY: added}
        return np.concatenate([observation, added], axis=-1)


class _Recording(_Wrapper, gym.Wrapper):
    """Base of the wrappers of single environments."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, as the environment does."""
        self._recorder.begin()
        observation, info = self.env.reset(seed=seed, options=options)
        return self._begun(observation, lambda: _items(self._recorder.first_values())), info

    def step(self, action: Any) -> tuple[Any, ...]:  # type: ignore[override]
        """Make a step, as the environment does, with what follows from its quantities."""
        result = self.env.step(action)
        return self._changed(result, _items(self._recorder.values(action)))


def _items(columns: Mapping[str, Array]) -> dict[str, float]:
    """Return the numbers of a single environment."""
    return {name: column.item() for name, column in columns.items()}


class _VectorRecording(_Wrapper, VectorWrapper):
    """Base of the wrappers of vector environments, which know in which environments an episode has ended."""

    def __init__(self, env: VectorEnv, names: Sequence[str]) -> None:
        super().__init__(env, names)
        if env.metadata.get("autoreset_mode") is AutoresetMode.SAME_STEP:
            raise InputError(
                "with autoreset_mode='SameStep' the state at the end of an episode "
                "is gone when quantities are computed; use 'NextStep' or 'Disabled'"
            )
        self._over = np.zeros(self._recorder.batch.count, np.bool_)

    def reset(self, **keywords: Any) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, as the environments do."""
        mask = (keywords.get("options") or {}).get("reset_mask")
        chosen = slice(None) if mask is None else np.asarray(mask, np.bool_)
        self._recorder.begin(chosen)
        self._over[chosen] = False
        observation, info = self.env.reset(**keywords)
        return self._begun(observation, self._recorder.first_values), info

    def step(self, actions: Any) -> tuple[Any, ...]:  # type: ignore[override]
        """Make a step of all environments; quantities are zero where an episode began instead."""
        began = self._over
        result = self.env.step(actions)
        values = self._recorder.values(actions)
        self._recorder.begin(began)
        self._over = np.asarray(result[2]) | np.asarray(result[3])
        return self._changed(result, {name: np.where(began, 0.0, column) for name, column in values.items()})


class PenaltyWrapper(_Penalty, _Recording):
    """Subtract weighted quantities of the step from the reward.

    `info` has each quantity as `quantity_NAME`. `compute_reward` does not know them: do not relabel goals
    with it.

    Args:
        env: Environment of this package.
        weights: Weight of each quantity by its name in `QUANTITIES`, reward per unit of the quantity.

    Raises:
        InputError: If a name is unknown, a weight is not finite, or the environment is of another package.
    """


class VectorPenaltyWrapper(_Penalty, _VectorRecording):
    """`PenaltyWrapper` for `HFrameVectorEnv`; where an episode begins in a step, nothing is subtracted.

    Raises:
        InputError: As `PenaltyWrapper`, and with the autoreset mode "SameStep".
    """


class CostWrapper(_Cost, _Recording):
    """Report costs beside the reward, as constrained reinforcement learning needs them.

    The cost of a step is the number of quantities that exceed their limits, in `info["cost"]`;
    `info["cost_NAME"]` has each of them, 0 or 1, and `info["quantity_NAME"]` the quantity. With
    `six_values=True`, `step` returns (observation, reward, cost, terminated, truncated, info), as
    Safety-Gymnasium's environments do.

    Args:
        env: Environment of this package.
        limits: Limit of each quantity by its name in `QUANTITIES`, in its unit.
        six_values: Whether `step` returns the cost as its third value.

    Raises:
        InputError: If a name is unknown, a limit is not finite, or the environment is of another package.

    References:
        Ji et al. (2023), Safety-Gymnasium: a unified safe reinforcement learning benchmark.
    """


class VectorCostWrapper(_Cost, _VectorRecording):
    """`CostWrapper` for `HFrameVectorEnv`; where an episode begins in a step, the cost is zero.

    Args:
        six_values: Whether `step` returns the costs, shape (num_envs,), as its third value.

    Raises:
        InputError: As `CostWrapper`, and with the autoreset mode "SameStep".
    """


class ObserveQuantities(_Observed, _Recording):
    """Add quantities of the last step to the observation: the key `quantities`, or entries of a flat array.

    Each is divided by its typical largest value and limited to [-10, 10]. At the beginning of an episode they
    are those of the start with actions of zero.

    Args:
        names: Names in `QUANTITIES`, at least one, in the order of the entries.

    Raises:
        InputError: If a name is unknown or the environment is of another package.
    """

    def __init__(self, env: gym.Env, names: Sequence[str]) -> None:
        super().__init__(env, names)
        self.observation_space = self._extended_space(env.observation_space)


class VectorObserveQuantities(_Observed, _VectorRecording):
    """`ObserveQuantities` for `HFrameVectorEnv`."""

    def __init__(self, env: VectorEnv, names: Sequence[str]) -> None:
        super().__init__(env, names)
        self.single_observation_space = self._extended_space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
