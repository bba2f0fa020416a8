"""A controller on observations and actions as an environment with `normalize` or `flat` has them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..arrays import Mask
from .base import Controller, Feedback


class Format(Protocol):
    """Format of an environment's observations; `ObservationFormat` of hframe_gym.envs implements it."""

    def restore(self, observation: Any) -> dict[str, NDArray[np.float32]]:
        """Convert n observations to arrays by key, m, rad, m/s and rad/s, shape (n, entries of the key)."""


class EnvironmentController(Controller):
    """Adapter that lets a controller read the observations of an environment as `step` returns them.

    It undoes the options `normalize`, `flat` and `error`. An observation without batch axis is that of one
    machine.

    Args:
        controller: Controller that reads observations as arrays by key in SI units.
        form: Format of the environment's observations.
    """

    feedback: ClassVar[Feedback] = "observation"

    def __init__(self, controller: Controller, form: Format) -> None:
        super().__init__(controller.machine, controller.period)
        self.controller, self._form = controller, form

    @override
    def act(self, observation: Any) -> NDArray[Any]:
        """Compute the actions from an observation as the environment returns it.

        The arrays of a vector environment have a first axis of B environments.

        Returns:
            Voltages divided by the rated voltages, in [-1, 1], float32, shape (drives,) or (B, drives).

        Raises:
            InputError: If the observation has another form than those of the environment.
        """
        parts = observation if isinstance(observation, Mapping) else {"": np.asarray(observation)}
        single = all(np.ndim(values) == 1 for values in parts.values())
        if single and isinstance(observation, Mapping):
            observation = {key: values[None] for key, values in observation.items()}
        elif single:
            observation = parts[""][None]
        actions = self.controller.act(self._form.restore(observation))
        limited = np.clip(actions, -1.0, 1.0).astype(np.float32)
        return limited[0] if single else limited

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self.controller.reset(mask)

    @override
    def replace_last_action(self, actions: NDArray[Any]) -> None:
        self.controller.replace_last_action(actions)
