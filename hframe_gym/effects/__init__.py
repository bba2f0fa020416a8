"""The library of effects that a declared machine may lack: one file each, found by being here."""

from __future__ import annotations

import importlib
import pkgutil

from ..machine.effect import Effect
from ..machine.tables import Machine


def _library() -> dict[str, Effect]:
    modules = sorted(m.name for m in pkgutil.iter_modules(__path__))
    return {e.name: e for e in (importlib.import_module(f"{__name__}.{m}").EFFECT for m in modules)}


LIBRARY: dict[str, Effect] = _library()


def sites(effect: Effect, machine: Machine) -> tuple[str, ...]:
    """Where on a machine an effect can sit."""
    return {
        "coordinate": machine.coordinate_names,
        "drive": tuple(d.name for d in machine.drives),
        "drives": ("drives",),
    }[effect.site]


__all__ = ["LIBRARY", "sites"]
