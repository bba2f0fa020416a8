"""Randomised machines: a field of the machine x a distribution x scale, add or set x reset or startup.

    Vary("*.coulomb", Uniform(0.5, 2.0))                          each Coulomb level on its own, every episode
    Vary("*.EA", Uniform(0.7, 1.3), shared=True)                  one draw for all belts
    Vary("x.mass", Normal(0.0, 0.1), how="add", when="startup")   once a seed

A distribution is its quantile function: what it makes of a uniform number in (0, 1).  The numbers come from the
environment's own generator (`draws`), so a seed fixes them; what they made is in the reset's info.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import exp10, ndtri

from ..machine import Machine

Array = NDArray[np.float64]
How = Literal["scale", "add", "set"]
When = Literal["reset", "startup"]
# Least share of its nominal value that a parameter which must stay positive can be drawn to.
LEAST_SHARE = 0.05
# The outermost uniform numbers that `draws` makes.
_EDGES = np.array([0.5 * 2.0**-53, 1.0 - 0.5 * 2.0**-53])


class Distribution(Protocol):
    """A distribution by its quantile function.

    bounded: whether all of it is between `quantile` of 0 and 1; a rule with such a distribution is checked when the
    environment is made, others at each draw.
    """

    @property
    def bounded(self) -> bool: ...

    def quantile(self, u: Array) -> Array:
        """Values (k,) for uniform numbers (k,) in (0, 1).  Each must depend on its own number alone, to the bit."""


@dataclass(frozen=True)
class Uniform:
    """Uniform on [low, high].  Raises ValueError unless both are finite and in order."""

    low: float
    high: float
    bounded = True

    def __post_init__(self) -> None:
        _check(self, math.isfinite(self.low) and math.isfinite(self.high) and self.low <= self.high)

    def quantile(self, u: Array) -> Array:
        return self.low + (self.high - self.low) * u


@dataclass(frozen=True)
class LogUniform:
    """Uniform in the logarithm on [low, high].  Raises ValueError unless both are positive, finite and in order."""

    low: float
    high: float
    bounded = True

    def __post_init__(self) -> None:
        _check(self, 0.0 < self.low <= self.high < math.inf)

    def quantile(self, u: Array) -> Array:
        # SciPy's exponential: NumPy's may round differently with the array's size.
        values: Array = self.low * exp10(math.log10(self.high / self.low) * u)
        return values


@dataclass(frozen=True)
class Normal:
    """Normal with a mean and a standard deviation.  Raises ValueError unless both are finite and std not negative."""

    mean: float
    std: float
    bounded = False

    def __post_init__(self) -> None:
        _check(self, math.isfinite(self.mean) and 0.0 <= self.std < math.inf)

    def quantile(self, u: Array) -> Array:
        return self.mean + self.std * np.asarray(ndtri(u))


def _check(distribution: Distribution, fine: bool) -> None:
    if not fine:
        raise ValueError(f"randomize: the distribution {distribution} is empty or not finite")


@dataclass(frozen=True)
class Vary:
    """One rule.  parameter: a name of `Machine.parameters`, or a pattern of such with * and ?.

    shared: one draw for all that match, instead of one each.
    """

    parameter: str
    distribution: Distribution
    how: How = "scale"
    when: When = "reset"
    shared: bool = False

    def apply(self, value: Array, drawn: Array) -> Array:
        """The parameter's values from what they were and what was drawn, (k,) each."""
        if self.how == "scale":
            return value * drawn
        return value + drawn if self.how == "add" else drawn


@dataclass(frozen=True)
class Identified:
    """Joint normal draws around the machine's own values from its identified covariance, times `widen` (in std).

    A draw ends at the parameter's limits: what is known badly may have a tail that no machine has.
    """

    widen: float = 1.0
    when: When = "reset"


Rule: TypeAlias = Vary | Identified

