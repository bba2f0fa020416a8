"""Actuators of an environment: those of the machine, or D/A converters, dead time and current limit.

The machine declares the D/A converter of each drive (bits, voltage range). Dead time and current limit are
effects of the machine (modeled deviations from the basic model), `input_delay` and `current_limit`.
`applied_voltages` simulates converters and dead times; the compiled simulation kernel (code generated for a
machine) simulates the current limit.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ...dynamics.codegen.compiled import compiled
from ...effects import EFFECTS
from ...errors import InputError, is_integer, is_number, suggestion
from ...machine import Machine


@dataclass(frozen=True)
class Actuators:
    """D/A converter, current limit and dead time of all drives. They replace the machine's converters.

    Args:
        bits: Resolution of the D/A converter, an integer from 1 to 32: it has 2**bits levels from -range_V to
            range_V; None: not quantized.
        range_V: Voltage range of the converter, V; None: the rated voltage.
        current_limit: Largest current in either direction, A; None: only the machine's limits. The amplifier
            lowers the voltage V so that |V - Ke N w| / R stays within the limit (back-EMF constant Ke, gear
            ratio N, pulley speed w, resistance R). A smaller limit of the machine remains.
        delay: Dead time between action and voltage, s.

    Raises:
        InputError: If a number is invalid.
    """

    bits: int | None = None
    range_V: float | None = None
    current_limit: float | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        if self.bits is not None and not (is_integer(self.bits) and 1 <= self.bits <= 32):
            raise InputError(f"drives: bits is {self.bits!r}, it must be an integer from 1 to 32 or None")
        for name in ("range_V", "current_limit"):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and value > 0.0):
                raise InputError(f"drives: {name} is {value!r}, it must be a positive number or None")
        if not (is_number(self.delay) and 0.0 <= self.delay <= 0.1):
            raise InputError(f"drives: delay is {self.delay!r}, it must be a number from 0 to 0.1 s")

    def apply(self, machine: Machine) -> Machine:
        """Return a copy of a machine whose drives have this D/A converter, current limit and dead time.

        `bits` and `range_V` replace the converter of every drive. `current_limit` and `delay` become the
        effects `current_limit` and `input_delay`; a smaller current limit of a drive remains.

        Raises:
            InputError: If the machine has an input delay already and `delay` is not 0.
        """
        drives = [
            dataclasses.replace(d, converter_bits=self.bits or 0, voltage_range=self.range_V)
            for d in machine.drives
        ]
        machine = machine.replace(drives=tuple(drives))
        if self.current_limit is not None:
            for drive in machine.drives:
                machine = _with_current_limit(machine, drive.name, self.current_limit)
        if self.delay == 0.0:
            return machine
        present = [e.label for e in machine.effects if e.definition.delay]
        if present:
            raise InputError(
                f"drives: machine {machine.name!r} has a dead time already ({', '.join(present)}); "
                "leave delay at 0"
            )
        return machine.with_effects(EFFECTS["input_delay"].at("drives", d=self.delay))


def _with_current_limit(machine: Machine, drive: str, limit: float) -> Machine:
    """Return the machine with a current limit of a drive, A, or the smaller one that it has already."""
    effect = EFFECTS["current_limit"].at(drive, I=limit)
    name = f"{effect.label}.I"
    if name in machine.parameters:
        return machine.replace({name: min(limit, machine.parameters[name])})
    return machine.with_effects(effect)


# Section II of Sollmann et al. (2010): a 12-bit converter and amplifiers of type A12. The paper gives no
# current limit; 12 A is the peak current of amplifiers of this name. At standstill 12 V would drive 17 A.
ACTUATOR_PRESETS: dict[str, Actuators | None] = {
    "ideal": Actuators(),
    "rig": Actuators(bits=12, current_limit=12.0),
    "machine": None,
}
_FLOAT32 = np.dtype(np.float32)
ActuatorsLike: TypeAlias = Literal["ideal", "rig", "machine"] | Actuators


def with_actuators(machine: Machine, drives: ActuatorsLike) -> Machine:
    """Return a copy of a machine with converters, current limits and dead time of an environment.

    The converters replace those of the machine. The machine keeps a dead time that it already has, and a
    current limit that is smaller than that of `drives`.

    Args:
        drives: What to add: `Actuators`, or a name of `ACTUATOR_PRESETS`. With "machine", nothing is added or
            replaced, and the machine itself is returned.

    Raises:
        InputError: If `drives` is invalid, or both the machine and `drives` have a dead time.
    """
    if isinstance(drives, Actuators):
        return drives.apply(machine)
    if not isinstance(drives, str) or drives not in ACTUATOR_PRESETS:
        raise InputError(
            f"drives is {drives!r}; choose one of {', '.join(ACTUATOR_PRESETS)}, or give Actuators(...)"
            f"{suggestion(drives, ACTUATOR_PRESETS)}"
        )
    preset = ACTUATOR_PRESETS[drives]
    return machine if preset is None else preset.apply(machine)


def action_space(machine: Machine) -> spaces.Box:
    """Create the action space: the voltage of each drive as a fraction of its rated voltage."""
    return spaces.Box(-1.0, 1.0, (len(machine.drives),), np.float32)


def check_actions(
    actions: Any, shape: tuple[int, int], machine: Machine, *, single: bool = False
) -> NDArray[Any]:
    """Check that actions have the shape (environments, drives) and are finite; convert them to floats.

    They may exceed [-1, 1], to which the actuators limit them. float32 stays float32, all others become
    float64.

    Args:
        single: Whether the caller has a single environment; messages then state the shape without the axis of
            environments.

    Raises:
        ValueError: If actions are not numbers, have another shape, or an entry is not finite.
    """
    values = np.ascontiguousarray(actions)
    if values.dtype != _FLOAT32:
        if values.dtype.kind not in "fiub":
            given = "the action is" if single else "actions are"
            raise ValueError(f"{given} of the type {values.dtype}; give numbers")
        values = values.astype(np.float64, copy=False)
    if values.shape != shape:
        drives = ", ".join(drive.name for drive in machine.drives)
        if single:
            raise ValueError(
                f"the action has shape {values.shape[1:]}; "
                f"give {shape[1:]}, a number for each drive ({drives})"
            )
        raise ValueError(
            f"actions have shape {values.shape}; "
            f"give {shape}, for each environment a number for each drive ({drives})"
        )
    if not _all_finite(values):
        b, k = np.argwhere(~np.isfinite(values))[0].tolist()
        of = "" if single else f"environment {b}, "
        raise ValueError(
            f"action of {of}{machine.drives[k].name}: {values[b, k]} is not finite; give numbers from -1 to "
            "1. If a policy returned it, its training has diverged"
        )
    return values


@compiled
def _all_finite(actions: Any) -> bool:
    """Return whether all entries of actions (B, drives) are finite."""
    values, bad = actions.reshape(-1), 0
    for i in range(len(values)):  # without an exit at the first one, so that the compiler vectorizes the loop
        bad += not abs(values[i]) < math.inf
    return bad == 0
