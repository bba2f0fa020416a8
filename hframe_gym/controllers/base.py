"""Controller interface and registry.

A controller runs a batch of stages at once. To add one, subclass `Controller` in a new module and register it:

    @CONTROLLERS.register("my-controller")
    class MyController(Controller):
        def act(self, observation): ...

It is then available by name to `make_controller`, `evaluate` and `hframe evaluate`; from a module outside the package
as `my_package.my_module:my-controller`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..machine import Machine
from ..registry import Registry
from .motion_model import MotionModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Feedback = Literal["state", "estimated_state", "observation"]


def check_period(period: float) -> float:
    """Check a control period.

    Args:
        period: Control period, s.

    Returns:
        The period.

    Raises:
        InputError: If the period is not positive and finite.
    """
    if not (np.isfinite(period) and period > 0.0):
        raise InputError(f"period is {period!r}, it must be a positive number of seconds")
    return float(period)


class Controller(ABC):
    """Discrete-time controller of a batch of B stages of one machine.

    A controller may keep a memory of each stage (integrators, estimates, voltages within a dead time); `reset` clears
    it. The batch size follows from the observation.

    Args:
        machine: Machine model from which the controller is designed.
        period: Control period, s.

    Attributes:
        feedback: What the controller needs to measure (class attribute). "state": the true full state; such a
            controller cannot run from sensors. "estimated_state": the full state, which `StateEstimator` supplies where
            the environment observes sensors only. "observation": whatever the environment observes.
        machine: As given.
        period: As given, s.

    Raises:
        InputError: If the period is not positive.
    """

    feedback: ClassVar[Feedback] = "state"

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        self.machine = machine
        self.period = check_period(period)

    @abstractmethod
    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Return the actions for the control period that begins.

        Args:
            observation: `observation`, shape (B, entries): with full state the positions of x, y and of the driven
                coordinates, then their velocities, in m, rad, m/s and rad/s. `desired_goal`, shape (B, 2), m. For a
                moving goal also `preview`, shape (B, 2 P), m: the goal at the end of this period, of the next, ...

        Returns:
            Voltages divided by the rated voltages, in [-1, 1], shape (B, drives).
        """

    def reset(self, mask: Mask | None = None) -> None:  # noqa: B027  (optional)
        """Start a new episode: clear the memory of some stages or of all.

        Args:
            mask: Stages to reset, shape (B,). Default: all; the batch size may then change.
        """

    def replace_last_action(self, actions: Array) -> None:  # noqa: B027  (optional)
        """Correct the controller's memory where other actions were applied than those that `act` returned last.

        Args:
            actions: Actions that were applied, in [-1, 1], shape (B, drives).
        """


CONTROLLERS: Registry[type[Controller]] = Registry("controller")


class EpisodeStarts:
    """Marks the stages of a batch whose episode starts with the next observation.

    Attributes:
        mask: Stages whose episode starts, shape (B,); empty before the first batch.
    """

    def __init__(self) -> None:
        self.mask: Mask = np.zeros(0, np.bool_)

    def reset(self, mask: Mask | None = None) -> None:
        """Mark stages.

        Args:
            mask: Stages whose episode starts, shape (B,). Default: all; the batch size may then change.
        """
        if mask is None:
            self.mask = np.zeros(0, np.bool_)
        elif len(self.mask):
            self.mask = self.mask | mask

    def resize(self, count: int) -> bool:
        """Adapt to the size of a batch; all stages of a batch of another size start an episode.

        Args:
            count: Number of stages, B.

        Returns:
            Whether the size has changed, so that memory of the stages must be allocated anew.
        """
        if len(self.mask) == count:
            return False
        self.mask = np.ones(count, np.bool_)
        return True

    def clear(self) -> None:
        """Unmark all stages."""
        self.mask = np.zeros(len(self.mask), np.bool_)


class Estimator(Protocol):
    """State estimator of a batch of B stages; `StateEstimator` is one.

    Attributes:
        model: Model of the machine.
        period: Control period, s.
        channels: Number of measurements per stage.
    """

    model: MotionModel
    period: float
    channels: int

    def reset(self, mask: Mask | None = None) -> None:
        """Start a new episode.

        Args:
            mask: Stages to reset, shape (B,). Default: all.
        """

    def update(self, measurements: Array) -> Array:
        """Estimate the state at the time of new measurements.

        Args:
            measurements: Measurements in the channels' units, shape (B, channels).

        Returns:
            Travel and its velocity, m and m/s, shape (B, 2 n).
        """

    def send(self, volts: Array) -> None:
        """Record the voltages of the period that begins.

        Args:
            volts: Voltages, V, shape (B, drives).
        """

    def replace_last(self, volts: Array) -> None:
        """Replace the voltages that were sent last.

        Args:
            volts: Voltages, V, shape (B, drives).
        """


class OutputFeedbackController(Controller):
    """A full-state controller that runs from estimated states.

    Args:
        controller: Full-state controller.
        estimator: Estimator of its machine; `observation` must begin with the estimator's measurements.
    """

    feedback: ClassVar[Feedback] = "observation"

    def __init__(self, controller: Controller, estimator: Estimator) -> None:
        super().__init__(estimator.model.machine, estimator.period)
        self.controller, self.estimator = controller, estimator

    def reset(self, mask: Mask | None = None) -> None:
        """Start a new episode on some stages or all."""
        self.controller.reset(mask)
        self.estimator.reset(mask)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Return the actions for the control period that begins.

        Args:
            observation: `observation`, shape (B, channels or more), in the channels' units; `desired_goal` and perhaps
                `preview` as in `Controller.act`.

        Returns:
            Voltages divided by the rated voltages, in [-1, 1], shape (B, drives).

        Raises:
            InputError: If a measurement is not finite.
        """
        model = self.estimator.model
        state = self.estimator.update(observation["observation"][:, : self.estimator.channels])
        actions = self.controller.act({**observation, "observation": model.observation(state)})
        self.estimator.send(np.clip(actions, -1.0, 1.0) * model.rated)
        return actions

    def replace_last_action(self, actions: Array) -> None:
        """Correct the voltages that were sent last."""
        self.controller.replace_last_action(actions)
        self.estimator.replace_last(actions * self.estimator.model.rated)
