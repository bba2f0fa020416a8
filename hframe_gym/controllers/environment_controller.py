"""A controller on observations and actions as an environment with `normalize` or `flat` has them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from .base import Controller, Feedback, Mask


class Format(Protocol):
    """Form of an environment's observations; `ObservationFormat` of hframe_gym.envs implements it."""

    def restore(self, observation: Any) -> dict[str, NDArray[np.float32]]:
        """Convert observations of n environments to arrays by key in SI units.

        Args:
            observation: Observations as the environments return them, with n rows.

        Returns:
            Arrays by key, m, rad, m/s and rad/s, shape (n, entries of the key).
        """


class EnvironmentController(Controller):
    """Controller that reads the observations of one environment, or of a vector of them, as they are returned.

    It undoes the options `normalize` and `flat`, and takes an observation without batch axis as that of one machine.

    Args:
        controller: Controller of observations by key in SI units.
        form: Form of the observations.

    Attributes:
        controller: As given.
    """

    feedback: ClassVar[Feedback] = "observation"

    def __init__(self, controller: Controller, form: Format) -> None:
        super().__init__(controller.machine, controller.period)
        self.controller, self._form = controller, form

    def act(self, observation: Any) -> NDArray[Any]:
        """Compute the actions for the control period that starts now; call it once per period.

        Args:
            observation: Observation as the environment returns it: arrays by key or, with `flat`, one array. Of a
                single environment without, of a vector with a first axis of B environments.

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

    def reset(self, mask: Mask | None = None) -> None:
        """Clear the memory of the machines that start a new episode with their next observation.

        Args:
            mask: True for the machines to reset, shape (B,) for B machines. None: all; their number may then change.
        """
        self.controller.reset(mask)

    def replace_last_action(self, actions: NDArray[Any]) -> None:
        """Replace the stored actions of this control period with the actions that were actually applied.

        Args:
            actions: Applied voltages divided by the rated voltages, in [-1, 1], shape (B, drives) for B machines.
        """
        self.controller.replace_last_action(actions)
