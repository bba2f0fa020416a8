"""Classes of stable-baselines3 for training and for policies. Importing this module needs the extra `agents`.

JointReplayBuffer     lets CrossQ concatenate dict observations
LogScaleFeatures      evaluates the features of features.py in torch, as the first layer of a policy
TrainingCallback      connects a training run with the loop of an algorithm
ResidualActionVecEnv  applies a `ResidualAction` to a vector environment
"""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnvWrapper
from typing_extensions import override

from ..envs.sb3_vec_env import HFrameVecEnv
from .features import OBSERVATION_KEYS, feature_matrix
from .residual_action import Observation, ResidualAction


class LogScaleFeatures(BaseFeaturesExtractor):
    """First layer of a policy: convert a dict observation to logarithmic features (see features.py).

    Args:
        observation_space: Space with `observation` and `desired_goal`; `preview` and the keys that
            `ResidualAction` adds are used where present.
        radii: Belt travel (radius * angle) per radian of each motor coordinate, m/rad, one per motor.
        rest: Belt travel of each motor coordinate per meter of each axis with unstretched belts, m/m, shape
            (motors, axes).
        gains: By key of the observation, matrices from its entries to voltages of model-based controllers.
            Default: no such features.
        meters: Length, m, that one unit of the tool position corresponds to: 0.1 for the angles of rotary
            axes.

    Attributes:
        keys: Keys of the observation in the order in which their arrays are concatenated.
        matrix: Matrix M of the features, shape (entries, features).
        gain: Factors g of the features, shape (features,).
    """

    matrix: torch.Tensor  # (entries, features)
    gain: torch.Tensor  # (features,)

    def __init__(
        self,
        observation_space: spaces.Dict,
        radii: list[float],
        rest: list[list[float]],
        gains: dict[str, list[list[float]]] | None = None,
        meters: float = 1.0,
    ) -> None:
        sizes = {
            key: int(np.prod(observation_space[key].shape or ()))
            for key in OBSERVATION_KEYS
            if key in observation_space.spaces
        }
        arrays = {key: np.array(values) for key, values in (gains or {}).items()}
        matrix, gain = feature_matrix(sizes, np.array(radii), np.array(rest), arrays, meters)
        super().__init__(observation_space, features_dim=len(gain))
        self.keys = tuple(sizes)
        # Not persistent: they follow from agent.json, so the file of weights does not repeat them.
        self.register_buffer("matrix", torch.as_tensor(matrix.astype(np.float32)), persistent=False)
        self.register_buffer("gain", torch.as_tensor(gain.astype(np.float32)), persistent=False)

    @override
    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        """Compute the features g * sign(z M) * log(1 + |z M|) of a batch of z, shape (batch, features).

        z joins all arrays of an observation. M (`matrix`) forms position errors and speeds, each divided by
        several scales; g (`gain`) scales the features, which are dimensionless, about -1 to 1.
        """
        entries = torch.cat([observation[key] for key in self.keys], dim=1)
        scaled = entries @ self.matrix
        return torch.sign(scaled) * torch.log1p(scaled.abs()) * self.gain


class ObservationBatch(dict[str, torch.Tensor]):
    """Batch of dict observations, (batch, entries) by key, that `torch.cat` concatenates by key."""

    @classmethod
    def __torch_function__(
        cls,
        function: Callable[..., torch.Tensor],
        types: Any,
        args: Any = (),
        kwargs: dict[str, Any] | None = None,
    ) -> ObservationBatch:
        """Apply a function of torch to the tensors of each key; its first argument lists the batches."""
        batches, *further = args
        keywords = kwargs or {}
        return cls(
            {key: function([batch[key] for batch in batches], *further, **keywords) for key in batches[0]}
        )


class JointReplayBuffer(DictReplayBuffer):
    """Replay buffer for CrossQ with dict observations.

    CrossQ evaluates its critics on present and next observations in one pass, which normalizes them together.
    It concatenates them by `torch.cat`, which refuses plain dicts.
    """

    def _get_samples(self, batch_inds: NDArray[np.int64], env: Any = None) -> Any:
        """Return transitions of given indices, shape (batch,), with observations that `torch.cat` accepts."""
        samples = super()._get_samples(batch_inds, env)
        present, following = (ObservationBatch(o) for o in (samples.observations, samples.next_observations))
        return samples._replace(observations=present, next_observations=following)


