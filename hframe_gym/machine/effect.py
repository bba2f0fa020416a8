"""What an effect is: a formula at a site of a machine that the declared model may lack.

An `Effect` is a definition (one file of `hframe_gym.effects`); an `AppliedEffect` is that definition at a site with
numbers.  A definition gives one or more *contributions*, plain functions that the kernel inlines at their place:

    force(q, v, t, *parameters)        force added to the coordinate, N or Nm
    coulomb(q, v, t, *parameters)      Coulomb level added, N or Nm (the level never falls below zero)
    viscous(b, direction, *parameters) the coordinate's viscous coefficient when it moves in direction +1 or -1
    delay(*parameters)                 time by which the drive's voltage arrives late, s

q and v are the coordinate's own position and speed (m or rad), t the rig's clock in s.  They see NumPy arrays when
plotted and SIMD registers in a kernel, so they use `where`, `exp`, `sin`, ... from `hframe_gym.machine.vector_math`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

Site = Literal["coordinate", "drive", "drives"]
Contribution = Callable[..., Any]
CONTRIBUTIONS = ("force", "coulomb", "viscous", "delay")


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect: its unit (a key of `machine.tables.UNITS` where it follows the site), range and guesses.

    lower, upper: bounds in SI.  scale: the size of a typical change, for fits.  grid: starting values a search tries
    (one for an amplitude, several for a shape).
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: float
    grid: tuple[float, ...]
    amplitude: bool = False


@dataclass(frozen=True)
class Effect:
    """A definition: name, family, the kind of site it can sit at, parameters, contributions, formula and source."""

    name: str
    family: str
    site: Site
    parameters: tuple[EffectParameter, ...]
    formula: str
    source: str
    force: Contribution | None = None
    coulomb: Contribution | None = None
    viscous: Contribution | None = None
    delay: Contribution | None = None
    equivalent: tuple[str, ...] = ()

    def parameter(self, name: str) -> EffectParameter:
        return next(p for p in self.parameters if p.name == name)

    def at(self, site: str, **parameters: float) -> AppliedEffect:
        """This effect at a site, with every parameter given.

        Raises ValueError naming the parameter that is missing, unknown or outside its bounds.
        """
        names = [p.name for p in self.parameters]
        if set(parameters) != set(names):
            raise ValueError(f"effect {self.name} at {site} takes {', '.join(names)}, not {', '.join(parameters)}")
        for p in self.parameters:
            if not p.lower <= parameters[p.name] <= p.upper:
                raise ValueError(
                    f"effect {self.name} at {site}: {p.name} = {parameters[p.name]:g} is outside "
                    f"[{p.lower:g}, {p.upper:g}]"
                )
        return AppliedEffect(self, site, {n: float(parameters[n]) for n in names})


@dataclass(frozen=True)
class AppliedEffect:
    """An effect at a site of a machine, with its numbers."""

    definition: Effect
    site: str
    parameters: Mapping[str, float]

    @property
    def name(self) -> str:
        return self.definition.name

    @property
    def label(self) -> str:
        """`name@site`, the prefix of its parameters' full names."""
        return f"{self.definition.name}@{self.site}"

    def with_parameters(self, parameters: Mapping[str, float]) -> AppliedEffect:
        """The same effect with other numbers."""
        return dataclasses.replace(self, parameters=dict(parameters))
