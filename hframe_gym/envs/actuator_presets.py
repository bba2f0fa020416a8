"""How an action becomes a voltage: ideal drives, or those of a rig."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from ..effects import EFFECTS
from ..machine import Machine


@dataclass(frozen=True)
class Actuators:
    """What stands between a commanded voltage and the motors; None where a thing is ideal.

    bits: of the D/A converter, which covers -range_V to range_V (None: the rated voltage) in 2**bits levels.
    current_limit: A, either way.  The amplifier lowers the voltage so that |V - Ke N w| / R stays within it, judged
        anew in every step of the integrator.
    delay: dead time between an action and its voltage, s; the machine gets the effect `input_delay`, whose parameter
        may be randomised like any other.

    Raises ValueError for numbers that cannot be.
    """

    bits: int | None = None
    range_V: float | None = None
    current_limit: float | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        if self.bits is not None and not 1 <= self.bits <= 32:
            raise ValueError(f"drives: bits is {self.bits!r}, it must be from 1 to 32 or None")
        for name in ("range_V", "current_limit"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"drives: {name} is {value!r}, it must be a positive number or None")
        if not 0.0 <= self.delay <= 0.1:
            raise ValueError(f"drives: delay is {self.delay!r}, it must be from 0 to 0.1 s")

    def on(self, machine: Machine) -> Machine:
        """The machine with these drives' dead time.

        Raises ValueError when the machine has one already.
        """
        if self.delay == 0.0:
            return machine
        effect = EFFECTS["input_delay"].at("drives", d=self.delay)
        if any(e.label == effect.label for e in machine.effects):
            raise ValueError(
                f"drives: machine {machine.name!r} has a dead time already ({effect.label}), leave delay at 0"
            )
        return machine.with_effects(effect)


IDEAL = Actuators()
# Section II: a 12-bit D/A converter before amplifiers of type A12.  The paper gives no current limit; 12 A is the peak
# current of amplifiers of that name, and short of the 17 A that 12 V drive through a motor at rest.
RIG = Actuators(bits=12, current_limit=12.0)

PRESETS = {"ideal": IDEAL, "rig": RIG}
ActuatorsLike: TypeAlias = Literal["ideal", "rig"] | Actuators


def as_actuators(drives: ActuatorsLike) -> Actuators:
    """Drives by the name of a preset, or the drives themselves.

    Raises ValueError for an unknown name or another type.
    """
    if isinstance(drives, Actuators):
        return drives
    if not isinstance(drives, str) or drives not in PRESETS:
        raise ValueError(f"drives is {drives!r}, choose one of {', '.join(PRESETS)} or a Drives")
    return PRESETS[drives]
