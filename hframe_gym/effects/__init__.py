"""The library of effects that a declared machine may lack: one file per effect, found by its place here.

A program or a plugin (see `hframe_gym.registry`) can add effects with `register_effect`; they then work in
machine.json, in environments and in identification like those of the library.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from types import MappingProxyType

from ..errors import suggestion
from ..machine import BUILTIN_MACHINES, Effect, Machine
from ..registry import load_plugins
from . import smooth_table
from .machines import pendulum

BUILTIN_MACHINES["pendulum"] = pendulum
_NO_EFFECTS = ("smooth_table", "machines")  # modules of this folder without an EFFECT


def _library() -> dict[str, Effect]:
    """Return the effect of every module in this folder by name; tables have no fixed name."""
    modules = sorted(
        m.name for m in pkgutil.iter_modules(__path__) if not m.ispkg and m.name not in _NO_EFFECTS
    )
    return {e.name: e for e in (importlib.import_module(f"{__name__}.{m}").EFFECT for m in modules)}


class _Effects(dict[str, Effect]):
    """Definitions by name; the error of an unknown name says which one is meant."""

    def __missing__(self, name: str) -> Effect:
        raise KeyError(f"effect {name!r} is unknown{suggestion(name, self)}")


_REGISTERED = _Effects(_library())

#: Definitions by name: the library, and what `register_effect` added.
EFFECTS: Mapping[str, Effect] = MappingProxyType(_REGISTERED)


def register_effect(effect: Effect) -> Effect:
    """Add an effect to the library `EFFECTS`, and return it; ValueError if its name is in use."""
    if _REGISTERED.get(effect.name, effect) is not effect:
        raise ValueError(f"effect {effect.name!r} is registered already")
    _REGISTERED[effect.name] = effect
    return effect


def unregister_effect(name: str) -> None:
    """Remove an effect from `EFFECTS` in this process, for example at the end of a test.

    KeyError if it is missing.
    """
    del _REGISTERED[name]


def get_effect(name: str) -> Effect:
    """Return the definition of an effect by its name; plugins are loaded if the name is not registered yet.

    Args:
        name: A name in `EFFECTS`, or that of a tabulated effect such as "smooth_force[position of y]".

    Raises:
        KeyError: If neither the library, nor a plugin, nor the tabulated effects have the name.
    """
    if name not in EFFECTS:
        load_plugins()
    return EFFECTS[name] if name in EFFECTS else smooth_table.definition(name)


def effect_sites(effect: Effect, machine: Machine) -> tuple[str, ...]:
    """Return the components of a machine (sites) at which an identification tries an effect.

    Returns:
        Names of coordinates, drives, belts or sensor channels, depending on the kind of the effect. The word
        "drives", "belts" or "machine" stands for all of them at once; it precedes the names. Empty if the
        effect cannot act on the machine.
    """
    if effect.fits and not effect.fits(machine):
        return ()
    drives = tuple(d.name for d in machine.drives)
    sites = {
        # Coordinates whose mass is tied to another parameter have the same parameters; no effect acts on one
        # alone.
        "coordinate": tuple(c for c in machine.coordinate_names if f"{c}.mass" not in machine.ties),
        "motor": drives,
        "drive": ("drives", *drives) if effect.shared and len(drives) > 1 else drives,
        "drives": ("drives", *drives) if len(drives) > 1 else ("drives",),
        "belts": effect.possible_sites(machine)[: None if len(machine.belts) > 1 else 1],
        "sensor": machine.output_channels,
        "machine": ("machine",),
    }[effect.site]
    fits_site = effect.fits_site
    return sites if fits_site is None else tuple(site for site in sites if fits_site(machine, site))


__all__ = ["EFFECTS", "effect_sites", "get_effect", "register_effect", "unregister_effect"]