DEFAULT: tuple[Rule, ...] = (
    Vary("*.EA", Uniform(0.7, 1.3), shared=True),  # one belt, one material
    Vary("*.rest_length", Uniform(0.85, 1.2)),
    Vary("*.coulomb", Uniform(0.5, 2.0)),
    Vary("*.mass", Uniform(0.9, 1.2)),
)
WIDE: tuple[Rule, ...] = (
    Vary("*.EA", LogUniform(0.5, 2.0), shared=True),
    Vary("*.rest_length", Uniform(0.75, 1.3)),
    Vary("*.coulomb", LogUniform(0.25, 4.0)),
    Vary("*.viscous", LogUniform(0.5, 2.0)),
    Vary("*.mass", Uniform(0.7, 1.5)),
    Vary("*.K[te]", Uniform(0.85, 1.15)),
    Vary("*.resistance", Uniform(0.9, 1.2)),
)
PRESETS: dict[str, tuple[Rule, ...]] = {"none": (), "default": DEFAULT, "wide": WIDE, "identified": (Identified(),)}
Randomise: TypeAlias = Literal["none", "default", "wide", "identified"] | Sequence[Rule]


def as_rules(randomize: Randomise, machine: Machine) -> tuple[Rule, ...]:
    """The rules of a preset, as far as the machine has what they speak of, or the rules themselves.

    Raises ValueError for an unknown preset or what is no rule.
    """
    if isinstance(randomize, str):
        if randomize not in PRESETS:
            raise ValueError(f"randomize is {randomize!r}, choose one of {', '.join(PRESETS)} or a list of Vary")
        return tuple(r for r in PRESETS[randomize] if isinstance(r, Identified) or _columns(machine, r))
    rules = tuple(randomize)
    for rule in rules:
        if not isinstance(rule, Vary | Identified):
            raise ValueError(f"randomize: {rule!r} is neither a Vary nor Identified")
        if rule.when not in ("reset", "startup"):
            raise ValueError(f"randomize: {rule!r} has when = {rule.when!r}, choose reset or startup")
        if isinstance(rule, Vary) and rule.how not in ("scale", "add", "set"):
            raise ValueError(f"randomize: {rule!r} has how = {rule.how!r}, choose scale, add or set")
    return rules


def _columns(machine: Machine, rule: Vary) -> list[int]:
    """Places in `Machine.parameters` that a rule speaks of."""
    return [i for i, name in enumerate(machine.parameters) if fnmatchcase(name, rule.parameter)]


def limits(machine: Machine) -> tuple[Array, Array]:
    """The least and the greatest value (P,) that each parameter can be drawn to.

    Friction may vanish; a belt keeps `LEAST_SHARE` of its length wherever the carriage can be; all else that is
    positive keeps that share of its nominal value; effects' parameters have bounds of their own.
    """
    bounds = {f"{e.label}.{p.name}": (p.lower, p.upper) for e in machine.effects for p in e.definition.parameters}
    for belt in machine.belts:
        ranges = {c: machine.coordinate(c).range or (0.0, 0.0) for c in belt.length}
        shortest = sum(min(factor * end for end in ranges[c]) for c, factor in belt.length.items())
        bounds[f"{belt.name}.rest_length"] = (LEAST_SHARE * belt.rest_length - shortest, math.inf)
    low, high = [], []
    for name, value in machine.parameters.items():
        may_vanish = name.endswith((".viscous", ".coulomb"))
        below, above = bounds.get(name, (0.0 if may_vanish else min(LEAST_SHARE * value, value), math.inf))
        low.append(below)
        high.append(above)
    return np.array(low), np.array(high)


