"""Full-state controllers that run from sensor measurements, by a state estimator."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np
from typing_extensions import override

from ..arrays import Actions, Array, KeyedObservation, Mask, TravelStates, Volts
from .base import Controller, Feedback
from .models.motion_model import MotionModel
from .observation_checks import check_goal_units, check_keys


class Estimator(Protocol):
    """Interface of a state estimator for a batch of machines; `StateEstimator` implements it.

    In every control period, call `update` with the measurements, then `send` with the voltages.

    Attributes:
        period: Control period, s.
        channels: Number of measurements per machine.
    """

    model: MotionModel
    period: float
    channels: int

    def reset(self, mask: Mask | None = None) -> None:
        """Discard the estimates of the machines in the mask (None: all), which start a new episode."""

    def update(self, measurements: Array) -> TravelStates:
        """Estimate the state at new `measurements`, one per sensor, m or rad, shape (B, channels)."""

    def send(self, volts: Volts) -> None:
        """Store the voltages commanded for the period that starts now; `update` predicts with them."""

    def replace_last(self, volts: Volts) -> None:
        """Replace the voltages that `send` stored last with the voltages that were actually applied."""


class OutputFeedbackController(Controller):
    """Full-state controller combined with a state estimator, so that it runs from sensor measurements.

    Args:
        controller: Full-state controller (`feedback` is "state" or "estimated_state").
        estimator: State estimator of the same machine and control period. Its measurements are the first
            `estimator.channels` columns of the array `observation` that the environment returns.

    Raises:
        InputError: If the estimator's period is invalid.
    """

    feedback: ClassVar[Feedback] = "observation"

    def __init__(self, controller: Controller, estimator: Estimator) -> None:
        super().__init__(estimator.model.machine, estimator.period)
        self.controller, self.estimator = controller, estimator

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self.controller.reset(mask)
        self.estimator.reset(mask)

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        """Estimate the state from the measurements, then compute the actions.

        Columns of `observation` beyond the estimator's channels are ignored.
        """
        check_keys(observation)
        model = self.estimator.model
        check_goal_units(observation, model.machine)
        measurements = observation["observation"][:, : self.estimator.channels]
        state = self.estimator.update(measurements)
        # The controller receives the same arrays, with the estimated full state in place of the measurements.
        actions = self.controller.act({**observation, "observation": model.observation(state)})
        self.estimator.send(np.clip(actions, -1.0, 1.0) * model.rated)
        return actions

    @override
    def replace_last_action(self, actions: Actions) -> None:
        self.controller.replace_last_action(actions)
        self.estimator.replace_last(actions * self.estimator.model.rated)
