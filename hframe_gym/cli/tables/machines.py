"""Tables of machines, of their components and limits, and of the library of effects."""

from __future__ import annotations

from rich import box
from rich.markup import escape
from rich.table import Table

from ...dynamics import belt_modes
from ...effects import EFFECTS
from ...machine import BUILTIN_MACHINES, DRIVE_KINDS, Machine, Row, motion_limits, rigid_motions, written_unit
from ...registry import load_plugins

LISTED_MODES = 3


def machine_table() -> Table:
    """Format the built-in machines as a table.

    Returns:
        Table (rich) with one row per machine: name, description, numbers of coordinates and belts, and the
        lowest three natural frequencies of the masses on the belts (belt modes), Hz.
    """
    table = _table("machine", "description")
    for name, make_machine in BUILTIN_MACHINES.items():
        machine = make_machine()
        facts = [_count(len(machine.coordinates), "coordinate"), _count(len(machine.belts), "belt")]
        if modes := _lowest_modes(machine):
            facts.append(f"belt modes {modes}")
        table.add_row(name, f"{escape(machine.description)}\n[dim]{', '.join(facts)}[/dim]")
    return table


def effect_table() -> Table:
    """Format the library of effects (additional physical terms that identification can select) as a table.

    Plugins are loaded first. Names are never wrapped or truncated, so that a pipe can search them.

    Returns:
        Table (rich) with one row per effect and two columns: its name; its formula, the kind of component it
        acts on (site) and its parameters with units.
    """
    load_plugins()
    table = _table("effect", "formula, site, parameters")
    for effect in EFFECTS.values():
        parameters = ", ".join(
            p.name + (f" ({unit})" if (unit := written_unit(p.unit)) else "") for p in effect.parameters
        )
        details = f"at {effect.site}; {parameters}" if parameters else f"at {effect.site}"
        table.add_row(effect.name, f"{escape(effect.formula)}\n[dim]{escape(details)}[/dim]")
    return table


def _table(first: str, second: str) -> Table:
    """Return a table of two columns: names, which are never cut or wrapped, and texts, which wrap."""
    table = Table(box=box.SIMPLE_HEAD, show_lines=False, pad_edge=False, padding=(0, 1))
    table.add_column(first, no_wrap=True)
    table.add_column(second, overflow="fold")
    return table


def _count(count: int, noun: str) -> str:
    """Return a number with its noun: "1 belt", "3 belts"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def machine_tables(machine: Machine) -> list[Table]:
    """Format a machine as tables: coordinates, belts, drives, sensors, effects, and limits of the motion.

    Returns:
        Tables (rich), without those that would be empty. The last one has moved mass, stall force (force at
        rest), acceleration and top speed along each axis at rated voltage; implausible values there show
        wrong units.
    """
    tables = [_coordinate_table(machine), _belt_table(machine), _drive_table(machine), _sensor_table(machine)]
    effects = _titled("effects", "effect@site", "parameters")
    for effect in machine.effects:
        values = (f"{k} = {_cell(machine, f'{effect.label}.{k}', v)}" for k, v in effect.parameters.items())
        effects.add_row(escape(effect.label), escape(", ".join(values)))
    return [table for table in (*tables, effects, _limits_table(machine)) if table.row_count]


def _titled(title: str, *columns: str) -> Table:
    """Return an empty table with a title at the left, whose first column is never wrapped."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold", no_wrap=column == columns[0])
    return table


def _cell(machine: Machine, parameter: str, value: float) -> str:
    """Format a value with its unit, and with its standard deviation if it was identified."""
    std = machine.uncertainty.std(parameter) if machine.uncertainty else None
    spread = "" if std is None else f" +- {std:.2g}"
    return f"{value:.4g}{spread} {written_unit(machine.unit(parameter))}".rstrip()


def _sum(row: Row) -> str:
    """Format a row of factors as a sum, for example "x + y - phi1"."""
    text = ""
    for name, factor in row.items():
        if factor:
            sign = (" - " if factor < 0 else " + ") if text else ("-" if factor < 0 else "")
            text += sign + ("" if abs(factor) == 1 else f"{abs(factor):.4g} ") + name
    return text or "-"