class TrainingCallback(BaseCallback):
    """Callback of a training run that calls one function after each step and another one before each rollout.

    A rollout is the sequence of steps between two updates of the policy. Before a rollout, the algorithm has
    learned from all steps so far, so that a checkpoint at this point need not contain the steps of a rollout.

    Args:
        after_step: Called after each step of the environments.
        before_rollout: Called before the first step of each rollout.
    """

    def __init__(self, after_step: Callable[[], None], before_rollout: Callable[[], None]) -> None:
        super().__init__()
        self._after_step, self._before_rollout = after_step, before_rollout

    def _on_step(self) -> bool:
        """Call the function for the end of a step, and continue."""
        self._after_step()
        return True

    def _on_rollout_start(self) -> None:
        """Call the function for the start of a rollout."""
        self._before_rollout()


class ResidualActionVecEnv(VecEnvWrapper):
    """Vector environment whose actions are policy outputs, converted to drive actions by `ResidualAction`.

    Observations also contain the arrays that `ResidualAction.augment` adds.

    Args:
        environment: Vector environment to wrap.
        mapping: Conversion of policy outputs to drive actions (base action + authority * output), for all
            environments together.
    """

    def __init__(self, environment: HFrameVecEnv, mapping: ResidualAction) -> None:
        inner_space = environment.observation_space
        assert isinstance(inner_space, spaces.Dict)
        outputs = mapping.action_space()
        super().__init__(
            environment, observation_space=mapping.observation_space(inner_space), action_space=outputs
        )
        self.mapping = mapping

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the class's members, which the base class collects and pickle refuses."""
        return {name: value for name, value in self.__dict__.items() if name != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled environment; the base class would seek this method in the wrapped environment."""
        self.__dict__.update(state, class_attributes=dict(inspect.getmembers(type(self))))

    @override
    def reset(self) -> dict[str, NDArray[Any]]:
        """Start new episodes in all environments; observations have the keys of `ResidualAction.augment`."""
        self.mapping.reset()
        return self.mapping.augment(_as_dict(self.venv.reset()))

    @override
    def step_async(self, actions: NDArray[Any]) -> None:
        """Convert policy outputs to drive actions and send them to the environments, for `step_wait`."""
        self.venv.step_async(self.mapping.action(actions))

    @override
    def step_wait(
        self,
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        """Finish the step that `step_async` started; environments whose episode has ended are reset.

        In the last observation of an episode (`terminal_observation`), the arrays that `ResidualAction` adds
        are those of the period before, except `last_action`. To compute them again, the base controller
        (whose action the policy corrects) would be called twice in a period. The machine is usually at rest
        by then, so they hardly differ.
        """
        observation, reward, done, infos = self.venv.step_wait()
        history = self.mapping.history()
        for b in np.flatnonzero(done).tolist():
            infos[b]["terminal_observation"].update({key: values[b] for key, values in history.items()})
        if done.any():
            self.mapping.reset(done)
        return self.mapping.augment(_as_dict(observation)), reward, done, infos


def _as_dict(observation: Any) -> Observation:
    """Narrow the observation type of stable-baselines3 to a dict, which `HFrameVecEnv` always returns."""
    assert isinstance(observation, dict)
    return observation


def set_mean_action_to_zero(policy: Any) -> None:
    """Set weights and biases of the layer that outputs a policy's mean action to zero, in place.

    A policy that corrects a base controller then starts with the behavior of this controller.
    """
    layer = policy.action_net if hasattr(policy, "action_net") else policy.actor.mu
    for parameter in layer.parameters():
        parameter.data.zero_()


def random_state(model: Any) -> dict[str, Any]:
    """Return the states of all random generators that the training of a model uses, for a checkpoint.

    Their names are "python", "numpy", "torch", "actions" (action space) and "algorithm": a list of the states
    of the model's own `generators`, empty for the algorithms of stable-baselines3, which have none.
    """
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002 (stable-baselines3 draws from it)
        "torch": torch.get_rng_state(),
        "actions": model.action_space.np_random.bit_generator.state,
        "algorithm": [generator.bit_generator.state for generator in getattr(model, "generators", ())],
    }


def set_random_state(model: Any, state: dict[str, Any]) -> None:
    """Restore the states of all random generators that the training of a model uses, see `random_state`."""
    random.setstate(state["python"])
    np.random.set_state(state["numpy"])  # noqa: NPY002
    torch.set_rng_state(state["torch"])
    model.action_space.np_random.bit_generator.state = state["actions"]
    for generator, generator_state in zip(getattr(model, "generators", ()), state["algorithm"], strict=True):
        generator.bit_generator.state = generator_state
