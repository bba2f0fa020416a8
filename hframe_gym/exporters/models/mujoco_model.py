"""A stage as a MuJoCo model: joints with diagonal inertia, tendons as belts, motors with force per volt.

The lighter axis rides on the heavier one. Each pulley is a body of its coordinate's inertia, and each belt a
fixed tendon (a linear combination of joints) of constant stiffness, that at the operating point. Coulomb
friction is `frictionloss`, a soft constraint in MuJoCo; joint damping includes the back-EMF of the motors, so
that controls are voltages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from ...arrays import Array
from ...dynamics import belt_states
from ...errors import InputError
from ...machine import Coordinate, Machine
from ..base import axis_range, refuse_drive_laws, require_linear_axes

# MuJoCo's friction is a soft constraint: it brings a velocity to zero within the time constant of
# `solreffriction` (20 ms by default) and creeps according to the impedance of `solimpfriction`. `default`
# uses these defaults. `stiff` is as close to dry friction as MuJoCo allows: the smallest permitted time
# constant, two steps, and an impedance near one.
FRICTION = {"default": "", "stiff": 'solreffriction="{twice} 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"'}
_PULLEY_MASS = 0.1  # kg; only the inertia of a pulley acts, because it does not travel
# Fraction of the heavier axis' mass that a carriage on it may weigh; the rest of its mass is armature.
_LARGEST_FRACTION = 0.5


class MujocoSettings(NamedTuple):
    """Settings of MuJoCo: integrator, constraint solver and softness of friction (a key of `FRICTION`)."""

    integrator: str = "Euler"
    solver: str = "PGS"
    friction: str = "stiff"

    def __str__(self) -> str:
        return f"{self.integrator}, {self.solver}, {self.friction} friction"


def model_xml(
    machine: Machine,
    step: float,
    settings: MujocoSettings,
    position: Array | None = None,
    *,
    drawn: bool = False,
) -> str:
    """Write a stage as a model of MuJoCo, in XML.

    Contacts, gravity and limits, which have no part in the equations of motion of a stage, are switched off.

    Args:
        machine: Machine with one or two tool axes and any pulleys; its effects are ignored.
        step: Integration step, s.
        position: Position of every coordinate at which the belts have their stiffness, m or rad,
            shape (coordinates,). None: all zero.
        drawn: Whether the model has names, geometries, ranges of the joints and sensors; without them it is
            as fast as possible.

    Raises:
        InputError: If the machine has other coordinates than tool axes and pulleys, or drives that follow a
            set point.
    """
    refuse_drive_laws(machine, "a model of bodies")
    axes = tool_coordinates(machine)
    shapes = _shapes(machine, axes) if drawn else {}
    joint = partial(_joint, machine, soft=FRICTION[settings.friction].format(twice=2 * step), drawn=drawn)
    bodies = _tool_bodies(axes, shapes, joint, drawn=drawn)
    bodies += _pulley_bodies(machine, shapes, joint, drawn=drawn)
    sensors = f"\n  <sensor>{elements}</sensor>" if drawn and (elements := _sensors(machine)) else ""
    off = 'contact="disable" gravity="disable" limit="disable"' + ("" if drawn else ' sensor="disable"')
    option = (
        f'timestep="{step!r}" integrator="{settings.integrator}" solver="{settings.solver}" gravity="0 0 0"'
    )
    return f"""<mujoco{f" model={quoteattr(machine.name)}" if drawn else ""}>
  <option {option}/>
  <option><flag {off}/></option>
  <worldbody>{bodies}</worldbody>
  <tendon>{_tendons(machine, position)}</tendon>
  <actuator>{_motors(machine, drawn=drawn)}</actuator>{sensors}
