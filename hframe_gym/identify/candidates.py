"""What could be missing: every effect of the library at every site, at starting values of its shape.

Sizes in the library are relative (0.3 of the typical force, a tenth of the top speed); `References` holds what they are
relative to on this machine and in these runs.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..effects import LIBRARY, sites
from ..machine import AppliedEffect, Effect, Machine
from .fit import Free, typical_force

Array = NDArray[np.float64]
References = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Candidate:
    """An effect at a site with starting values of its shape parameters; its amplitude is zero."""

    effect: Effect
    site: str
    shape: Mapping[str, float]
    references: Mapping[str, float]

    @property
    def label(self) -> str:
        return f"{self.effect.name}@{self.site}"

    @property
    def amplitude(self) -> str:
        """The parameter that is zero when the effect is absent."""
        return next(p.name for p in self.effect.parameters if p.amplitude)

    @property
    def unit_size(self) -> float:
        """A typical size of the amplitude here, in its own unit."""
        p = self.effect.parameter(self.amplitude)
        return p.scale * self.references.get(p.unit, 1.0)

    def applied(self, amplitude: float) -> AppliedEffect:
        """The effect with an amplitude, in its own unit, clipped to its bounds."""
        p = self.effect.parameter(self.amplitude)
        return self.effect.at(self.site, **{self.amplitude: float(np.clip(amplitude, p.lower, p.upper)), **self.shape})


def references(machine: Machine, velocities: Array) -> References:
    """By coordinate (and "" for machine-wide sites): typical force, top speed in these runs, own units.

    velocities (n, coordinates): of the machine along all runs.
    """
    force = typical_force(machine)
    top = np.percentile(np.abs(velocities), 99, axis=0)
    table = {
        c.name: {"force": force * (c.radius if c.kind == "rotary" else 1.0), "speed": max(float(top[i]), 1e-6)}
        for i, c in enumerate(machine.coordinates)
    }
    return table | {"": {}}


def candidates(machine: Machine, scale: References) -> list[Candidate]:
    """All of the library that the machine does not have yet, on the grid of its shape parameters."""
    present = {e.label for e in machine.effects}
    found = []
    for effect in LIBRARY.values():
        shapes = [p for p in effect.parameters if not p.amplitude]
        for site in sites(effect, machine):
            own = scale.get(site, scale[""])
            grids = [[g * own.get(p.unit, 1.0) for g in p.grid] for p in shapes]
            for values in itertools.product(*grids):
                candidate = Candidate(effect, site, dict(zip((p.name for p in shapes), values, strict=True)), own)
                if candidate.label not in present:
                    found.append(candidate)
    return found


def effect_parameters(effect: AppliedEffect, own: Mapping[str, float], amplitude: str) -> tuple[Free, ...]:
    """The free parameters of an effect: its amplitude linear with a wide prior, its shape as logarithms."""
    free = []
    for p in effect.definition.parameters:
        name, value = f"{effect.label}.{p.name}", effect.parameters[p.name]
        if p.name == amplitude or value == 0.0:
            scale = p.scale * own.get(p.unit, 1.0)
            free.append(Free(name, value, prior=10.0, scale=scale, lower=p.lower, upper=p.upper))
        else:
            free.append(Free(name, value, prior=1.0, lower=p.lower, upper=p.upper))
    return tuple(free)
