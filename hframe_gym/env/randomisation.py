"""Randomised machines: a field of the machine x a distribution x scale, add or set x reset or startup.

    Vary("*.coulomb", Uniform(0.5, 2.0))                          each Coulomb level on its own, every episode
    Vary("*.EA", Uniform(0.7, 1.3), shared=True)                  one draw for all belts
    Vary("x.mass", Normal(0.0, 0.1), how="add", when="startup")   once a seed

Draws come from the environment's own generator, so a seed fixes them; they are in the reset's info.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine

Array = NDArray[np.float64]
Source = Literal["uniform", "normal"]
How = Literal["scale", "add", "set"]
When = Literal["reset", "startup"]
# Least share of its nominal value that a parameter which must stay positive can be drawn to.
LEAST_SHARE = 0.05


@dataclass(frozen=True)
class Uniform:
    """Uniform on [low, high)."""

    low: float
    high: float
    source: ClassVar[Source] = "uniform"

    def __call__(self, u: Array) -> Array:
        return self.low + (self.high - self.low) * u


@dataclass(frozen=True)
class LogUniform:
    """Uniform in the logarithm on [low, high), both positive."""

    low: float
    high: float
    source: ClassVar[Source] = "uniform"

    def __call__(self, u: Array) -> Array:
        width = math.log(self.high / self.low)
        # One by one: NumPy's vector exponential may round differently with the batch's size.
        return np.array([self.low * math.exp(width * v) for v in u.tolist()])


@dataclass(frozen=True)
class Normal:
    """Normal with a mean and a standard deviation."""

    mean: float
    std: float
    source: ClassVar[Source] = "normal"

    def __call__(self, z: Array) -> Array:
        return self.mean + self.std * z


Distribution: TypeAlias = Uniform | LogUniform | Normal


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


@dataclass(frozen=True)
class Identified:
    """Joint normal draws around the machine's own values from its identified covariance, times `widen` (in std)."""

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
    return rules


def _columns(machine: Machine, rule: Vary) -> list[int]:
    """Places in `Machine.parameters` that a rule speaks of."""
    return [i for i, name in enumerate(machine.parameters) if fnmatchcase(name, rule.parameter)]


def limits(machine: Machine) -> tuple[Array, Array]:
    """The least and the greatest value (P,) that each parameter can be drawn to."""
    bounds = {f"{e.label}.{p.name}": (p.lower, p.upper) for e in machine.effects for p in e.definition.parameters}
    low, high = [], []
    for name, value in machine.parameters.items():
        may_vanish = name.endswith((".viscous", ".coulomb"))
        below, above = bounds.get(name, (0.0 if may_vanish else min(LEAST_SHARE * value, value), math.inf))
        low.append(below)
        high.append(above)
    return np.array(low), np.array(high)


class Sampler:
    """Draws the parameters of a machine by the rules for one occasion (reset or startup).

    names: the parameters that change.  uniforms, normals: how many random numbers one draw takes.

    Raises ValueError naming the rule that fits no parameter, or that can leave a parameter's limits.
    """

    def __init__(self, machine: Machine, rules: Sequence[Rule], when: When) -> None:
        self._all = list(machine.parameters)
        self._low, self._high = limits(machine)
        self.uniforms = self.normals = 0
        self._varied: list[tuple[int, int, Vary]] = []  # column of the parameter, of its random number, rule
        self._joint: list[tuple[list[int], int, Array]] = []  # columns, first random number, factor of the covariance
        for rule in rules:
            if rule.when == when:
                if isinstance(rule, Vary):
                    self._add(machine, rule)
                else:
                    self._add_identified(machine, rule)
        touched = {c for c, _, _ in self._varied} | {c for columns, _, _ in self._joint for c in columns}
        self._columns = sorted(touched)
        self.names = tuple(self._all[c] for c in self._columns)

    def _take(self, source: Source, count: int) -> int:
        first = self.uniforms if source == "uniform" else self.normals
        if source == "uniform":
            self.uniforms += count
        else:
            self.normals += count
        return first

    def _add(self, machine: Machine, rule: Vary) -> None:
        columns = _columns(machine, rule)
        if not columns:
            raise ValueError(f"randomize: machine {machine.name!r} has no parameter {rule.parameter!r}")
        if rule.how not in ("scale", "add", "set"):
            raise ValueError(f"randomize: {rule.parameter!r} has how = {rule.how!r}, choose scale, add or set")
        self._check_limits(machine, rule, columns)
        first = self._take(rule.distribution.source, 1 if rule.shared else len(columns))
        for i, column in enumerate(columns):
            self._varied.append((column, first if rule.shared else first + i, rule))

    def _check_limits(self, machine: Machine, rule: Vary, columns: list[int]) -> None:
        """Bounded distributions must stay inside; a normal's tail is clipped instead."""
        d = rule.distribution
        if isinstance(d, Normal):
            return
        if not d.low <= d.high or (isinstance(d, LogUniform) and not d.low > 0.0):
            raise ValueError(f"randomize: {rule.parameter!r} has the distribution {d}, which is empty")
        for column in columns:
            nominal = machine.parameters[self._all[column]]
            for edge in (d.low, d.high):
                value = float(_apply(rule, np.array([nominal]), np.array([edge]))[0])
                if not self._low[column] <= value <= self._high[column]:
                    raise ValueError(
                        f"randomize: {rule.parameter!r} can make {self._all[column]} = {value:g}, outside "
                        f"[{self._low[column]:g}, {self._high[column]:g}]"
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
        self._joint.append((columns, self._take("normal", len(columns)), factor))

    def draw(self, base: Array, uniforms: Array, normals: Array) -> Array:
        """Parameters (k, P) from base values (k, P), uniforms (k, uniforms) and normals (k, normals)."""
        values = base.copy()
        shared: dict[int, Array] = {}  # a rule's draws, so that those shared are worked out once
        for column, number, rule in self._varied:
            source = uniforms if rule.distribution.source == "uniform" else normals
            key = number if rule.distribution.source == "uniform" else -1 - number
            if key not in shared:
                shared[key] = rule.distribution(source[:, number])
            values[:, column] = _apply(rule, values[:, column], shared[key])
        for columns, first, factor in self._joint:
            for i, column in enumerate(columns):
                # Summed term by term: a matrix product may add in another order for another batch.
                for j in range(len(columns)):
                    values[:, column] += factor[i, j] * normals[:, first + j]
        own = self._columns
        values[:, own] = np.clip(values[:, own], self._low[own], self._high[own])
        return values


def _apply(rule: Vary, value: Array, drawn: Array) -> Array:
    if rule.how == "scale":
        return value * drawn
    return value + drawn if rule.how == "add" else drawn
