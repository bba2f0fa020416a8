"""Parameters of a fitted effect: values with their limits, and its sizes with standard deviations."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...effects import effect_sites, get_effect
from ...machine import AppliedEffect, Machine
from ..fit.estimation import Fit
from ..judge.effect import ParameterValue, Size
from ..propose.candidates import covered_by_runs


def parameter_values(label: str, fitted: Fit) -> tuple[ParameterValue, ...]:
    """Return the parameters of a fitted effect, with the limits at which a value is hardly reliable.

    These are the bounds of the parameter's range, except 0 and its starting values. For a parameter of which
    the motion must show the value (`covered_by_runs`), the ends of the range that the runs can determine are
    added.

    Args:
        label: Label (name@site) of the effect.
        fitted: Fit of the machine with the effect.

    Returns:
        One entry per parameter, fixed ones included, in the order of the effect's definition.
    """
    effect = next(e for e in fitted.machine.effects if e.label == label)
    free = {f.name: f for f in fitted.free}
    values = []
    for p in effect.definition.parameters:
        simpler = {v: name for v, name in p.simpler.items() if _can_act(name, effect, fitted.machine)}
        limited = free.get(f"{label}.{p.name}") if covered_by_runs(p) else None
        covered = (limited.lower, limited.upper) if limited is not None else None
        limits = tuple({p.lower, p.upper} - {0.0, *p.grid})
        unit = fitted.machine.effect_unit(effect, p.name)
        value, below = effect.parameters[p.name], p.role == "rate" or p.unit == "Hz"
        values.append(ParameterValue(p.name, unit, value, limits, covered, below, simpler))
    return tuple(values)


def _can_act(name: str, effect: AppliedEffect, machine: Machine) -> bool:
    """Return whether the effect of a name can act where another effect does, or on its coordinate."""
    places = {effect.site, machine.coordinate_of_site(effect.site, effect.definition.site)}
    return not places.isdisjoint(effect_sites(get_effect(name), machine))


def sizes(effect: AppliedEffect, machine: Machine) -> tuple[Size, ...]:
    """Return the amplitudes of a fitted effect with their standard deviations.

    An amplitude is a parameter whose value 0 means that the effect is absent.

    Args:
        effect: The effect with its fitted parameters.
        machine: Machine with the covariance of its parameters.

    Returns:
        Amplitudes that are in the covariance, in the unit of each; empty without a covariance.
    """
    uncertainty = machine.uncertainty
    if uncertainty is None:
        return ()
    index = {name: i for i, name in enumerate(uncertainty.names)}
    scaled: list[str] = []
    if effect.definition.viscous:
        # The motion shows the product with the coefficient, which the back-EMF makes uncertain.
        scaled.append(f"{machine.coordinate_of_site(effect.site, effect.definition.site)}.viscous")
    found = []
    for p in effect.definition.parameters:
        if not p.amplitude or f"{effect.label}.{p.name}" not in index:
            continue
        others = (f"{effect.label}.{other.name}" for other in effect.definition.parameters if other is not p)
        names = [f"{effect.label}.{p.name}", *others, *scaled]
        rows = [index[name] for name in names if name in index]
        std = _std_beside_fixed_values(uncertainty.covariance[np.ix_(rows, rows)])
        found.append(Size(p.name, machine.effect_unit(effect, p.name), effect.parameters[p.name], std))
    return tuple(found)


def _std_beside_fixed_values(covariance: Array) -> float:
    """Return the standard deviation that the first parameter has if the others are held, 0 if it has none."""
    scale = np.sqrt(np.diag(covariance))
    if not scale[0] > 0.0:
        return 0.0
    free = scale > 0.0
    correlation = covariance[np.ix_(free, free)] / np.outer(scale[free], scale[free])
    to_first = correlation[1:, 0]
    explained = float(to_first @ np.linalg.lstsq(correlation[1:, 1:], to_first, rcond=None)[0])
    return float(scale[0] * math.sqrt(max(1.0 - explained, 0.0)))  # below 0 by rounding only
