"""A function of observations, such as a policy of any library, as a controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..arrays import Actions, KeyedObservation, Mask
from ..errors import InputError
from ..machine import Machine
from .base import Controller, Feedback
from .observation_checks import UnitCheck

Policy = Callable[[Any], Any]


class PolicyForm(Protocol):
    """Form of an environment's observations; `ObservationFormat` of hframe_gym.envs implements it."""

    @property
    def sizes(self) -> Mapping[str, int]:
        """Numbers of entries of the arrays, before `apply`, by key."""

    def apply(self, observation: dict[str, NDArray[np.float32]]) -> Any:
        """Convert an `observation` by key, m, rad, m/s and rad/s, shape (n, entries of the key) each."""


class PolicyController(Controller):
    """Controller that applies a function of observations in the form of an environment.

    Args:
        policy: Function of n observations, with a first axis of n, that returns actions, shape (n, drives).
            If it has a method `reset(mask)`, that clears its memory of machines that start a new episode next
            (None: of all).
        form: Form in which the policy observes.
        period: Control period, s.
        full_state: Whether it observes the full state instead of sensors.
    """

    feedback: ClassVar[Feedback] = "observation"

    def __init__(
        self, policy: Policy, form: PolicyForm, machine: Machine, period: float, full_state: bool = True
    ) -> None:
        super().__init__(machine, period)
        self.policy, self._form = policy, form
        self._check_units = UnitCheck(machine, full_state)

    @override
    def reset(self, mask: Mask | None = None) -> None:
        forget = getattr(self.policy, "reset", None)
        if forget is not None:
            forget(mask)

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        """Compute the actions.

        Raises:
            InputError: If the observation has other entries than the policy observes, or the policy returns
                actions of another shape or that are not finite.
        """
        self._check_units(observation)
        for key, size in self._form.sizes.items():
            found = observation[key].shape[1] if key in observation else 0
            if found != size:
                raise InputError(f"the policy observes {size} entries of {key}, and there are {found}")
        actions = np.asarray(self.policy(self._form.apply(dict(observation))), np.float64)
        expected = (len(observation["observation"]), len(self.machine.drives))
        if actions.shape != expected:
            raise InputError(
                f"the policy returned actions of shape {actions.shape} for {expected[0]} observations; "
                f"return one row for each observation, shape {expected}"
            )
        if not np.isfinite(actions).all():
            raise InputError("the policy returned an action that is not finite")
        return actions
