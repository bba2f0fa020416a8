"""Preset machines by name; `hframe_gym.effects` adds the pendulum, whose weight is a library effect."""

from __future__ import annotations

from collections.abc import Callable

from ..machine import Machine
from .motors import motor, servo, wheel
from .paper_rig import (
    SECTIONS,
    STIFFNESS,
    hframe,
    hframe_linear,
    hframe_literal,
    hframe_order20,
    with_constant_stiffness,
)
from .stages import axis, belt_axis, corexy, printer, xy_table

__all__ = ["BUILTIN_MACHINES", "SECTIONS", "STIFFNESS", "with_constant_stiffness"]

BUILTIN_MACHINES: dict[str, Callable[[], Machine]] = {
    "hframe": hframe,
    "hframe-linear": hframe_linear,
    "hframe-literal": hframe_literal,
    "hframe-order20": hframe_order20,
    "axis": axis,
    "belt-axis": belt_axis,
    "xy-table": xy_table,
    "corexy": corexy,
    "printer": printer,
    "motor": motor,
    "wheel": wheel,
    "servo": servo,
}
