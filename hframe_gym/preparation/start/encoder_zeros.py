"""Zeros of the encoders of a session: their measurements at position 0 with unstretched belts.

An incremental encoder counts from where it was switched on. If it stayed on for a session (consecutive
recordings of a rig), its zero is the same in all runs and is estimated from all of them. An identified
machine carries these zeros (`Sensor.zero`), so that a single run is simulated from the same initial state as
in identification.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, Quanta
from ...machine import Machine
from .belt_stretch import max_held_angle

MAX_SCATTER = 4.0  # Standard deviations of the scatter from run to run within which an encoder kept its zero.


class EncoderZeros(NamedTuple):
    """Zeros of the encoders that kept them from run to run.

    Attributes:
        values: Zero of each sensor, m or rad, NaN where it is unknown, shape (sensors,).
        spread: Standard deviation of the measured zero from run to run, in the sensors' units,
            shape (sensors,). Its cause is the stretch of the belts at rest, which differs from run to run; 0
            where the encoder does not resolve this stretch.
        by_motion: Whether the motion of the runs corrected the values (`with_zeros_of_motion`).
    """

    values: Array
    spread: Array
    by_motion: bool = False

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the sensors whose zero is known, shape (sensors,)."""
        return np.isfinite(self.values)

    @property
    def resolves_stretch(self) -> NDArray[np.bool_]:
        """Mask of encoders whose known zero varies between runs with the belt stretch, shape (sensors,)."""
        # The stretch at rest differs from run to run, and with it the measured zero.
        return self.known & (self.spread > 0.0)

    @classmethod
    def of_machine(cls, machine: Machine) -> EncoderZeros:
        """Read the zeros from the sensors of a machine, in their units, shape (sensors,); NaN if unknown."""
        return cls(
            np.array([np.nan if s.zero is None else s.zero for s in machine.sensors], float),
            np.array([s.zero_std or 0.0 for s in machine.sensors], float),
        )

    def in_machine(self, machine: Machine) -> Machine:
        """Return a copy of a machine whose sensors have these zeros.

        Args:
            machine: Machine to copy; it is not changed. It has one sensor per zero, in the same order.

        Returns:
            Copy of the machine. A sensor with a known zero has this zero (m or rad) and, if the zero varies
            from run to run (attribute `spread` > 0), its standard deviation. A zero that another sensor had
            in `machine` is removed, and its standard deviation with it.
        """
        return machine.replace(
            sensors=tuple(
                dataclasses.replace(
                    sensor,
                    zero=float(self.values[j]) if self.known[j] else None,
                    zero_std=float(self.spread[j]) if self.resolves_stretch[j] else None,
                )
                for j, sensor in enumerate(machine.sensors)
            )
        )

    def without(self, sensors: NDArray[np.bool_]) -> EncoderZeros:
        """Return a copy in which the zeros of some sensors are unknown.

        Args:
            sensors: True for the sensors whose zeros become unknown, shape (sensors,).
        """
        return self._replace(
            values=np.where(sensors, np.nan, self.values), spread=np.where(sensors, 0.0, self.spread)
        )


def zero_tolerance(machine: Machine, zeros: EncoderZeros, quanta: Quanta) -> Array:
    """Return by how much an encoder's zero in one run may differ from its session zero (all runs).

    If it differs by more, the encoder was switched on anew for this run.

    Args:
        machine: Machine with belts.
        zeros: Zeros of the session, with their standard deviations from run to run.

    Returns:
        Largest permitted differences, in the sensors' units, shape (sensors,): the sum of four standard
        deviations, two quantization steps, and twice the angle by which friction can hold the pulley away
        from unstretched belts.
    """
    # Friction can hold the pulley in one direction in this run, and in the other one in those that gave the
    # zeros.
    return np.asarray(2 * max_held_angle(machine) + MAX_SCATTER * zeros.spread + 2 * quanta)
