"""URDF of a stage for visualization and motion planning."""

from __future__ import annotations

from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
from typing_extensions import override

from ..errors import InputError
from ..machine import Coordinate, Machine, motion_limits, rigid_motions
from .base import EXPORTERS, Files, MachineExporter, axis_range, indented, xml_comment
from .models.mujoco_model import carrier_and_riders, tool_coordinates

_UNLIMITED_SPEED = 10.0  # m/s, for machines without friction and back-EMF, whose speed has no limit


@EXPORTERS.register("urdf")
@dataclass(frozen=True, kw_only=True)
class UrdfExporter(MachineExporter):
    """Write a URDF with one prismatic joint per axis of the tool, its masses and its limits.

    The limits are those of the workspace, the steady speed at rated voltage, and the force of all drives at
    standstill. URDF has no belts: motors and pulleys are not in it, and their inertia is not in the masses.

    Example:  hframe export urdf --machine corexy --out stage.urdf
    """

    @override
    def files(self, machine: Machine) -> Files:
        """Write stage.urdf.

        Raises:
            InputError: If the machine has other coordinates than tool axes and pulleys, or an axis has no
                range.
        """
        axes = tool_coordinates(machine)
        unlimited = [c.name for c in axes if c.range is None]
        if unlimited:
            raise InputError(
                f"machine {machine.name!r}: a prismatic joint of URDF has limits, "
                f"but {', '.join(unlimited)} has no range; add it to machine.json"
            )
        directions = {c.name: d for c, d in zip(axes, ("1 0 0", "0 1 0"), strict=False)}
        carrier, riders, carried = carrier_and_riders(axes)
        half = 0.5 * float(np.ptp(axis_range(riders[0] if riders else carrier))) + 0.05
        beam = (0.04, 2 * half, 0.03) if carrier is axes[0] else (2 * half, 0.04, 0.03)
        tool = (0.06, 0.06, 0.05)
        links = ['<link name="base"/>', _link(carrier, carrier.mass - carried, beam if riders else tool)]
        joints = [_joint(machine, carrier, "base", directions[carrier.name])]
        for rider in riders:
            links.append(_link(rider, carried, tool))
            joints.append(_joint(machine, rider, f"{carrier.name}_link", directions[rider.name]))
        text = f"<robot name={quoteattr(machine.name)}>{''.join(links)}{''.join(joints)}</robot>"
        pretty = indented(text)
        header = self.header(machine, "Units: SI. Motors, pulleys and belts are not in this model.")
        return {"stage.urdf": xml_comment(header) + pretty}


def _link(c: Coordinate, mass: float, size: tuple[float, float, float]) -> str:
    """Return a link that is a homogeneous box."""
    a, b, h = size
    moments = (mass / 12.0 * (b * b + h * h), mass / 12.0 * (a * a + h * h), mass / 12.0 * (a * a + b * b))
    tensor = " ".join(f'i{k}="{m!r}"' for k, m in zip(("xx", "yy", "zz"), moments, strict=True))
    box = f'<geometry><box size="{a!r} {b!r} {h!r}"/></geometry>'
    return (
        f'<link name={quoteattr(c.name + "_link")}><inertial><mass value="{mass!r}"/>'
        f'<inertia {tensor} ixy="0" ixz="0" iyz="0"/></inertial><visual>{box}</visual></link>'
    )


def _joint(machine: Machine, c: Coordinate, parent: str, direction: str) -> str:
    """Return the prismatic joint of an axis."""
    limits = motion_limits(machine).get(c.name)
    low, high = c.range or (0.0, 0.0)
    motion = (
        dict(zip(machine.coordinate_names, rigid_motions(machine)[c.name], strict=True)) if limits else {}
    )
    force = float(sum(d.gain * d.rated_voltage * abs(motion.get(d.coordinate, 0.0)) for d in machine.drives))
    speed = limits.speed if limits and np.isfinite(limits.speed) else _UNLIMITED_SPEED
    return (
        f'<joint name={quoteattr(c.name)} type="prismatic"><parent link={quoteattr(parent)}/>'
        f'<child link={quoteattr(c.name + "_link")}/><axis xyz="{direction}"/>'
        f'<limit lower="{low!r}" upper="{high!r}" effort="{force!r}" velocity="{speed!r}"/>'
        f'<dynamics damping="{c.viscous!r}" friction="{c.coulomb!r}"/></joint>'
    )
