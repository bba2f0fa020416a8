"""The processor time of a controller, which results state."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..arrays import Array
from ..controllers import Controller


class TimedController(Controller):
    """A controller whose processor time is measured; its actions are those of `controller`.

    Attributes:
        controller: The measured controller.
        cpu_s: Processor time of `act` so far, s.
        actions: Number of actions so far: calls of `act` times machines.
    """

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.machine, controller.period)
        self.controller, self.cpu_s, self.actions = controller, 0.0, 0

    @override
    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Return the actions of the measured controller, and add up its processor time in `cpu_s`."""
        start = time.process_time()
        actions = self.controller.act(observation)
        self.cpu_s += time.process_time() - start
        self.actions += len(actions)
        return actions

    @override
    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Reset the measured controller; the time and number of its actions stay."""
        self.controller.reset(mask)
