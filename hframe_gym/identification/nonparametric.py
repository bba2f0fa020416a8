"""The fallback for what no entry of the library explains: a table of a force or a friction level against one variable.

The missing force of every coordinate is held against every variable; the best few pairs are screened as tables, and the
best of them is fitted.  The table is named as what it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..effects.smooth_table import KNOTS, definition
from ..machine import Machine
from .candidates import Candidate
from .dataset import Dataset, PreparedRecording
from .effect_perturbation import MotionRecord, variable
from .estimation import over_runs
from .prediction import predict
from .residual import missing_force
from .typical_scales import TypicalScales

Array = NDArray[np.float64]
_BINS = 96
_TRIED = 3  # a coordinate


class Curve(NamedTuple):
    """A table's effect and site, and knots where its curve bends."""

    effect: str
    site: str
    knots: Array


def tables(machine: Machine, data: Dataset, scale: TypicalScales) -> list[Candidate]:
    """The most promising tables as candidates, a column for each knot."""
    missing = missing_force(machine, data)
    along = variables(machine, data)
    curves = []
    for site, motion in missing.items():
        force, direction = motion[:, 2], np.sign(motion[:, 1])
        if not np.any(force):
            continue
        size = float(np.mean(force**2)) * (machine.radii[machine.coordinate_names.index(site)] ** -2)
        for name, values in along.items():
            for kind, wave in (("smooth_force", force), ("smooth_friction", -force * direction)):
                share, knots = _curve(values, wave, both=name.startswith("velocity"))
                curves.append((share * size, Curve(f"{kind}[{name}]", site, knots)))
    curves.sort(key=lambda c: -c[0])
    # Of each coordinate the best, and one against time: what is missing on one shows on the others too, and where a run
    # was tells all runs apart.
    tried = []
    for site in missing:
        own = [curve for _, curve in curves if curve.site == site]
        tried += own[:_TRIED] + [curve for curve in own[_TRIED:] if curve.effect.endswith("[time]")][:1]
    return [_candidate(curve, scale) for curve in tried]


def variables(machine: Machine, data: Dataset) -> dict[str, Array]:
    """Every variable that a table may be against, along all runs (n,)."""
    names = [f"{what} of {c}" for what in ("position", "velocity", "path") for c in machine.coordinate_names] + ["time"]

    def of(run: PreparedRecording) -> dict[str, Array]:
        motion = predict(machine, run, "innovations", period=data.period, states=True)
        known = MotionRecord(run.time_s, run.inputs, *(part[0] for part in motion))
        return {name: variable(machine, definition(f"smooth_force[{name}]"), known) for name in names}

    parts = list(over_runs(of, data))
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


def _curve(by: Array, values: Array, *, both: bool) -> tuple[float, Array]:
    """Share of the mean square of values that bins of `by` explain beyond their mean, and knots by their bends.

    both: as far to one side of zero as to the other: what was fast one way will be the other way.
    """
    low, high = np.percentile(by, [0.05, 99.95])
    if both:
        high = max(high, -low)
        low = -high
    if not high > low:
        return 0.0, np.linspace(-1.0, 1.0, KNOTS)
    edges = np.linspace(low, high, _BINS + 1)
    index = np.clip(np.searchsorted(edges, by) - 1, 0, _BINS - 1)
    count = np.bincount(index, minlength=_BINS)
    mean = np.bincount(index, values, _BINS) / np.maximum(count, 1)
    total = float(np.sum(values**2))
    level = float(values.mean())
    known = count > 20
    share = float(np.sum(count[known] * (mean[known] - level) ** 2)) / max(total, 1e-300)
    centres = 0.5 * (edges[1:] + edges[:-1])
    smooth = (
        np.convolve(np.interp(centres, centres[known], mean[known]), [0.25, 0.5, 0.25], "same") if known.any() else mean
    )
    bend = np.abs(np.gradient(np.gradient(smooth)))
    density = np.sqrt(bend / max(float(bend.max()), 1e-300)) + 0.15
    cumulative = np.concatenate([[0.0], np.cumsum(density)])
    knots = np.interp(np.linspace(0.0, cumulative[-1], KNOTS), cumulative, edges)
    return share, knots


def _candidate(curve: Curve, scale: TypicalScales) -> Candidate:
    effect = definition(curve.effect)
    own = scale.of(curve.site)
    knots = {f"k{i:02d}": float(k) for i, k in enumerate(curve.knots)}
    zero = {f"f{i:02d}": 0.0 for i in range(KNOTS)}
    size = effect.parameter("f00").scale * own["force"]
    return Candidate(effect, curve.site, tuple({**knots, **zero, name: size} for name in zero), own)
