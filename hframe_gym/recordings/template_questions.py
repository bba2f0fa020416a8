"""The answers that a template has to the questions for a new machine."""

from __future__ import annotations

import math

from ..machine import Machine

_AXIS_PULLEY = 0.02  # m; with it and no gear, the template `axis` has its 50 rad/m


def template_value(template: Machine, option: str) -> str | float | int:
    """Return the value that a template has for an option of `hframe machines new`: the default answer to its question.

    Args:
        template: Machine that `new_machine` made from the template without options.
        option: Name of the option, for example "pulley_radius".

    Returns:
        Value, SI; for `travel` and `mass` a text with one value per axis, separated by commas.
    """
    drive = template.drives[0]
    moved = template.coordinate(drive.coordinate)
    is_pulley = moved.kind == "rotary" and moved.name not in template.tool_axes
    axes = [template.coordinate(name) for name in template.tool_axes]
    if option == "travel":
        return ",".join(f"{c.range[1] - c.range[0]:g}" if c.range else "1" for c in axes)
    if option == "mass":
        return ",".join(f"{c.mass:g}" for c in axes)
    if option == "encoder_lines":
        quanta = [s.resolution for s in template.sensors if s.kind == "encoder"]
        return round(2 * math.pi / (4 * quanta[0] * drive.gear_ratio)) if quanta else 0
    values = {
        "pulley_radius": moved.radius if is_pulley else _AXIS_PULLEY,
        "gear_ratio": drive.gear_ratio if moved.kind == "rotary" else 1.0,
        "rotor_inertia": moved.mass / drive.gear_ratio**2 if is_pulley else 0.0,
    }
    value = values[option] if option in values else getattr(drive, option)
    return float(f"{value:.4g}")
