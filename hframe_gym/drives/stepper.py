"""A stepper motor: its rotor follows commanded steps by a magnet's torque in a field, T = -T_h sin(p e).

The field stands at the commanded angle; the rotor is held at the error e of its angle by a torque that is a
sine with p periods per turn (50 for a motor with 1.8 degrees per full step). A load beyond the holding torque
T_h pulls the rotor over the top of the sine into the next period: four full steps are lost, without any
further rule. For small errors the motor is a spring, p T_h; the viscous friction of the coordinate, to which
the damping of the motor belongs, decides how long it vibrates.

Reference:
    Acarnley (2002), Stepping Motors: a guide to theory and practice, chapters 3 and 4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from typing_extensions import override

from ..dynamics.elementwise import sin
from ..machine import DRIVE_KINDS, DriveKind, Effect, EffectParameter


def _torque(V, q, N, holding_torque, periods):  # type: ignore[no-untyped-def]
    """Return the torque of the motor shaft, Nm, at the position q, m or rad, for the commanded position V."""
    return holding_torque * sin(periods * N * (V - q))


@DRIVE_KINDS.register("stepper")
class StepperDrive(DriveKind):
    """A stepper motor whose steps command the position of its coordinate, m or rad."""

    command = "position"
    fixed: ClassVar[Mapping[str, float]] = {"Kt": 1.0, "Ke": 0.0, "resistance": 1.0}
    defaults: ClassVar[Mapping[str, float]] = {"periods": 50.0}
    largest = "holding_torque"
    unit_of_force = "holding_torque"
    law = Effect(
        name="stepper_torque",
        family="drive_law",
        site="drive",
        formula="u = holding_torque sin(periods N (r - q))",
        source="Acarnley 2002, Stepping Motors, chapter 3",
        current=_torque,
        signal_order=-1,
        parameters=(
            EffectParameter("holding_torque", "torque", 1e-12, 1e9, scale=1.0),
            EffectParameter("periods", "1", 1.0, 1e4, scale=1.0, role="fixed"),
        ),
    )

    @classmethod
    @override
    def largest_jump(cls, gear_ratio: float, law_parameters: Mapping[str, float]) -> float:
        """Return half a full step, m or rad of the coordinate, at which 0.7 of the holding torque acts."""
        return math.pi / 4.0 / (law_parameters["periods"] * gear_ratio)
