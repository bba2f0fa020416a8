"""Values of a machine that are possible but probably mistakes, such as a length in millimeters."""

from __future__ import annotations

import numpy as np

from ...machine import Machine, pulley_names, rigid_motions
from .schema import COMPONENTS

_OTHER_UNITS = ("_mm", "_um", "_cm", "_deg", "_counts")


def implausible_values(machine: Machine) -> list[tuple[str, str]]:
    """List values of a machine that are possible but probably mistakes, so that the user is warned of them.

    - Lengths so large that they were probably entered in millimeters, such as a pulley radius of more than
      1 m.
    - Factors in `Belt.extension` (extension of the belt per radius * angle of a pulley) that are no multiple
      of 1/2.
    - Belts that would have a length of zero or less at an end of the coordinates' ranges.
    - Carriages (linear coordinates) that cannot move without stretching a belt.
    - The coordinate y listed before x.
    - Sensors whose names end in another unit than m or rad, such as x_mm.

    Returns:
        For each doubtful value: name of the field with dots, such as "belts.left.rest_length", and a sentence
        that says what is doubtful and what to do.
    """
    doubts = [*_large_lengths(machine), *_doubtful_belts(machine)]
    if machine.tool_axes == ("y", "x"):
        doubts.append(("coordinates", "y comes before x, so it is the first axis of the tool: list x first"))
    for sensor in machine.sensors:
        ending = next((ending for ending in _OTHER_UNITS if sensor.channel.endswith(ending)), None)
        unit = machine.unit(f"{sensor.channel}.noise")
        if ending is not None and sensor.of_position:
            advice = f"call the column {sensor.channel.removesuffix(ending)}_{unit} and convert its values"
            doubts.append(
                (f"sensors.{sensor.channel}", f"measurements are in {unit}, not in {ending[1:]}: {advice}")
            )
    return doubts


def _large_lengths(machine: Machine) -> list[tuple[str, str]]:
    """List lengths that are probably in millimeters."""
    doubts = []
    for section, component in ((s, c) for s in COMPONENTS for c in getattr(machine, s)):
        variant = machine.variant(component)
        for name, quantity in component.numbers().items():
            value = getattr(component, name)
            if value is None or name in variant.absent or variant.unit(name, quantity) != "m":
                continue
            size = float(np.max(np.abs(value)))
            if size > quantity.plausible:
                reason = f"{size:g} m: is it in millimeters? All lengths are in m"
                doubts.append((f"{section}.{component.label}.{name}", reason))
    return doubts


def _doubtful_belts(machine: Machine) -> list[tuple[str, str]]:
    """List factors of belts that are not plausible, carriages that cannot move, and negative lengths."""
    doubts = []
    moving = np.any([*rigid_motions(machine).values(), np.zeros(len(machine.coordinates))], axis=0)
    for belt in machine.belts:
        for name, factor in belt.extension.items():
            if name in pulley_names(machine) and not float(2 * factor).is_integer():
                reason = (
                    "is not a small integer; it multiplies the belt travel, which is radius * angle already"
                )
                doubts.append(
                    (f"belts.{belt.name}.extension.{name}", f"{factor:g} {reason}: usually it is 1 or -1")
                )
        ranges = {c.name: c.range for c in machine.coordinates if c.range is not None and c.kind == "linear"}
        changes = [min(f * end for end in ranges[name]) for name, f in belt.length.items() if name in ranges]
        shortest = belt.rest_length + sum(changes)
        if shortest <= 0:
            reason = f"the section would be {shortest:.3g} m long at an end of the coordinates' ranges"
            doubts.append(
                (f"belts.{belt.name}.rest_length", f"{reason}: correct rest_length, length or the ranges")
            )
    for index, c in enumerate(machine.coordinates):
        if c.kind == "linear" and not moving[index] and c.name not in machine.spring_loaded:
            reason = "cannot move without stretching a belt: check the signs of the factors in `extension`"
            doubts.append((f"coordinates.{c.name}", reason))
    return doubts