</mujoco>"""


def _joint(
    machine: Machine, c: Coordinate, kind: str, axis: str, armature: float = 0.0, *, soft: str, drawn: bool
) -> str:
    """Return the joint of a coordinate; `soft` are the attributes that make dry friction stiff."""
    damping = c.viscous + sum(d.back_emf for d in machine.drives if d.coordinate == c.name)
    losses = f'damping="{damping!r}" frictionloss="{c.coulomb!r}" {soft if c.coulomb else ""}'
    added = f' armature="{armature!r}"' if armature else ""
    limits = f' range="{c.range[0]!r} {c.range[1]!r}"' if drawn and c.range and kind == "slide" else ""
    return f'<joint name={quoteattr(c.name)} type="{kind}" axis="{axis}" {losses}{added}{limits}/>'


def _inertia(mass: float, moment: float) -> str:
    """Return the inertia of a body, kg and kg m^2."""
    return f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="{moment!r} {moment!r} {moment!r}"/>'


def _tool_bodies(
    axes: list[Coordinate], shapes: Mapping[str, str], joint: Callable[..., str], *, drawn: bool
) -> str:
    """Return the body of the axis that carries the other, nested in it, as MuJoCo orders joints by bodies."""
    directions = {c.name: direction for c, direction in zip(axes, ("1 0 0", "0 1 0"), strict=False)}
    carrier, riders, carried = carrier_and_riders(axes)
    inner = ""
    if riders:  # the carriage moves with the bridge, so that mass(bridge) is that of both
        rider = riders[0]
        slide = joint(rider, "slide", directions[rider.name], rider.mass - carried)
        inner = (
            f"<body{_named(rider, drawn)}>{_inertia(carried, 1.0)}{slide}{shapes.get(rider.name, '')}</body>"
        )
    return (
        f"<body{_named(carrier, drawn)}>{_inertia(carrier.mass - carried, 1.0)}"
        f"{joint(carrier, 'slide', directions[carrier.name])}{shapes.get(carrier.name, '')}{inner}</body>"
    )


def _pulley_bodies(
    machine: Machine, shapes: Mapping[str, str], joint: Callable[..., str], *, drawn: bool
) -> str:
    """Return a body for each pulley, which turns and does not travel."""
    return "".join(
        f"<body{_named(c, drawn)}{_place(i, drawn)}>"
        f"{_inertia(_PULLEY_MASS, c.mass)}{joint(c, 'hinge', '0 0 1')}{shapes.get(c.name, '')}</body>"
        for i, c in enumerate(c for c in machine.coordinates if c.kind == "rotary")
    )


def _tendons(machine: Machine, position: Array | None) -> str:
    """Return a tendon for each belt."""
    tendons = ""
    for b, k in zip(machine.belts, belt_stiffness(machine, position), strict=True):
        row = machine.coefficients(b.extension) * machine.travel_per_unit
        ends = "".join(
            f'<joint joint={quoteattr(n)} coef="{c!r}"/>'
            for n, c in zip(machine.coordinate_names, row.tolist(), strict=True)
            if c
        )
        tendons += f'<fixed name={quoteattr(b.name)} stiffness="{k!r}" springlength="0">{ends}</fixed>'
    return tendons


def _motors(machine: Machine, *, drawn: bool) -> str:
    """Return a motor for each drive, whose control is the voltage."""
    motors = ""
    for d in machine.drives:
        rated = d.rated_voltage
        limits = f' name={quoteattr(d.channel)} ctrlrange="{-rated!r} {rated!r}"' if drawn else ""
        motors += f'<motor{limits} joint={quoteattr(d.coordinate)} gear="{d.gain!r}"/>'
    return motors


def _sensors(machine: Machine) -> str:
    """Return the sensors that measure the position of one coordinate."""
    return "".join(
        f"<jointpos name={quoteattr(s.channel)} joint={quoteattr(s.coordinate)}/>"
        for s in machine.sensors
        if s.of_position and dict(s.row) == {s.coordinate: 1.0}
    )


def tool_coordinates(machine: Machine) -> list[Coordinate]:
    """Return the coordinates of the tool axes; InputError if the machine has more than tool and pulleys."""
    require_linear_axes(machine, "a model of bodies")
    axes = [machine.coordinate(name) for name in machine.tool_axes]
    others = [c.name for c in machine.coordinates if c.kind == "linear" and c.name not in machine.tool_axes]
    others += machine.spring_loaded
    if not axes or others:
        reason = f"it also has {', '.join(others)}" if axes else "it has no tool axes"
        raise InputError(
            f"machine {machine.name!r}: only a tool with one or two axes "
            f"and pulleys has a model of bodies; {reason}"
        )
    return axes


def carrier_and_riders(axes: list[Coordinate]) -> tuple[Coordinate, list[Coordinate], float]:
    """Decide which axis carries the other: the heavier one, whose mass includes that of the carriage on it.

    Returns:
        carrier: The heavier axis.
        riders: The other axis, or none.
        carried: Mass of the body on the carrier, kg: the lighter mass, but at most half of the heavier one,
            so that a carrier of the same mass is left with a mass.
    """
    carrier, *riders = sorted(axes, key=lambda c: -c.mass)
    return carrier, riders, min(riders[0].mass, _LARGEST_FRACTION * carrier.mass) if riders else 0.0


def belt_stiffness(machine: Machine, position: Array | None) -> list[float]:
    """Compute the stiffness of each belt, N/m, at `position`, m or rad, shape (coordinates,), or at 0.

    Effects are ignored.
    """
    if position is None:
        return [b.EA / b.rest_length for b in machine.belts]
    nominal = machine.replace(effects=())
    return [float(belt.stiffness) for belt in belt_states(nominal, position)] if machine.belts else []


def _named(c: Coordinate, drawn: bool) -> str:
    """Return the attribute with the name of a body."""
    return f" name={quoteattr(c.name + '_body')}" if drawn else ""


def _place(i: int, drawn: bool) -> str:
    """Return the attribute with the place of pulley i: in a row beside the stage."""
    return f' pos="{-0.45:g} {0.08 * i:g} 0"' if drawn else ""


def _shapes(machine: Machine, axes: list[Coordinate]) -> dict[str, str]:
    """Return geometries of bodies without mass: beams for carriers, a box for the tool, disks for pulleys."""
    heavier, lighter = max(axes, key=lambda c: c.mass), min(axes, key=lambda c: c.mass)
    half = 0.5 * float(np.ptp(axis_range(lighter))) + 0.05
    across = f"0.02 {half:g} 0.015" if heavier is axes[0] else f"{half:g} 0.02 0.015"
    plain = 'contype="0" conaffinity="0" mass="0"'
    shapes = {c.name: f'<geom type="box" size="0.03 0.03 0.025" rgba="0.8 0.3 0.2 1" {plain}/>' for c in axes}
    if len(axes) > 1:
        shapes[heavier.name] = f'<geom type="box" size="{across}" rgba="0.5 0.5 0.6 1" {plain}/>'
    for c in machine.coordinates:
        if c.kind == "rotary":
            shapes[c.name] = f'<geom type="cylinder" size="{c.radius:g} 0.01" rgba="0.3 0.3 0.3 1" {plain}/>'
    return shapes
