"""A new machine: a built-in one with other values."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping

from ...errors import InputError, suggestion
from ...machine import BUILTIN_MACHINES, Machine
from .drives import (
    reaching_workspace,
    shaft_inertias,
    with_command,
    with_motor_values,
    with_stepper_damping,
)
from .options import MachineOptions
from .questions import check_options
from .sensors import further_sensor, sensors_of
from .texts import TEMPLATES


def new_machine(like: str, name: str, options: MachineOptions) -> Machine:
    """Create a machine from a template, with the user's values in place of some of the template's.

    The lengths of the belts are adapted to the travel, and the resolution of the encoders to their lines and
    the gear ratio.

    Args:
        like: Name of the template, a key of `TEMPLATES`.
        name: Name of the new machine.
        options: Values of the new machine, each None where the template's value is kept.

    Raises:
        InputError: If the template or a parameter in `options.values` is unknown, an option is not positive
            or does not fit the template, or the machine would have no sensor.
    """
    if like not in TEMPLATES:
        raise InputError(f"--like {like}: choose one of {', '.join(TEMPLATES)}{suggestion(like, TEMPLATES)}")
    machine = BUILTIN_MACHINES[like]().replace(
        name=name, description=f"A machine like {like}; see docs/machine.md."
    )
    check_options(like, machine, options)
    machine = _with_travel(machine, TEMPLATES[like].lengths, options)
    machine = machine.replace(drives=tuple(with_motor_values(machine, d, options) for d in machine.drives))
    machine = _with_masses(machine, options)
    gear_ratios = {d.coordinate: d.gear_ratio for d in BUILTIN_MACHINES[like]().drives}
    machine = machine.replace(sensors=sensors_of(machine, gear_ratios, options))
    inertias = shaft_inertias(machine)
    machine = machine.replace(
        drives=tuple(
            with_command(machine, drive, options.drive, inertia)
            for drive, inertia in zip(machine.drives, inertias, strict=True)
        )
    )
    machine = with_stepper_damping(machine, inertias)
    machine = machine.replace(drives=tuple(reaching_workspace(machine, d) for d in machine.drives))
    for text in options.sensor:
        machine = machine.replace(sensors=(*machine.sensors, further_sensor(machine, text)))
    if not machine.sensors:
        raise InputError(
            "no sensor is left: give the lines of encoders (--encoder-lines), or keep the linear sensor"
        )
    return _with_values(machine, options.values)


def _with_travel(
    machine: Machine, lengths: Mapping[str, tuple[float, float]], options: MachineOptions
) -> Machine:
    """Return a machine with other ranges, and belts that are longer or shorter accordingly."""
    if options.travel is None:
        return machine
    travel = dict(zip(("x", "y"), options.travel, strict=False))
    change = dict.fromkeys(("x", "y"), 0.0)  # m
    coordinates = list(machine.coordinates)
    for index, c in enumerate(coordinates):
        if c.name in travel:
            change[c.name] = travel[c.name] - (c.range[1] - c.range[0] if c.range else 0.0)
            coordinates[index] = dataclasses.replace(c, range=(-travel[c.name] / 2, travel[c.name] / 2))
    belts = []
    for b in machine.belts:
        per_x, per_y = lengths[b.name]
        length = b.rest_length + per_x * change["x"] + per_y * change["y"]
        belts.append(dataclasses.replace(b, rest_length=round(length, 6)))
    return machine.replace(coordinates=tuple(coordinates), belts=tuple(belts))


def _with_masses(machine: Machine, options: MachineOptions) -> Machine:
    """Return a machine with other masses, pulleys and rotors."""
    mass = dict(zip(machine.tool_axes, options.mass or (), strict=False))
    coordinates = []
    for c in machine.coordinates:
        new: dict[str, float] = {"mass": mass[c.name]} if c.name in mass else {}
        is_pulley = c.kind == "rotary" and c.name not in machine.tool_axes
        if is_pulley and options.pulley_radius is not None:
            new["radius"] = options.pulley_radius
        drives = [d for d in machine.drives if d.coordinate == c.name]
        if drives and options.rotor_inertia is not None:
            reflected = drives[0].gear_ratio ** 2 * options.rotor_inertia
            new["mass"] = reflected if is_pulley else mass.get(c.name, c.mass) + reflected
        coordinates.append(dataclasses.replace(c, **new))  # type: ignore[arg-type]
    return machine.replace(coordinates=tuple(coordinates))


def _with_values(machine: Machine, values: Mapping[str, float]) -> Machine:
    """Return a machine with other parameter values."""
    names = machine.parameters | machine.device_parameters
    unknown = [name for name in values if name not in names]
    if unknown and unknown[0] in machine.ties:
        raise InputError(
            f"--set {unknown[0]}: it is tied to {machine.ties[unknown[0]][0]}; set that parameter"
        )
    if unknown:
        similar = difflib.get_close_matches(unknown[0], names, 3) or sorted(names)
        raise InputError(f"--set {unknown[0]}: there is no such parameter; there are {', '.join(similar)}")
    return machine.replace(values)
