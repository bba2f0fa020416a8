"""Kinds of drives: which quantity an input commands, and the force that follows.

Kinds whose torque follows a law of their own are in `hframe_gym.drives`, one file each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from typing_extensions import override

from ..registry import Registry
from .declaration import FIXED_UNITS, UNITS, CoordinateKind
from .effect import AppliedEffect, Effect


class DriveKind:
    """Base class of drive kinds: which quantity an input commands, and the torque that follows.

    A kind is a subclass that registers itself with `@DRIVE_KINDS.register("name")`. Kinds are never
    instantiated. The current that a command causes is (command - Ke * gear_ratio * w) / resistance, where a
    drive that controls its current has Ke 0 and resistance 1: its amplifier supplies whatever voltage is
    necessary. A kind with a `law` has another relation between command, motion and torque, for example the
    controller of a servo.

    Attributes:
        command: Quantity of the command in simulations: "voltage", "current", "torque" (of the motor shaft),
            or the "position" or "speed" of the coordinate.
        fraction: Whether recordings have the command as a fraction of the supply voltage, from -1 to 1.
        fixed: Values of the parameters of `Drive` that a drive of this kind does not have.
        units: Units of parameters of `Drive` that have another one for this kind.
        law: Torque of the motor shaft, Nm, as the formula `current` of an effect on a drive, which may have a
            state (`Effect`). None: the motor's equation above.
        defaults: Values of parameters that a file need not state. At its default, a parameter of the law has
            no influence, and it is not identified.
        largest: Parameter of the law that is the largest torque, Nm.
        unit_of_force: Parameter of the law in proportion to which all torques are. Motion alone does not
            determine it: with all masses and friction forces in the same proportion, the motion is the same.
    """

    command: ClassVar[str] = "voltage"
    fraction: ClassVar[bool] = False
    fixed: ClassVar[Mapping[str, float]] = {}
    units: ClassVar[Mapping[str, str]] = {}
    law: ClassVar[Effect | None] = None
    defaults: ClassVar[Mapping[str, float]] = {}
    largest: ClassVar[str] = ""
    unit_of_force: ClassVar[str] = ""

    @classmethod
    def damping(cls, gear_ratio: Any, law_parameters: Mapping[str, Any]) -> Any:
        """Return by how much a law's force falls per speed of the coordinate, Ns/m or Nms; 0 if it does not.

        It holds while the torque is within its limits. The integrator solves this part exactly, so that a
        stiff loop needs no short steps.

        Args:
            gear_ratio: Gear ratio of the drive, rad/m or rad/rad: float, array of any shape or expression.
            law_parameters: Values of the parameters of the law, SI, of the same type.
        """
        return 0.0

    @classmethod
    def largest_jump(cls, gear_ratio: float, law_parameters: Mapping[str, float]) -> float:
        """Return the largest sudden change of a commanded position that the drive follows.

        Args:
            gear_ratio: Gear ratio of the drive, rad/m or rad/rad.
            law_parameters: Values of the parameters of the law, SI.

        Returns:
            Change of the coordinate's position, m or rad; infinite if the drive follows any.
        """
        return math.inf

    @classmethod
    def unit(cls, coordinate: CoordinateKind) -> str:
        """Return the unit of the command, such as "V", "A" or, for a position of a rotary coordinate, "rad".

        Args:
            coordinate: Kind of the coordinate that the drive moves.
        """
        return FIXED_UNITS.get(cls.command) or UNITS[coordinate][cls.command]


DRIVE_KINDS: Registry[type[DriveKind]] = Registry("drive kind", package="hframe_gym.drives", base=DriveKind)


@DRIVE_KINDS.register("voltage")
class VoltageDrive(DriveKind):
    """An amplifier or bridge that applies a voltage to the motor."""


@DRIVE_KINDS.register("duty-cycle")
class DutyCycleDrive(DriveKind):
    """A bridge whose recorded command is a duty cycle, from -1 to 1: a fraction of the supply's voltage.

    Reading a recording multiplies the duty cycle by the measured supply (`Drive.supply`), or by the rated
    voltage in a recording without that column. Everything else knows voltages only.
    """

    fraction = True


@DRIVE_KINDS.register("current")
class CurrentDrive(DriveKind):
    """An amplifier that controls the motor's current; its bandwidth and limit are effects of the drive."""

    command = "current"
    fixed: ClassVar[Mapping[str, float]] = {"Ke": 0.0, "resistance": 1.0}


@DRIVE_KINDS.register("torque")
class TorqueDrive(DriveKind):
    """A drive that controls the torque of the motor shaft; its bandwidth and limit are effects of the drive.

    Its torque constant is 1: the true torque per commanded torque, which identification may correct.
    """

    command = "torque"
    fixed: ClassVar[Mapping[str, float]] = {"Ke": 0.0, "resistance": 1.0}
    units: ClassVar[Mapping[str, str]] = {"Kt": "1"}
    defaults: ClassVar[Mapping[str, float]] = {"Kt": 1.0}


@dataclass(frozen=True)
class DriveLaw(AppliedEffect):
    """The law of one drive, treated like an effect on it; the parameters are those of the drive."""

    @property
    @override
    def label(self) -> str:
        """Name of the drive, with which the full names of the law's parameters begin."""
        return self.site
