"""What an effect is: formulas at a site of a machine that the declared model may lack.

An `Effect` is a definition (one file of `hframe_gym.effects`); an `AppliedEffect` is that definition at a site with
numbers.  A definition gives one or more *contributions*: plain functions that ask for what they need by the names of
their arguments, beside the effect's own parameters, and that the kernel inlines at their place:

    contribution  gives                                                    may ask for
    force         force added to the coordinate, N or Nm                   q, v, t, z, u
    guard         where the force may be other than zero (default: all)    q
    coulomb       Coulomb level added, N or Nm (never falls below zero)    q, v, t, z, u
    friction      the force of dry friction, in place of the Coulomb one   z, v, level
    viscous       the coordinate's viscous coefficient, Ns/m or Nms        b, direction (+1 or -1)
    voltage       voltage that reaches the drive, V                        V
    delay         time by which the drive's voltage arrives late, s
    current       current of the drive, A                                  i, z
    tension       a belt's tension, N                                      s, rate, k
    growth        its energy's slope with stiffness, m^2 (else s^2/2)      s, k
    travel, arm   belt travel added by a pulley, m, and its slope, m/rad   q, z, per_radius
    behind        angle by which a pulley at rest stands behind, rad       q, per_radius
    reading       what a sensor shows, in its unit                         r, across
    lag           time by which a sensor is late, s
    evolve        the effect's own state after dt                          z, dq, dt, v, level, i

q, v: the coordinate's position and speed (own units); t: the rig's clock, s; u: the variable that `against` names;
z: the effect's own state, zero at the start of a run; level: the Coulomb level there; i: the current that Ohm's law
gives, A; s, rate, k: a belt's extension (m), its rate (m/s) and stiffness (N/m); r: the sensor's ideal reading; across:
position of the other linear coordinate; dq: the way gone in dt; per_radius: 1/m, of the pulley.

`structure` changes the machine's tables instead: it adds coordinates, belts and sensor rows whose numbers are tied to
the effect's parameters.

Contributions see NumPy arrays when plotted and SIMD registers in a kernel, so they use `where`, `exp`, `sin`, ... from
`hframe_gym.dynamics.simd` and `vector_math`.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

Site = Literal["coordinate", "motor", "drive", "drives", "belts", "sensor", "machine"]
Contribution = Callable[..., Any]
CONTRIBUTIONS = (
    "force",
    "guard",
    "coulomb",
    "friction",
    "viscous",
    "voltage",
    "delay",
    "current",
    "tension",
    "growth",
    "travel",
    "arm",
    "reading",
    "lag",
    "evolve",
)


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect: its unit (a key of `machine.tables.UNITS` where it follows the site), range and guesses.

    lower, upper: bounds in SI.  scale: the size of a typical change, for fits.  grid: starting values a search tries
    (one for an amplitude, several for a shape).  Both are relative to what is typical of the unit on the machine.
    role: an "amplitude" is zero where the effect is absent; a "phase" shifts the sine that the amplitude belongs to, so
    that both together are linear; a "period" (length of one) and a "rate" (rad per position) are searched on a grid
    made from the way travelled; "fixed" is not fitted; the rest is "shape".
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: float
    grid: tuple[float, ...] = (0.0,)
    role: Literal["amplitude", "phase", "period", "rate", "shape", "fixed"] = "shape"

    @property
    def amplitude(self) -> bool:
        return self.role == "amplitude"


@dataclass(frozen=True)
class Effect:
    """A definition: name, family, the kind of site it can sit at, parameters, contributions, formula and source.

    family: the effect's line in a user's catalogue, of which there may be several members.  equivalent: what no
    recording can tell from it, in words.  against: the variable `u` of a table ("position of y", "time", ...).
    refitted: whether a refit of the machine's own parameters holds it, so that nobody need search for it.
    coordinate: the one that `structure` adds, on which the force acts.  fits: whether a machine has room for it.
    """

    name: str
    family: str
    site: Site
    parameters: tuple[EffectParameter, ...]
    formula: str
    source: str
    force: Contribution | None = None
    guard: Contribution | None = None
    coulomb: Contribution | None = None
    friction: Contribution | None = None
    viscous: Contribution | None = None
    voltage: Contribution | None = None
    delay: Contribution | None = None
    current: Contribution | None = None
    tension: Contribution | None = None
    growth: Contribution | None = None
    travel: Contribution | None = None
    arm: Contribution | None = None
    behind: Contribution | None = None
    reading: Contribution | None = None
    lag: Contribution | None = None
    evolve: Contribution | None = None
    structure: Callable[..., Any] | None = None
    fits: Callable[..., bool] | None = None
    equivalent: tuple[str, ...] = ()
    refitted: bool = False
    against: str = ""
    coordinate: str = ""

    def parameter(self, name: str) -> EffectParameter:
        return next(p for p in self.parameters if p.name == name)

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """The parameters that are zero where the effect is absent."""
        return tuple(p.name for p in self.parameters if p.amplitude)

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
    """An effect at a site of a machine, with its numbers (of a machine: floats; of many variants at once: arrays)."""

    definition: Effect
    site: str
    parameters: Mapping[str, Any]

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

    def __call__(self, contribution: str, **scope: Any) -> Any:
        """A contribution's value for given arguments (see the module's table) and the effect's own parameters.

        Raises KeyError naming an argument that the contribution asks for and nobody gave.
        """
        function = getattr(self.definition, contribution)
        known = {**scope, **self.parameters}
        return function(*(known[name] for name in asked(function)))


@lru_cache(maxsize=1024)
def asked(function: Contribution) -> tuple[str, ...]:
    """The names of a contribution's arguments."""
    return tuple(inspect.signature(function).parameters)
