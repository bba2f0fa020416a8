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
    """Format of a policy's observations; `ObservationFormat` of hframe_gym.envs implements it."""

    @property
    def sizes(self) -> Mapping[str, int]:
        """Number of entries of each observed array, by key."""

    def apply(self, observation: dict[str, NDArray[np.float32]]) -> Any:
        """Convert an `observation`, arrays by key in SI units, to the policy's format.

        Each array has the shape (n, entries of the key).
        """


class PolicyController(Controller):
    """Controller that applies a policy of any library, given as a function of observations.

    Args:
        policy: Function of n observations, with a first axis of n, that returns actions, shape (n, drives). A
            policy with a memory has a method `reset(mask)`, called for machines that start a new episode next
            (None: all).
        form: Format of the policy's observations.
        period: Control period, s.
        full_state: Whether the policy observes the full state instead of sensors.
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
