"""Variables of a component, such as its speed, on which the formulas of effects depend."""

from __future__ import annotations

from collections.abc import Sequence

from ...effects.smooth_table import TABLE_FAMILY
from ...machine import HOOKS, AppliedEffect, Effect, Machine, argument_names
from ..fit.covariance import BLOCK_S

# Variable of a coordinate, drive or belt by the name of an argument of an effect's formulas (`Effect`).
_VARIABLES = {
    "q": "position",
    "dq": "position",
    "v": "speed",
    "direction": "speed",
    "t": "time",
    "V": "voltage",
    "i": "current",
    "s": "extension",
    "rate": "extension",
}

_TABULATED = {"position", "speed", "time"}  # variables of tables (`search.tables.table_variables`)


def depend_on_same_variable(first: AppliedEffect, second: AppliedEffect, machine: Machine) -> bool:
    """Check whether two effects are functions of the same variable of the same component, such as its speed.

    If so, a small effect may be an error in the formula of a large one: an inaccurate formula of friction
    leaves a force that depends on the speed as well. A clock whose rate changes acts on all components, and
    changes with time.

    Args:
        first: One effect at its component.
        second: Another effect.
        machine: Machine on which both act.

    Returns:
        True for example for Stribeck friction and quadratic drag of one coordinate, two functions of its
        speed, and for a drifting clock and a winding that warms up. False if only one of them is periodic in
        the variable, or if one adds coordinates.
    """
    if first.definition.clock or second.definition.clock:
        return _changes_with_time(first) and _changes_with_time(second)
    sites = [machine.coordinate_of_site(e.site, e.definition.site) or e.site for e in (first, second)]
    structural = first.definition.structure or second.definition.structure
    return not structural and sites[0] == sites[1] and bool(_variables(first) & _variables(second))


def _changes_with_time(effect: AppliedEffect) -> bool:
    """Return whether an effect depends on time or drifts: its state's time constant is beyond fast motion."""
    definition = effect.definition
    if definition.clock or definition.against == "time" or ("time", False) in _variables(effect):
        return True
    constants = [effect.parameters[p.name] for p in definition.parameters if p.unit == "s"]
    return definition.next_state is not None and max(constants, default=0.0) > BLOCK_S


def curves_of_one_variable(effects: Sequence[AppliedEffect], machine: Machine) -> list[AppliedEffect]:
    """Return those effects, at least two, that are functions of the same variable of one coordinate.

    Together they form one curve over this variable, periodic effects included. Effects with a memory are left
    out, and those of variables that no table has, such as a voltage.

    Args:
        effects: Effects of the machine among which to look.
        machine: Machine on which they act.

    Returns:
        The largest such group, in the given order; empty if no two effects share a variable.
    """
    groups: dict[tuple[str, str], list[AppliedEffect]] = {}
    for effect in effects:
        variables = {name for name, _ in _variables(effect)}
        remembers = effect.definition.structure or effect.definition.next_state
        if len(variables) == 1 and variables <= _TABULATED and not remembers:
            site = machine.coordinate_of_site(effect.site, effect.definition.site) or effect.site
            groups.setdefault((site, variables.pop()), []).append(effect)
    largest = max(groups.values(), key=len, default=[])
    return largest if len(largest) > 1 else []


def _variables(effect: AppliedEffect) -> set[tuple[str, bool]]:
    """Return the variables on which the formulas of an effect depend, and whether it is periodic in them."""
    periodic = any(p.role in ("period", "rate") for p in effect.definition.parameters)
    hooks = [getattr(effect.definition, hook) for hook in HOOKS if getattr(effect.definition, hook)]
    arguments = {name for hook in hooks for name in argument_names(hook)}
    return {(_VARIABLES[name], periodic) for name in arguments & set(_VARIABLES)}


def describes_one_run(effect: Effect) -> bool:
    """Return whether an effect can describe a fault of a single run, so that other runs must confirm it.

    This holds for four kinds: a function of time and a clock act only at the time of the run, a winding
    begins each run with another resistance, and a table has values that a single run may determine.
    """
    over_time = any(
        hook and "t" in argument_names(hook) for hook in (getattr(effect, name) for name in HOOKS)
    )
    heats = effect.site == "drive" and effect.initial_spread is not None
    return over_time or heats or effect.clock is not None or effect.family == TABLE_FAMILY
