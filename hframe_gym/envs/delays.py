"""How long the delays of drives and sensors can be, which decides how much of the past a simulation keeps."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from ..machine import Machine


def longest_delay(
    machine: Machine, components: Iterable[str], hook: Literal["delay", "measurement_delay"]
) -> float:
    """Return the longest delay, s, that a component can have within the bounds of its effects; 0 without such effects.

    Args:
        machine: Machine with its effects.
        components: Names of drives or channels of sensors.
        hook: Formula of the effects: "delay" of drives, "measurement_delay" of sensors.
    """
    longest = 0.0
    for component in components:
        delays = 0.0
        for effect in machine.effects:
            formula = getattr(effect.definition, hook)
            if formula and component in effect.components(machine):
                delays += float(formula(*(p.upper for p in effect.definition.parameters)))
        longest = max(longest, delays)
    return longest
