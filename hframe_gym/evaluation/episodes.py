"""Recorded episodes of a controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..machine import METERS, AxisUnit, Machine


class Command(NamedTuple):
    """Quantity that the actions command in a simulation, such as the drives' voltages.

    Attributes:
        name: The quantity, such as "current"; "voltage" also for a duty cycle, which is a voltage in
            simulations.
        unit: Unit of the command; empty if the drives have different ones.
    """

    name: str = "voltage"
    unit: str = "V"

    @classmethod
    def of(cls, machine: Machine) -> Command:
        """Return name and unit of what a machine's drives are commanded."""
        of_voltage = all(drive.command == "voltage" for drive in machine.drives)
        units = {machine.command_unit(drive) for drive in machine.drives}
        name = "voltage" if of_voltage else machine.commands_in_words.removesuffix("s")
        return cls(name, units.pop() if len(units) == 1 else "")

    @property
    def label(self) -> str:
        """Axis label for plots, such as "voltage, V"."""
        return f"{self.name}, {self.unit}" if self.unit else self.name


VOLTAGE = Command()


@dataclass(frozen=True)
class Episodes:
    """Recorded episodes of one controller: B episodes of n samples and m control periods.

    Positions and distances are in m, or in rad for rotary axes (`unit`).

    Attributes:
        time_s: Sample times, s, shape (n,).
        position: True tool position, m, shape (B, n, axes).
        goal: Goal, m, shape (B, n, axes).
        contour: Distance of the tool to the path (contour error), m, shape (B, n); None for a task without a
            path.
        volts: Applied voltages, V, or other commands in the unit of `command`, shape (B, m, drives).
        rated: Rated voltages, V, or largest other commands, shape (drives,).
        energy_J: Energy from the supply minus energy fed back, J, shape (B,); None if drives take other
            commands than voltages, whose energy the simulation does not know.
        peak_belt_force_N: Largest difference between a belt's tension and its pretension, N, shape (B,).
        unit: Unit of the tool position.
        command: What the drives are commanded by.
    """

    time_s: Array
    position: Array
    goal: Array
    contour: Array | None
    volts: Array
    rated: Array
    energy_J: Array | None
    peak_belt_force_N: Array
    unit: AxisUnit = METERS
    command: Command = VOLTAGE

    @property
    def goal_error(self) -> Array:
        """Distances of the tool to its present goal at n samples of B episodes, m or rad, shape (B, n)."""
        return np.linalg.norm(self.position - self.goal, axis=2)
