"""Input shapers for the first mode of each axis: impulses that leave no vibration, as in printer firmware.

A step of the commanded position excites a mode of the carriage against the motors, which the firmware holds
at their commanded positions. If each move is convolved with a few impulses, the vibrations that they excite
cancel. With natural frequency f, damping ratio d, T = 1 / (f sqrt(1 - d^2)) and K = exp(-d pi / sqrt(1 -
d^2)):

    zv    1, K                                                  at 0, T/2
    mzv   1 - 1/sqrt(2), (sqrt(2) - 1) k, (1 - 1/sqrt(2)) k^2   at 0, 3T/8, 3T/4,  k = K^(3/4)
    ei    1 + V, 2 (1 - V) K, (1 + V) K^2                       at 0, T/2, T;  V = 0.05: vibration left at f

each divided by its sum. `ei` tolerates the largest error of f, `zv` is the shortest.

References:
    Singer and Seering (1990), Preshaping command inputs to reduce system vibration (zv).
    Singhose, Seering and Singer (1994), Residual vibration reduction using vector diagrams to generate shaped
    inputs (ei). Klipper, documentation of resonance compensation (mzv).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ...arrays import Array
from ...errors import InputError
from ...machine import Machine, standard_deviations
from ..base import MachineExporter, operating_point, option
from .linear_model import axis_modes

Shaper = Literal["zv", "mzv", "ei"]
SHAPERS: tuple[Shaper, ...] = ("zv", "mzv", "ei")
_TOLERATED_VIBRATION = 0.05  # V of `ei`, as Klipper has it


class AxisMode(NamedTuple):
    """First mode of one axis.

    Attributes:
        axis: Name of the axis in the machine.
        letter: "X" or "Y", the name of the axis in the firmware.
        frequency: Natural frequency, Hz.
        damping: Damping ratio, dimensionless.
        frequency_std: Standard deviation of the frequency, Hz; None if the machine was not identified.
        damping_std: Standard deviation of the damping ratio; None if the machine was not identified.
    """

    axis: str
    letter: str
    frequency: float
    damping: float
    frequency_std: float | None
    damping_std: float | None

    @property
    def described(self) -> str:
        """One line such as "x: 41.20 Hz, damping ratio 0.0510", each with its standard deviation if known."""
        parts = f"{self.frequency:.2f} Hz", f"damping ratio {self.damping:.4f}"
        stds = self.frequency_std, self.damping_std
        return f"{self.axis}: " + ", ".join(
            part + (f" (standard deviation {std:.2g})" if std is not None else "")
            for part, std in zip(parts, stds, strict=True)
        )


def impulses(shaper: Shaper, frequency: float, damping: float) -> tuple[Array, Array]:
    """Compute the impulses of a shaper.

    Args:
        shaper: "zv", "mzv" or "ei".
        frequency: Natural frequency of the mode, Hz.
        damping: Damping ratio of the mode, dimensionless, below 1.

    Returns:
        times: Times of the impulses, s, shape (impulses,).
        amplitudes: Fractions of the move, with the sum 1, shape (impulses,).
    """
    root = math.sqrt(1.0 - damping * damping)
    period, K = 1.0 / (frequency * root), math.exp(-damping * math.pi / root)
    if shaper == "zv":
        times, sizes = [0.0, 0.5], [1.0, K]
    elif shaper == "mzv":
        k, a = K**0.75, 1.0 - math.sqrt(0.5)
        times, sizes = [0.0, 0.375, 0.75], [a, (math.sqrt(2.0) - 1.0) * k, a * k * k]
    else:
        V = _TOLERATED_VIBRATION
        times, sizes = [0.0, 0.5, 1.0], [1.0 + V, 2.0 * (1.0 - V) * K, (1.0 + V) * K * K]
    return period * np.array(times), np.array(sizes) / np.sum(sizes)


@dataclass(frozen=True, kw_only=True)
class InputShaperExporter(MachineExporter):
    """Base class of the exporters for printer firmware."""

    at: list[str] | None = option(None, "Tool position of the modes, as AXIS=POSITION; repeat for more axes.")

    def notes(self, machine: Machine) -> list[str]:
        """Return lines for a comment: the purpose of the settings, and whether measurements support them."""
        notes = [
            "For the first mode of the carriage along each axis, with the motors held at their "
            "commanded positions as the",
            f"firmware holds them; tool at {', '.join(self.at or []) or 'the center'}. Higher "
            "modes and dry friction are not covered.",
            "Belts change their stiffness with the position: compare the corners of the workspace (--at).",
        ]
        if machine.uncertainty is None:
            notes += [
                "NOT MEASURED: frequencies and damping follow from the values of the machine file, which "
                "hframe identify did",
                "not determine. Identify the machine before a printer uses these settings.",
            ]
        return notes

    def axis_modes(self, machine: Machine) -> list[AxisMode]:
        """Compute the lowest mode of the carriage along each axis, with held motors, at the position `at`.

        Raises:
            InputError: If the carriage does not vibrate along an axis.
        """
        axes = machine.tool_axes

        def quantities(variant: Machine) -> Array:
            found = axis_modes(variant, operating_point(variant, self.at))
            return np.array(
                [(found[a].frequency, found[a].damping) if a in found else (np.nan, np.nan) for a in axes]
            )

        values = quantities(machine)
        if not axes or np.isnan(values).any():
            rigid = [a for a, row in zip(axes, values, strict=True) if np.isnan(row).any()]
            raise InputError(
                f"machine {machine.name!r}: along {' and '.join(rigid) or 'no axis'} the carriage has no "
                "vibration against held motors (no belt or other spring between them, or overdamped), so "
                "there is nothing to shape"
            )
        stds = standard_deviations(machine, quantities)
        letters = [a.upper() if a in ("x", "y") else "XY"[i] for i, a in enumerate(axes)]
        return [
            AxisMode(axis, letter, *map(float, value), *((None, None) if std is None else map(float, std)))  # type: ignore[misc]
            for axis, letter, value, std in zip(
                axes, letters, values, [None] * len(axes) if stds is None else list(stds), strict=True
            )
        ]


def impulse_table(found: list[AxisMode]) -> str:
    """Write the impulses of all shapers for the first modes of all axes as CSV, one line per impulse.

    The columns are axis ("x" or "y"), shaper, time_s and amplitude (fraction of the move).
    """
    lines = ["axis,shaper,time_s,amplitude"]
    for mode in found:
        for shaper in SHAPERS:
            for time, size in zip(*impulses(shaper, mode.frequency, mode.damping), strict=True):
                lines.append(f"{mode.letter.lower()},{shaper},{float(time)!r},{float(size)!r}")
    return "\n".join(lines) + "\n"
