"""Effects that change the machine's tables (a yawing bridge, idlers with inertia): no small version, so they are tried.

Every starting value of the library's grid is one innovations run; the best is where a fit would begin.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from ..effects import LIBRARY, sites
from ..machine import Effect, Machine
from ..machine.simulate import parameter_batch
from .data import Data, Run
from .fit import Fit, over_runs
from .prediction import predict, residuals

Array = NDArray[np.float64]


def starts(effect: Effect) -> list[dict[str, float]]:
    """The grid of an effect's starting values."""
    grids = [p.grid for p in effect.parameters]
    return [dict(zip((p.name for p in effect.parameters), v, strict=True)) for v in itertools.product(*grids)]


def structural(current: Fit, data: Data) -> list[Machine]:
    """The current machine with each structural effect that it has room for, at its best starting values."""
    present = {e.name for e in current.machine.effects}
    found = []
    for effect in LIBRARY.values():
        if effect.structure and effect.name not in present and sites(effect, current.machine):
            machines = [current.machine.with_effects(effect.at("machine", **values)) for values in starts(effect)]
            found.append(machines[int(np.argmin(_costs(machines, current, data)))])
    return found


def _costs(machines: list[Machine], current: Fit, data: Data) -> Array:
    """Innovations cost of machines of one shape."""
    table = np.concatenate([parameter_batch(m) for m in machines])

    def of(run: Run) -> Array:
        motion = predict(machines[0], run, current.mode, period=data.period, parameters=table)
        left = residuals(run, data, motion.readings)
        return np.einsum("bi,bi->b", left, left)

    total = np.sum(list(over_runs(of, data)), axis=0)
    return np.where(np.isfinite(total), total, np.inf)
