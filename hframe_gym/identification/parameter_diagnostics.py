"""Why a fitted parameter may deserve little trust: bounds, the prior, the data, and other parameters."""

from __future__ import annotations

import numpy as np

from ..machine import Machine
from .estimation import default_free_parameters

# A standard deviation beyond this share of the value, and a correlation beyond this size, are worth a word.
_VAGUE = 0.2
_TOGETHER = 0.95
# ... and one beyond this share of the prior's: the data hardly added to what was declared.
_PRIOR = 0.6
_VAGUE_PHASE = 0.3  # rad


def parameter_doubts(machine: Machine, declared: Machine) -> dict[str, list[str]]:
    """By full name of each identified parameter: what is doubtful about it, in words (often nothing)."""
    if machine.uncertainty is None:
        return {}
    found: dict[str, list[str]] = {name: [] for name in machine.uncertainty.names}
    _at_bounds(machine, found)
    _vague(machine, declared, found)
    _together(machine, found)
    return found


def _at_bounds(machine: Machine, found: dict[str, list[str]]) -> None:
    for e in machine.effects:
        for p in e.definition.parameters:
            name, value = f"{e.label}.{p.name}", e.parameters[p.name]
            near = 1e-6 * max(abs(value), p.scale)
            if name in found and (value - p.lower < near or p.upper - value < near):
                found[name].append("at a bound")


def _vague(machine: Machine, declared: Machine, found: dict[str, list[str]]) -> None:
    assert machine.uncertainty is not None
    priors = {f.name: f for f in default_free_parameters(declared)}
    roles = {f"{e.label}.{p.name}": p.role for e in machine.effects for p in e.definition.parameters}
    for name, words in found.items():
        value, std = machine.parameters[name], machine.uncertainty.std(name) or 0.0
        prior = priors.get(name)
        if prior is not None and std > _PRIOR * prior.prior * abs(value if prior.scale is None else prior.scale):
            words.append("told by the declared value more than by the data")
        elif std > (_VAGUE_PHASE if roles.get(name) == "phase" else _VAGUE * abs(value)):
            words.append("poorly determined")


def _together(machine: Machine, found: dict[str, list[str]]) -> None:
    assert machine.uncertainty is not None
    names, covariance = machine.uncertainty.names, machine.uncertainty.covariance
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(spread, spread)
    np.fill_diagonal(correlation, 0.0)
    for i, name in enumerate(names):
        others = [f"{names[j]} ({correlation[i, j]:+.3f})" for j in np.flatnonzero(np.abs(correlation[i]) > _TOGETHER)]
        if others:
            found[name].append(f"hardly apart from {', '.join(others)}")
