"""Convert the actions of an agent to those of another machine than that of its training.

A policy has learned how far a voltage moves its machine. On one with lighter masses or stronger motors, such
as an identified one, the same voltages are a feedback with higher gains, and the tool can oscillate near its
goal. The policy therefore commands, and observes, voltages that would accelerate the machine of its training
equally.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..controllers import MotionModel
from ..machine import Machine


class ActionConversion:
    """Conversion between actions of two machines that accelerate them equally, without stretch of the belts.

    No action becomes larger: a machine that needs higher voltages than that of the training has the same
    voltage limits, and higher gains would bring its belts nearer to oscillating.

    Args:
        trained_on: Machine of the training.
        machine: Machine that is controlled, with as many axes and drives.

    Attributes:
        matrix: Action of `machine` for each drive's action of `trained_on`, dimensionless,
            shape (drives, drives).

    Raises:
        InputError: If one of the machines has no `MotionModel`.
    """

    def __init__(self, trained_on: Machine, machine: Machine) -> None:
        learned, present = (_acceleration(MotionModel(of)) for of in (trained_on, machine))
        # The nearest matrix that enlarges no action has singular values of at most 1.
        left, factors, right = np.linalg.svd(np.linalg.solve(present, learned))
        self.matrix: Array = (left * factors.clip(max=1.0)) @ right
        self._inverse = np.linalg.inv(self.matrix)

    def to_machine(self, actions: NDArray[Any]) -> NDArray[Any]:
        """Convert `actions` of the machine of the training to those of the machine that is controlled.

        Both are fractions of the rated voltages, of one or several periods after each other,
        shape (batch, periods * drives).
        """
        return _each_period(actions, self.matrix)

    def to_training(self, actions: NDArray[Any]) -> NDArray[Any]:
        """Convert `actions` of the machine that is controlled to those of the machine of the training.

        Both have the shape and unit of `to_machine`.
        """
        return _each_period(actions, self._inverse)

    def gains(self, gains: dict[str, list[list[float]]]) -> dict[str, list[list[float]]]:
        """Convert the gains of model-based controllers to those for the machine of the training.

        The gains are matrices from the entries of an observation to actions, as `feature_parameters` returns
        them; the features of a policy contain these actions.

        Args:
            gains: Matrices for the machine that is controlled, by key of the observation, nested lists of
                shape (controllers * drives, entries of the key): all drives' actions (fractions of the rated
                voltages) by the first controller, then those by the next one.

        Returns:
            Matrices of the same shapes, which give actions of the machine of the training. The one of
            "last_action" also expects the last action as that of the machine of the training.
        """
        converted = {key: self.to_training(np.transpose(values)).T for key, values in gains.items()}
        if "last_action" in converted:  # which the policy observes in voltages of the training as well
            converted["last_action"] = _each_period(converted["last_action"], self.matrix.T)
        return {key: values.tolist() for key, values in converted.items()}


def _acceleration(model: MotionModel) -> Array:
    """Return the acceleration along each axis per action of each drive, m/s^2, shape (axes, drives)."""
    mass = (model.rigid.T * model.mass) @ model.rigid
    return np.asarray(np.linalg.solve(mass, model.force_per_volt * model.rated))


def _each_period(actions: NDArray[Any], matrix: Array) -> NDArray[Any]:
    """Multiply the actions of each period, shape (batch, periods * drives), by a matrix."""
    of_periods = actions.reshape(len(actions), -1, len(matrix))
    return np.asarray((of_periods @ matrix.T).reshape(actions.shape))
