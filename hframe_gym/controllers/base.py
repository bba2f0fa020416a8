"""What a controller is: observations of a batch of stages in, shares of the rated voltages out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .adaptive_pid import AdaptivePID
from .model_pid import ModelBasedController
from .textbook_pid import TextbookPID


class Controller(Protocol):
    """A controller of B stages at once; it may remember what it saw of each since its last reset."""

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Actions (B, drives) in [-1, 1] for `observation` (B, entries), `desired_goal` (B, 2), m, and for a goal that
        moves `preview` (B, 2 P), m, where it is at the end of this period, of the next, ..."""

    def applied(self, actions: NDArray[np.float64]) -> None:
        """The stages were given actions (B, drives) in [-1, 1], and not what `act` answered last."""

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the stages of mask (B,), or all: their next observation begins an episode."""


# By the names of `hframe evaluate`; each is made as (machine, period in s).
CONTROLLERS: dict[str, Callable[[Machine, float], Controller]] = {
    "pid": ModelBasedController,
    "adaptive-pid": AdaptivePID,
    "textbook-pid": TextbookPID,
}
