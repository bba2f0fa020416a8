"""Feedback laws of which a policy forms a weighted mean: first voltages of transfers to rest at the goal.

A *transfer* is a motion of given duration that brings the machine to rest at its goal with the least sum of
squared voltages. `TransferBank` and `PlanBank` compute the first voltages of several transfers, and
residual_action.py weights them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..controllers import (
    MotionModel,
    OperatingPointGrid,
    ParameterFilter,
    ParameterRatios,
    SimulatedTransfers,
    TransferDesign,
    scaled_machine,
)
from ..errors import InputError
from ..machine import Machine

# Variants of the machine for which transfers are also designed: factors on its belt stiffness and on its
# masses.
VARIANTS = ((0.7, 0.95), (0.7, 1.15), (1.3, 0.95), (1.3, 1.15))
# For variants, only so many transfers, the shortest: the parameters matter most near the goal.
VARIANT_TRANSFERS = 5
LARGEST_WEIGHTED = 1.2  # Fraction of the rated voltage; limit of the voltages before their mean is formed.


class FeedbackLaws(NamedTuple):
    """Voltages that K feedback laws give in the present state, with their derivatives.

    Attributes:
        volts: Voltages divided by the rated voltages, not limited, shape (batch, K, drives).
        gains: Derivatives of `volts` with respect to the entries of the full-state observation, per m, rad,
            m/s or rad/s, shape (batch, K, drives, entries).
    """

    volts: Array
    gains: Array


class TransferBank:
    """First voltages of K minimum-energy transfers (motions to rest at the goal) with several designs.

    Every transfer is designed for `machine`; the first five (`VARIANT_TRANSFERS`) are also designed for each
    of four variants with other belt stiffness and masses (`VARIANTS`). The durations of a variant count from
    its shortest transfer and are limited to its longest one.

    Args:
        period: Control period, s.
        transfers: Durations in control periods beyond the shortest possible transfer, ascending; 0: the
            shortest.

    Attributes:
        size: Number K of transfers.

    Raises:
        InputError: If the machine has no transfer of one of the durations, or they are not ascending.
    """

    def __init__(self, machine: Machine, period: float, transfers: Sequence[int]) -> None:
        self._model = MotionModel(machine)
        self._grid = OperatingPointGrid(machine)
        designed = TransferDesign(self._model, period)
        check_transfers(designed, transfers)
        if any(second <= first for first, second in pairwise(transfers)):
            raise InputError(f"transfers are {list(transfers)}; list durations in ascending order, each once")
        gains = [designed.first_gains(transfers)]
        for stiffness, mass in VARIANTS:
            variant = TransferDesign(MotionModel(scaled_machine(machine, stiffness, mass)), period)
            extra_periods = np.minimum(transfers[:VARIANT_TRANSFERS], variant.longest - variant.shortest)
            gains.append(variant.first_gains(extra_periods.tolist()))
        self._gains = np.concatenate(gains, axis=1) / self._model.rated[:, None]  # (points, K, drives, 2 n)
        self._of_observation = state_of_observation(self._model)
        self.size = self._gains.shape[1]

    def laws(self, observation: NDArray[Any], goal: NDArray[Any]) -> FeedbackLaws:
        """Compute the first voltages of each transfer, with the design for the operating point at the goal.

        The transfers of the declared machine, in the order of the durations, precede those of each variant.

        Args:
            observation: Present full-state observations, m, rad, m/s and rad/s, shape (batch, entries).
            goal: Tool positions of the goals, m, shape (batch, axes).

        Returns:
            Voltages of the first period of each of the K transfers, divided by the rated ones, shape (batch,
            K, drives), and their derivatives by the observation, shape (batch, K, drives, entries).
        """
        travel = self._model.axis_travel(goal)
        gains = self._gains[self._grid.nearest(travel)] @ self._of_observation
        at_rest = self._model.observation(self._model.goal_state(travel))
        return FeedbackLaws(np.einsum("bkij,bj->bki", gains, observation - at_rest), gains)


class PlanBank:
    """First voltages of K transfers, planned in each period for the estimated machine (`SimulatedTransfers`).

    Args:
        period: Control period, s.
        estimator: Estimator of the parameters; `laws` plans with its present estimates.
        durations: Durations of the transfers in periods, ascending.

    Attributes:
        size: Number K of transfers.

    Raises:
        InputError: If the durations are not positive and ascending.
    """

    def __init__(
        self, machine: Machine, period: float, estimator: ParameterFilter, durations: Sequence[int]
    ) -> None:
        self._model, self._estimator, self.size = MotionModel(machine), estimator, len(durations)
        # not its machine, which has no dead time
        self._ratios = ParameterRatios(self._model.machine, estimator.parameter_names)
        self._transfers = SimulatedTransfers(self._model, period, durations)
        self._of_observation = state_of_observation(self._model)

    def laws(self, observation: NDArray[Any], goal: NDArray[Any], last_action: NDArray[Any]) -> FeedbackLaws:
        """Plan each transfer for the estimated machine, in the order of the durations.

        Args:
            observation: Present full-state observations, m, rad, m/s and rad/s, shape (batch, entries).
            goal: Tool positions of the goals, m, shape (batch, axes).
            last_action: Voltages of the period before, divided by the rated voltages, shape (batch, drives).

        Returns:
            Voltages of the first period of each of the K transfers, divided by the rated ones, shape (batch,
            K, drives), and their derivatives by the observation, shape (batch, K, drives, entries).
        """
        rated = self._model.rated
        planned = self._transfers.plan(
            self._model.state({"observation": observation}),
            self._model.axis_travel(goal),
            self._ratios.parameters(self._estimator.estimates),
            last_action * rated,
            self._estimator.memory,
        )
        return FeedbackLaws(planned.volts / rated, planned.gains / rated[:, None] @ self._of_observation)


def check_transfers(designed: TransferDesign, transfers: Sequence[int]) -> None:
    """Raise an InputError if a transfer of one of these durations does not exist for a machine.

    Args:
        designed: Transfers that exist for the machine.
        transfers: Durations in control periods beyond the shortest transfer, at least one; valid from 0 to
            those of the longest one.
    """
    longest = designed.longest - designed.shortest
    if not 0 <= min(transfers) <= max(transfers) <= longest:
        name = designed.model.machine.name
        raise InputError(
            f"transfers are {list(transfers)}; "
            f"machine {name!r} has those of 0 to {longest} periods beyond the shortest"
        )


def state_of_observation(model: MotionModel) -> Array:
    """Return the matrix from a full-state observation, SI, to the state of n coordinates, shape (2 n, 2 n).

    The state is their belt travel, m, then its rate, m/s.
    """
    return model.state({"observation": np.eye(2 * len(model.mass))}).T
