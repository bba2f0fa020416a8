"""Units of the tool position: meters along linear axes, radians along rotary ones.

Lengths that tasks, rewards and results state in meters, such as the band of 1 mm around a goal, hold for a
rotary axis as angles: at the end of an arm of 0.1 m, 1 mm is 10 mrad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

# m. Arm at whose end an angle is as large as the way of a linear axis: that of a hobby servo, a small robot
# or a wheel.
ARM = 0.1
# rad, range of a rotary axis that declares none: one turn to either side
DEFAULT_TURNS = (-2.0 * math.pi, 2.0 * math.pi)
_BANDS = (1e-3, 2e-4, 5e-5)  # m, settling bands around a goal, from wide to narrow


@dataclass(frozen=True)
class AxisUnit:
    """Unit of positions along the controlled axes of a machine.

    Attributes:
        name: "m" or "rad"; info keys and columns of tables end in it.
        small: "mm" or "mrad", a thousandth of it, in which results state errors.
        per_meter: Number of these units that correspond to one meter: 1 m, or 10 rad.
    """

    name: str
    small: str
    per_meter: float

    @cached_property
    def bands(self) -> Mapping[str, float]:
        """Settling bands: largest distance to the goal, in this unit, by name, from wide to narrow.

        They are {"1mm": 1e-3, "0.2mm": 2e-4, "0.05mm": 5e-5}, or "10mrad", "2mrad" and "0.5mrad".
        """
        sizes = [round(size * self.per_meter, 9) for size in _BANDS]
        return {f"{1e3 * size:g}{self.small}": size for size in sizes}

    @cached_property
    def bound_band(self) -> str:
        """Name of the band, the second widest, in which time-optimal motions end: "0.2mm" or "2mrad"."""
        return list(self.bands)[1]

    @cached_property
    def band_texts(self) -> Mapping[str, str]:
        """Sizes of the settling bands as text, such as "0.2 mm", by name of the band."""
        return {name: f"{1e3 * band:g} {self.small}" for name, band in self.bands.items()}

    @property
    def bound_size(self) -> float:
        """Largest distance to the goal within the band `bound_band`, in this unit."""
        return self.bands[self.bound_band]


METERS = AxisUnit("m", "mm", 1.0)
RADIANS = AxisUnit("rad", "mrad", 1.0 / ARM)
AXIS_UNITS = {unit.name: unit for unit in (METERS, RADIANS)}
