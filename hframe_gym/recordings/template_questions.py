"""What is asked for a new machine: questions with their options, and the answers that a template has."""

from __future__ import annotations

import math

from ..machine import Machine
from .machine_template import TEMPLATES

# Option, question, and the templates to which it applies.
TEMPLATE_QUESTIONS = (
    ("travel", "Travel along x and y, m", ("hframe", "corexy")),
    ("travel", "Travel, m", ("axis", "belt-axis")),
    ("mass", "Moving mass along x and y, kg", ("hframe", "corexy")),
    ("mass", "Moving mass without the motor, kg", ("axis", "belt-axis")),
    ("pulley_radius", "Pitch radius of the motors' pulleys, m", TEMPLATES),
    ("gear_ratio", "Turns of the motor per turn of the pulley", TEMPLATES),
    ("rotor_inertia", "Moment of inertia of a motor's rotor, kg m^2", TEMPLATES),
    ("Kt", "Torque constant of the motors, Nm/A", TEMPLATES),
    ("resistance", "Resistance of a motor, ohm", TEMPLATES),
    ("rated_voltage", "Rated voltage, V", TEMPLATES),
    ("encoder_lines", "Lines of the encoders on the motors (0: none)", TEMPLATES),
)
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
    axes = [c for c in template.coordinates if c.kind == "linear"]
    if option == "travel":
        return ",".join(f"{c.range[1] - c.range[0]:g}" if c.range else "1" for c in axes)
    if option == "mass":
        return ",".join(f"{c.mass:g}" for c in axes)
    if option == "encoder_lines":
        quanta = [s.resolution for s in template.sensors if s.kind == "encoder"]
        return round(2 * math.pi / (4 * quanta[0] * drive.gear_ratio)) if quanta else 0
    values = {
        "pulley_radius": moved.radius if moved.kind == "rotary" else _AXIS_PULLEY,
        "gear_ratio": drive.gear_ratio if moved.kind == "rotary" else 1.0,
        "rotor_inertia": moved.mass / drive.gear_ratio**2 if moved.kind == "rotary" else 0.0,
    }
    value = values[option] if option in values else getattr(drive, option)
    return float(f"{value:.4g}")
