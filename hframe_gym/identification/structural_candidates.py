"""Effects that put something in the place of what the machine has: other tables (a yawing bridge, idlers with inertia),
another dry friction (bristles that give before they slide).

There is no small version of them to linearise around; instead every starting value of the library's grid is simulated,
and the way from the present machine's readings to its own is held against the residual.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simulation import parameter_batch
from ..effects import EFFECTS, effect_sites
from ..machine import Effect, Machine
from .dataset import Dataset, PreparedRecording
from .estimation import Fit, over_runs, parameter_table, prior_precision
from .initial_state_projection import projection
from .prediction import SEARCH_STEP, coarse, predict, residuals
from .typical_scales import TypicalScales

Array = NDArray[np.float64]
_STEP = 1e-4
_FITTED = 3


def replaces(effect: Effect) -> bool:
    """Whether an effect has no small version."""
    return bool(effect.structure or effect.friction)


def starts(effect: Effect, own: Mapping[str, float]) -> list[dict[str, float]]:
    """The grid of an effect's starting values; own: what they are relative to, but for new tables."""
    grids = [[g * (1.0 if effect.structure else own.get(p.unit, 1.0)) for g in p.grid] for p in effect.parameters]
    return [dict(zip((p.name for p in effect.parameters), v, strict=True)) for v in itertools.product(*grids)]


def structural(current: Fit, data: Dataset, scale: TypicalScales, least: float) -> list[Machine]:
    """The current machine with each such effect that could save more than `least` (chi2 a sample), at its best start.

    The few best: to first order they promise less than they keep, so none is worth a fit only because it is a little
    better than another.  For the same reason new tables come with their two best starts.
    """
    machine = current.machine
    present = {e.label for e in machine.effects}
    found: list[tuple[float, list[Machine]]] = []
    for effect in filter(replaces, EFFECTS.values()):
        for site in effect_sites(effect, machine):
            if f"{effect.name}@{site}" in present:
                continue
            own = scale.of(machine.site_coordinate(site) or "")
            machines = [machine.with_effects(effect.at(site, **values)) for values in starts(effect, own)]
            saved = _savings(machines, current, data)
            if saved.max() > least * data.count:
                best = np.argsort(-saved)[: 2 if effect.structure else 1]
                found.append((float(saved.max()), [machines[int(k)] for k in best]))
    found.sort(key=lambda f: -f[0])
    return [machine for _, tried in found[:_FITTED] for machine in tried]


def _savings(machines: list[Machine], current: Fit, data: Dataset) -> Array:
    """Cost that going from the current machine towards each of these could save, to first order.

    The step from one to the other, less what the machine's own parameters could mimic, with the best weight.
    """
    own = len(current.free)
    thetas = np.vstack([current.theta, current.theta + _STEP * np.eye(own)])
    now, then = (
        parameter_table(current.machine, current.free, thetas),
        np.concatenate(list(map(parameter_batch, machines))),
    )

    rows = coarse(data)

    def products(run: PreparedRecording) -> Array:
        base, moved = (
            residuals(run, data, predict(m, run, current.mode, period=data.period, parameters=table).readings, rows)
            for m, table in ((current.machine, now), (machines[0], then))
        )
        stacked = np.vstack([(base[1:] - base[0]) / _STEP, moved - base[0], base[:1]])
        project = projection(current.machine, run, data, current.mode, SEARCH_STEP, rows)
        stacked = stacked if project is None else project(stacked)
        return stacked @ stacked.T

    gram = np.sum(list(over_runs(products, data)), axis=0)
    hessian = gram[:own, :own] + prior_precision(current.free)
    left = gram[own:, own:] - gram[own:, :own] @ np.linalg.solve(hessian, gram[:own, own:])
    size, towards = np.diag(left)[:-1], left[:-1, -1]
    saved = np.where(towards < 0.0, towards**2 / np.maximum(size, 1e-300), 0.0)
    return np.where(np.isfinite(saved), saved, 0.0)
