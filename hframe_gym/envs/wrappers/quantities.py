"""Quantities of a step: what rewards, costs and observations can use besides the positions of tool and goal.

A quantity is a function of `StepRecord`, registered by name; the wrappers in `wrappers` subtract quantities
from the reward, compare them with limits, or observe them. Environments without these wrappers compute none
of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import Array
from ...dynamics import Equations, MotionPoint
from ...registry import Registry
from ..environment_batch import EnvironmentBatch
from ..workspace import outside_workspace


@dataclass(frozen=True)
class Quantity:
    """A number that describes a step.

    Attributes:
        function: Function of `StepRecord` that returns the numbers of all environments, shape (count,).
        unit: Unit of the numbers, "1" if dimensionless.
        largest: Typical largest value, in the unit, by which observations are scaled.
    """

    function: Callable[[StepRecord], Array]
    unit: str
    largest: float


QUANTITIES: Registry[Quantity] = Registry("quantity")


class StepRecord:
    """The last step of a batch of environments.

    Attributes:
        batch: The environments after the step.
        actions: Voltages in the step as fractions of the rated ones, in [-1, 1], shape (count, drives).
        last_actions: Those of the step before, 0 at the start of an episode, shape (count, drives).
        period: Length of the step, s.
    """

    def __init__(self, batch: EnvironmentBatch, actions: Array, last_actions: Array) -> None:
        self.batch, self.actions, self.last_actions = batch, actions, last_actions
        self.period = batch.config.period
        simulator = batch.simulator
        self._count = len(batch.machine.coordinates)
        names = batch.machine.parameters
        values = {name: self._by_machine(simulator.parameters[:, row]) for row, name in enumerate(names)}
        self._equations = Equations(batch.machine, values)
        rows = [self._by_machine(simulator.state[:, row]) for row in range(simulator.state.shape[1])]
        self._point = MotionPoint(rows[: self._count], rows[self._count : 2 * self._count])

    def _by_machine(self, blocks: Array) -> Array:
        """Return values (count,) from those of all SIMD lanes, (blocks, LANES)."""
        return blocks.reshape(-1)[: self.batch.count]

    @cached_property
    def voltages(self) -> Array:
        """Commanded voltages, V, shape (count, drives)."""
        return self.actions * np.array([drive.rated_voltage for drive in self.batch.machine.drives])

    @cached_property
    def tool_positions(self) -> Array:
        """True positions of the tool, m or rad, shape (count, axes)."""
        return self.batch.simulator.tool_positions()

    @cached_property
    def tool_velocities(self) -> Array:
        """True velocities of the coordinates of the tool axes, m/s, shape (count, axes).

        That of a rotary axis is the rate of its belt travel, radius * rad/s.
        """
        names = self.batch.machine.coordinate_names
        return np.stack(
            [self._point.speed[names.index(axis)] for axis in self.batch.machine.tool_axes], axis=1
        )

    @cached_property
    def belt_tensions(self) -> Array:
        """Tensions of the belts beyond the pretension, N, shape (count, belts)."""
        tensions = [
            np.broadcast_to(b.tension, self.batch.count) for b in self._equations.belt_states(self._point)
        ]
        return np.stack(tensions, axis=1) if tensions else np.zeros((self.batch.count, 0))

    @cached_property
    def currents(self) -> Array:
        """Currents of the drives, A, shape (count, drives): (V - back-EMF) / R with the commanded voltage V.

        Inductance, current limits and delays are not included.
        """
        drives = range(len(self.batch.machine.drives))
        return np.stack(
            [self._equations.ohmic_current(j, self._point, self.voltages[:, j]) for j in drives], axis=1
        )


def quantity(name: str, unit: str, largest: float) -> Callable[[Callable[[StepRecord], Array]], Quantity]:
    """Return a decorator that registers a function of `StepRecord` as a quantity.

    Args:
        name: Name under which penalties, costs and observations select the quantity.
        unit: Unit of the quantity, "1" if dimensionless.
        largest: Typical largest value, in the unit.

    Returns:
        Decorator of a function that returns the numbers of all environments, shape (count,).
    """

    def register(function: Callable[[StepRecord], Array]) -> Quantity:
        made: Quantity = QUANTITIES.register(name)(Quantity(function, unit, largest))  # type: ignore[arg-type]
        return made

    return register


@quantity("action", "1", 2.0)
def _action(step: StepRecord) -> Array:
    """Return the sum of the squared actions."""
    return (step.actions**2).sum(1)


@quantity("action_change", "1", 8.0)
def _action_change(step: StepRecord) -> Array:
    """Return the sum of the squared changes of the actions since the step before."""
    return ((step.actions - step.last_actions) ** 2).sum(1)


@quantity("saturation", "1", 1.0)
def _saturation(step: StepRecord) -> Array:
    """Return the fraction of the drives at their voltage limit."""
    return (np.abs(step.actions) >= 1.0).mean(1)


@quantity("velocity", "m/s", 1.0)
def _velocity(step: StepRecord) -> Array:
    """Return the speed of the tool, m/s."""
    return np.sqrt((step.tool_velocities**2).sum(1))


@quantity("energy", "J", 2.0)
def _energy(step: StepRecord) -> Array:
    """Return the electrical energy that the drives take from the supply a step, J; negative if they brake."""
    return (step.voltages * step.currents).sum(1) * step.period


@quantity("belt_force", "N", 100.0)
def _belt_force(step: StepRecord) -> Array:
    """Return the largest absolute belt tension beyond the pretension at the end of the step, N."""
    return np.abs(step.belt_tensions).max(1, initial=0.0)


@quantity("outside", "1", 1.0)
def _outside(step: StepRecord) -> Array:
    """Return 1 where the tool is outside the workspace, else 0."""
    return outside_workspace(step.tool_positions, step.batch.workspace).astype(float)
