"""What could be missing: every effect of the library at every site, at starting values of its shape.

Sizes in the library are relative (0.3 of the typical force, a tenth of the top speed); `TypicalScales` holds what they are
relative to on this machine and in these runs.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS, effect_sites
from ..machine import AppliedEffect, Effect, Machine
from .dataset import Dataset
from .estimation import FreeParameter
from .periodogram import rates, slow_rates
from .structural_candidates import replaces
from .typical_scales import TypicalScales

Array = NDArray[np.float64]
# Beyond every reading of this rig by this factor: a range that does not end.
_ENDLESS = 10.0
_MOST_SHAPES = 64


@dataclass(frozen=True)
class Candidate:
    """An effect at a site with starting values of its shape.

    columns: the parameters of one or more additions, each at a typical size, whose weighted sum is the effect; an
    effect without an amplitude has one, which is the effect itself.
    """

    effect: Effect
    site: str
    columns: tuple[Mapping[str, float], ...]
    references: Mapping[str, float]

    @property
    def label(self) -> str:
        return f"{self.effect.name}@{self.site}"

    @property
    def fixed(self) -> bool:
        """Whether the effect has no amplitude that could be nought."""
        return not self.effect.amplitudes

    def applied(self, amounts: Sequence[float]) -> AppliedEffect:
        """The effect with these amounts (columns,) of its columns, clipped to its bounds."""
        values = dict(self.columns[0])
        phase = next((p.name for p in self.effect.parameters if p.role == "phase"), None)
        names = self.effect.amplitudes
        if phase is not None:
            sine, cosine = amounts
            values[names[0]] *= float(np.hypot(sine, cosine))
            values[phase] = float(np.arctan2(cosine, sine))
        elif len(names) == len(self.columns):
            values |= {n: c[n] * float(a) for n, c, a in zip(names, self.columns, amounts, strict=True)}
        bounds = {p.name: (p.lower, p.upper) for p in self.effect.parameters}
        return self.effect.at(self.site, **{n: float(np.clip(v, *bounds[n])) for n, v in values.items()})


def candidates(
    machine: Machine, data: Dataset, scale: TypicalScales, residual: Mapping[str, Array], *, long: bool = False
) -> list[Candidate]:
    """All of the library that the machine does not have yet and that acts through forces or readings.

    residual: by coordinate, the force that is missing on it along all runs, with the motion that it belongs to (see
    `residual.missing_force`); it tells which periods are worth a try.  long: try all long periods of friction too.
    """
    present = {e.label for e in machine.effects}
    found: list[Candidate] = []
    for effect in EFFECTS.values():
        if replaces(effect) or effect.refitted:
            continue
        for site in effect_sites(effect, machine):
            if f"{effect.name}@{site}" in present:
                continue
            coordinate = machine.site_coordinate(site) or ""
            own = scale.of(coordinate)
            for shape in _shapes(effect, site, machine, data, own, residual, long):
                found.append(Candidate(effect, site, _columns(effect, shape, own), own))
    return found


def _columns(effect: Effect, shape: Mapping[str, float], own: Mapping[str, float]) -> tuple[Mapping[str, float], ...]:
    zero = dict.fromkeys(effect.amplitudes, 0.0)
    size = {p.name: p.scale * own.get(p.unit, 1.0) for p in effect.parameters if p.amplitude}
    phase = next((p.name for p in effect.parameters if p.role == "phase"), None)
    if phase is not None:
        return tuple({**size, **shape, phase: angle} for angle in (0.0, np.pi / 2))
    return tuple({**zero, **shape, name: size[name]} for name in size) or (dict(shape),)


def _shapes(
    effect: Effect,
    site: str,
    machine: Machine,
    data: Dataset,
    own: Mapping[str, float],
    residual: Mapping[str, Array],
    long: bool,
) -> list[Mapping[str, float]]:
    """Starting values of everything but amplitudes and phases."""
    if effect.name == "sensor_range":
        return _ranges(machine.output_channels.index(site), data)
    grids: dict[str, list[float]] = {}
    for p in effect.parameters:
        if p.role == "shape":
            grids[p.name] = [g * own.get(p.unit, 1.0) for g in p.grid]
        elif p.role in ("rate", "period"):
            coordinate = machine.site_coordinate(site) or ""
            found = rates(residual[coordinate], friction=effect.coulomb is not None)
            if long and effect.coulomb:
                found = np.concatenate([found, slow_rates(residual[coordinate][:, 0])])
            grids[p.name] = [float(r) if p.role == "rate" else float(2 * np.pi / r) for r in found]
    shapes = [dict(zip(grids, values, strict=True)) for values in itertools.product(*grids.values())]
    return list(shapes[:_MOST_SHAPES])


def _ranges(j: int, data: Dataset) -> list[Mapping[str, float]]:
    """Ends at which sensor j may stick: the outermost readings, where many lie together."""
    values = np.concatenate([run.outputs[:, j] for run in data.runs])
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return []
    ends = []
    for sign in (-1.0, 1.0):
        outward = sign * values
        top = float(np.percentile(outward, 99.9))
        together = outward > top - 4 * max(float(data.noise[j]), 1e-12)
        stuck = float(np.mean(together)) > 0.005
        ends.append(sign * float(np.median(outward[together])) if stuck else None)
    endless = _ENDLESS * max(float(np.abs(values).max()), 1e-6)
    low, high = ends
    choices = [(low, None), (None, high), (low, high)]
    return [
        {"low": -endless if a is None else a, "high": endless if b is None else b}
        for a, b in choices
        if not (a is None and b is None)
    ]


def effect_parameters(effect: AppliedEffect, machine: Machine, scale: TypicalScales) -> tuple[FreeParameter, ...]:
    """The free parameters of an effect: what may be nought or negative linear, the rest as logarithms.

    Their values are those at theta = 0, but for a table's, which are theta.
    """
    own = scale.of(machine.site_coordinate(effect.site) or "")
    free = []
    for p in effect.definition.parameters:
        if p.role == "fixed":
            continue
        name, value = f"{effect.label}.{p.name}", effect.parameters[p.name]
        size = p.scale * own.get(p.unit, 1.0)
        if effect.definition.against:  # values of one curve: what holds them together is about themselves
            free.append(
                FreeParameter(name, 0.0, prior=10.0, scale=size, lower=p.lower, upper=p.upper, along=effect.label)
            )
        elif p.amplitude or p.role == "phase":
            free.append(FreeParameter(name, value, prior=10.0, scale=size, lower=p.lower, upper=p.upper))
        elif p.role in ("rate", "period"):
            free.append(FreeParameter(name, value, prior=0.1, lower=p.lower, upper=p.upper))
        elif p.lower < 0.0 or value == 0.0:
            free.append(FreeParameter(name, value, prior=3.0, scale=size, lower=p.lower, upper=p.upper))
        else:
            free.append(FreeParameter(name, value, prior=1.0, lower=p.lower, upper=p.upper))
    return tuple(free)
