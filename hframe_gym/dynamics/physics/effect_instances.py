"""Effects of a machine and laws of its drives, listed once for each component on which they act.

An effect with the site "drives" acts on every drive, one at "belts" on every belt, and one at "machine" on
every coordinate, always with the same parameters. Each of these instances has a separate state, for example
the current of its motor.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...machine import AppliedEffect, Machine


@dataclass(frozen=True)
class EffectInstance:
    """An effect at one component; an effect on all belts, for example, has one instance for each belt.

    Attributes:
        effect: The effect of the machine.
        component: Name of the coordinate, drive, belt or sensor channel, or "machine" for a structural
            effect.
        coordinate: Index of the coordinate on which the effect acts; for an effect on a drive, index of the
            coordinate that the drive moves; -1 for effects on belts and sensors.
        state_coordinate: Index of the coordinate whose motion changes the state of the effect, if it has one:
            usually `coordinate`, but for a table over the path of another coordinate, that one. -1 for belts
            and sensors.
    """

    effect: AppliedEffect
    component: str
    coordinate: int
    state_coordinate: int


def effect_instances(machine: Machine) -> list[EffectInstance]:
    """List the effects of a machine, each once for every component on which it acts, such as each belt.

    Laws of drives come first, then the machine's effects in their order.
    """
    # An unknown name, such as that of a belt or sensor, gives the index -1: no coordinate.
    index = {name: i for i, name in enumerate(machine.coordinate_names)}
    instances = []
    for effect in (*machine.drive_laws, *machine.effects):
        for component in effect.components(machine):
            coordinate = index.get(_moved_coordinate(effect, component, machine), -1)
            # A tabulated effect over the path of a coordinate integrates that coordinate's path.
            path_of = effect.definition.against.partition(" of ")[2]
            instances.append(EffectInstance(effect, component, coordinate, index.get(path_of, coordinate)))
    return instances


def instances_with_state(machine: Machine) -> list[EffectInstance]:
    """List the effect instances that have an internal state, in the order of initial states."""
    return [instance for instance in effect_instances(machine) if instance.effect.definition.next_state]


def _moved_coordinate(effect: AppliedEffect, component: str, machine: Machine) -> str:
    """Return the name of the coordinate on which an effect acts at a component, empty for none."""
    definition = effect.definition
    if effect.coordinate:
        return effect.coordinate
    if definition.site in ("motor", "drive", "drives"):
        return machine.drive(effect.site if definition.belt else component).coordinate
    if definition.site == "machine":
        return component  # every coordinate, or the word "machine" of a structural effect
    if definition.site in ("sensor", "belts"):
        return ""
    return machine.coordinate_of_site(component, definition.site) or ""
