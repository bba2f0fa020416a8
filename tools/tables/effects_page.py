"""docs/effects.md: the effects of the library, from their definitions."""

from __future__ import annotations

import html
import importlib
import inspect

from hframe_gym.effects import EFFECTS
from hframe_gym.machine import Effect
from tools.tables.result_tables import markdown

_EFFECTS_HEAD = """# Effect library

Generated from `hframe_gym/effects/` by `python -m tools.tables`. An effect is a physical phenomenon that the
basic model ([physics](physics.md)) lacks. It acts at a site of a machine: a coordinate, a drive and its
motor, the belts, a sensor, or the machine as a whole. `hframe identify` tries every effect at every site;
[Extending](extending.md#an-effect) shows how to add one.

Units in words depend on the site: a force is in N at x and in Nm at a motor. Bounds are in SI units. An
effect vanishes where its amplitude is zero.

"""


_EFFECTS_TAIL = """
## Tables

`smooth_force[VARIABLE]` and `smooth_friction[VARIABLE]` represent forces that no formula of the library
explains: piecewise linear functions, with two dozen knots, of a position, a velocity, the distance traveled,
or time.
"""


def effects_page() -> str:
    """Return docs/effects.md: the library as a table, then one section per effect."""
    rows = [[f"[`{e.name}`](#{e.name})", e.site, _code_cell(e.formula)] for e in EFFECTS.values()]
    table = markdown(["effect", "site", "formula"], rows, "---")
    return f"{_EFFECTS_HEAD}{table}\n{''.join(map(_section, EFFECTS.values()))}{_EFFECTS_TAIL}"


def _code_cell(text: str) -> str:
    """Return code for a cell of a table, in which the sign | would begin the next cell."""
    return (
        f"<code>{html.escape(text, quote=False).replace('|', '&#124;')}</code>"
        if "|" in text
        else f"`{text}`"
    )


def _section(effect: Effect) -> str:
    """Return the section of an effect: description, formula, parameters, and equivalent effects."""
    text = inspect.getdoc(importlib.import_module(f"hframe_gym.effects.{effect.name}"))
    rows = [[f"`{p.name}`", p.unit, f"{p.lower:g} to {p.upper:g}", p.role] for p in effect.parameters]
    family = "" if effect.family == effect.name else f" Family: {effect.family}."
    equivalent = (
        f"\n\nEquivalent in every recording: {', '.join(effect.equivalent)}." if effect.equivalent else ""
    )
    table = markdown(["parameter", "unit", "bounds", "kind"], rows, "---")
    return (
        f"\n## {effect.name}\n\n{text}\n\nSite: {effect.site}.{family} Source: {effect.source}.\n\n"
        f"```text\n{effect.formula}\n```\n\n{table}{equivalent}\n"
    )
