"""The quantities of a motion to which sensors respond; kinds of sensors are formulas of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

SensorQuantity = Literal["position", "speed", "acceleration", "current", "tension"]


@dataclass(frozen=True)
class SensedQuantity:
    """Properties of a measured quantity, such as position or current, that all its sensors have in common.

    Attributes:
        component: Kind of the components that `Sensor.row` names.
        jumps: Whether it jumps with the voltage; a sample then shows it under the voltage before the sample.
        is_force: Whether it is a force, or proportional to one by a parameter that is not refitted. Only such
            a measurement determines forces and masses themselves; motion determines their ratios.
    """

    component: Literal["coordinate", "drive", "belt"] = "coordinate"
    jumps: bool = False
    is_force: bool = False


SENSED_QUANTITIES: dict[SensorQuantity, SensedQuantity] = {
    "position": SensedQuantity(),
    "speed": SensedQuantity(),
    "acceleration": SensedQuantity(jumps=True),
    "current": SensedQuantity("drive", jumps=True),
    "tension": SensedQuantity("belt", is_force=True),
}
