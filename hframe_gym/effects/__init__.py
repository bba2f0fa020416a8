"""The library of effects that a declared machine may lack: one file each, found by being here."""

from __future__ import annotations

import importlib
import pkgutil

from ..machine.effect import Effect
from ..machine.machine import Machine
from . import smooth_table


def _library() -> dict[str, Effect]:
    modules = sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name != "smooth_table")
    return {e.name: e for e in (importlib.import_module(f"{__name__}.{m}").EFFECT for m in modules)}


EFFECTS: dict[str, Effect] = _library()


def get_effect(name: str) -> Effect:
    """The definition of a name: of the library, or a table's.

    Raises KeyError for an unknown one.
    """
    return EFFECTS[name] if name in EFFECTS else smooth_table.definition(name)


def effect_sites(effect: Effect, machine: Machine) -> tuple[str, ...]:
    """Where on a machine an effect can sit."""
    if effect.fits and not effect.fits(machine):
        return ()
    drives = tuple(d.name for d in machine.drives)
    sensors = tuple(s.channel for s in machine.sensors)
    if effect.name == "sensor_skew":
        sensors = tuple(s.channel for s in machine.sensors if machine.coordinate(s.coordinate).kind == "linear")
    return {
        # Pulleys that share their numbers have no effect of their own.
        "coordinate": tuple(c for c in machine.coordinate_names if f"{c}.mass" not in machine.ties),
        "motor": drives,
        "drive": drives,
        "drives": ("drives",),
        "belts": ("belts",) if machine.belts else (),
        "sensor": sensors,
        "machine": ("machine",),
    }[effect.site]


__all__ = [
    "EFFECTS",
    "effect_sites",
    "get_effect",
]