def _coordinate_table(machine: Machine) -> Table:
    """Format the coordinates."""
    table = _titled("coordinates", "name", "mass or inertia", "viscous", "Coulomb", "radius", "range")
    for c in machine.coordinates:
        cells = [_cell(machine, f"{c.name}.{key}", getattr(c, key)) for key in ("mass", "viscous", "coulomb")]
        radius = _cell(machine, f"{c.name}.radius", c.radius) if c.kind == "rotary" else "-"
        limits = f"{c.range[0]:g} to {c.range[1]:g} {c.unit('position')}" if c.range else "-"
        table.add_row(*map(escape, (c.name, *cells, radius, limits)))
    return table


def _belt_table(machine: Machine) -> Table:
    """Format the belts; the stiffness is that at position 0."""
    title = "belt sections (sums of travel in m; that of a pulley is radius * angle)"
    table = _titled(title, "name", "EA", "rest length", "stiffness at 0", "stretch", "longer by")
    for b in machine.belts:
        length = _cell(machine, f"{b.name}.rest_length", b.rest_length)
        stiffness = f"{b.EA / b.rest_length:.4g} N/m"
        table.add_row(
            b.name, _cell(machine, f"{b.name}.EA", b.EA), length, stiffness, _sum(b.extension), _sum(b.length)
        )
    return table


def _drive_table(machine: Machine) -> Table:
    """Format the drives; the parameters of laws have one column, because each kind has others."""
    others = any(d.kind != "voltage" for d in machine.drives)
    of_motors = [key for d in machine.drives for key in d.parameter_names if key not in d.law_parameters]
    titles = {key: "R" if key == "resistance" else key.replace("_", " ") for key in of_motors}
    columns = [*(["kind"] if others else []), "channel", "moves", *titles.values()]
    columns += ["law"] if machine.drive_laws else []
    table = _titled("drives", "name", *columns, "rated")
    for d in machine.drives:
        cells = [d.kind] if others else []
        cells += [d.channel, d.coordinate]
        for key in titles:
            has = key in d.parameter_names
            cells.append(_cell(machine, f"{d.name}.{key}", getattr(d, key)) if has else "")
        if machine.drive_laws:
            defaults = DRIVE_KINDS.get(d.kind).defaults
            stated = {key: value for key, value in d.law_parameters.items() if defaults.get(key) != value}
            lines = [f"{key} {_cell(machine, f'{d.name}.{key}', value)}" for key, value in stated.items()]
            cells.append("\n".join(lines))
        table.add_row(*map(escape, (d.name, *cells, f"{d.rated_voltage:g} {machine.command_unit(d)}")))
    return table


def _sensor_table(machine: Machine) -> Table:
    """Format the sensors."""
    table = _titled("sensors", "channel", "kind", "measures", "noise", "resolution")
    for s in machine.sensors:
        cells = [_cell(machine, f"{s.channel}.{key}", value) for key, value in s.device_parameters.items()]
        table.add_row(*map(escape, (s.channel, s.kind, _sum(s.row), *cells)))
    return table


def _limits_table(machine: Machine) -> Table:
    """Format what the drives can do along each rigid motion; wrong units in a file show here."""
    title = "motion at rated voltage, belts not stretched: are these values plausible?"
    table = _titled(
        title, "along", "moved mass", "force at rest", "acceleration", "top speed", "other coordinates"
    )
    motions = rigid_motions(machine)
    for name, limit in motion_limits(machine).items():
        leading = machine.coordinate(name)
        turns = [
            f"{other}: {rate:.4g} {machine.coordinate(other).unit('position')}/{leading.unit('position')}"
            for other, rate in zip(machine.coordinate_names, motions[name].tolist(), strict=True)
            if rate and other != name
        ]
        cells = [
            f"{limit.inertia:.3g} {leading.unit('mass')}",
            f"{limit.force:.3g} {leading.unit('force')}",
            f"{limit.force / limit.inertia:.3g} {leading.unit('speed')}^2",
            f"{limit.speed:.3g} {leading.unit('speed')}",
        ]
        table.add_row(name, *cells, "\n".join(turns) or "-")
    return table


def belt_mode_line(machine: Machine) -> str:
    """Describe in one line the lowest three natural frequencies, Hz, of the masses on the belts."""
    return f"belt modes: {_lowest_modes(machine) or 'none (no elastic belt)'}"


def _lowest_modes(machine: Machine) -> str:
    """Return the lowest belt modes, such as "18.6, 33.1, 40.0, ... Hz"; "" without elastic belts."""
    modes = [f"{frequency:.1f}" for frequency in belt_modes(machine)]
    listed = [*modes[:LISTED_MODES], "..."] if len(modes) > LISTED_MODES else modes
    return f"{', '.join(listed)} Hz" if listed else ""