class Sampler:
    """Draws the parameters of a machine by the rules for one occasion (reset or startup).

    names: the parameters that change.  draws: how many uniform numbers one draw takes.  low, high (P,): between
    which values every parameter lies after it, given those before.

    Raises ValueError naming the rule that fits no parameter, or that can leave a parameter's limits.
    """

    def __init__(
        self, machine: Machine, rules: Sequence[Rule], when: When, before: tuple[Array, Array] | None = None
    ) -> None:
        self._all = list(machine.parameters)
        self._least, self._most = limits(machine)
        nominal = np.array(list(machine.parameters.values()))
        self.low, self.high = (edge.copy() for edge in (before or (nominal, nominal)))
        self.draws = 0
        self._varied: list[tuple[int, int, Vary]] = []  # column of the parameter, of its random number, rule
        self._joint: list[tuple[list[int], int, Array]] = []  # columns, first random number, factor of the covariance
        for rule in rules:
            if rule.when == when:
                if isinstance(rule, Vary):
                    self._add(machine, rule)
                else:
                    self._add_identified(machine, rule)
        touched = {c for c, _, _ in self._varied} | {c for columns, _, _ in self._joint for c in columns}
        self.names = tuple(self._all[c] for c in sorted(touched))

    def _take(self, count: int) -> int:
        first = self.draws
        self.draws += count
        return first

    def _add(self, machine: Machine, rule: Vary) -> None:
        columns = _columns(machine, rule)
        if not columns:
            raise ValueError(f"randomize: machine {machine.name!r} has no parameter {rule.parameter!r}")
        first = self._take(1 if rule.shared else len(columns))
        for i, column in enumerate(columns):
            self._varied.append((column, first if rule.shared else first + i, rule))
            self._widen(column, rule)

    def _widen(self, column: int, rule: Vary) -> None:
        """What the rule can make of the parameter; all four corners, for a scale may be negative."""
        edges = rule.distribution.quantile(_EDGES)
        before = np.array([self.low[column], self.high[column]])
        corners = np.concatenate([rule.apply(before, np.full(2, edge)) for edge in edges])
        if rule.distribution.bounded:
            for value in (corners.min(), corners.max()):
                self._refuse(rule, column, value, "can make")
        least, most = self._least[column], self._most[column]
        self.low[column], self.high[column] = np.clip([corners.min(), corners.max()], least, most)

    def _refuse(self, rule: Vary, column: int, value: float, how: str) -> None:
        """Raises ValueError for a value outside the parameter's limits (which two roundings may reach)."""
        least, most = self._least[column], self._most[column]
        room = 1e-12 * max(abs(least), abs(value))
        if not least - room <= value <= most + room:
            raise ValueError(
                f"randomize: the rule {rule} {how} {self._all[column]} = {value:g}, outside [{least:g}, {most:g}]"
                + ("" if rule.distribution.bounded else "; choose a bounded distribution")
            )

    def _add_identified(self, machine: Machine, rule: Identified) -> None:
        known = machine.uncertainty
        if known is None or not known.names:
            raise ValueError(
                f"randomize: machine {machine.name!r} carries no covariance; 'identified' needs a machine.json "
                "written by hframe identify"
            )
        columns = [self._all.index(name) for name in known.names]
        # By eigenvectors: a covariance on the edge of singular has no Cholesky factor.
        sizes, vectors = np.linalg.eigh(known.covariance)
        factor = vectors * np.sqrt(np.maximum(sizes, 0.0)) * rule.widen
        self._joint.append((columns, self._take(len(columns)), factor))
        reach = np.abs(factor).sum(axis=1) * float(ndtri(_EDGES[1]))
        self.low[columns] = np.maximum(self.low[columns] - reach, self._least[columns])
        self.high[columns] = np.minimum(self.high[columns] + reach, self._most[columns])

    def draw(self, base: Array, uniforms: Array) -> Array:
        """Parameters (k, P) from base values (k, P) and uniform numbers (k, draws) in (0, 1).

        Raises ValueError naming rule and parameter where a rule of unbounded distribution leaves the limits; only
        friction that would be negative is none.
        """
        values = base.copy()
        shared: dict[int, Array] = {}  # a rule's draws, so that those shared are worked out once
        for column, number, rule in self._varied:
            if number not in shared:
                shared[number] = rule.distribution.quantile(uniforms[:, number])
            drawn = rule.apply(values[:, column], shared[number])
            if not rule.distribution.bounded:
                if self._least[column] == 0.0:
                    drawn = np.maximum(drawn, 0.0)
                for value in (drawn.min(initial=math.inf), drawn.max(initial=-math.inf)):
                    if len(drawn):
                        self._refuse(rule, column, float(value), "drew")
            values[:, column] = drawn
        for columns, first, factor in self._joint:
            normals = np.asarray(ndtri(uniforms[:, first : first + len(columns)]))
            for i, column in enumerate(columns):
                # Summed term by term: a matrix product may add in another order for another batch.
                for j in range(len(columns)):
                    values[:, column] += factor[i, j] * normals[:, j]
            values[:, columns] = np.clip(values[:, columns], self._least[columns], self._most[columns])
        return values
