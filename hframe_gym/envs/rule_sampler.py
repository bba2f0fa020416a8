"""Draws a machine's parameters by the rules of `randomisation`, within limits that no machine can leave."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from ..machine import Machine
from .domain_randomization import RandomizeIdentified, RandomizeParameter, Rule, When, matching

Array = NDArray[np.float64]
# Least share of its nominal value that a parameter which must stay positive can be drawn to.
LEAST_SHARE = 0.05
# The outermost uniform numbers that `draws` makes.
_EDGES = np.array([0.5 * 2.0**-53, 1.0 - 0.5 * 2.0**-53])


def limits(machine: Machine) -> tuple[Array, Array]:
    """The least and the greatest value (P,) that each parameter can be drawn to.

    Friction may vanish; a belt keeps `LEAST_SHARE` of its length wherever the carriage can be; all else that is
    positive keeps that share of its nominal value; effects' parameters have bounds of their own.
    """
    bounds = {f"{e.label}.{p.name}": (p.lower, p.upper) for e in machine.effects for p in e.definition.parameters}
    for belt in machine.belts:
        ranges = {c: machine.coordinate(c).range or (0.0, 0.0) for c in belt.length}
        shortest = sum(min(factor * end for end in ranges[c]) for c, factor in belt.length.items())
        owner, factor = machine.ties.get(f"{belt.name}.rest_length", (f"{belt.name}.rest_length", 1.0))
        least = (LEAST_SHARE * belt.rest_length - shortest) / factor
        bounds[owner] = (max(least, bounds.get(owner, (0.0, 0.0))[0]), math.inf)
    low, high = [], []
    for name, value in machine.parameters.items():
        may_vanish = name.endswith((".viscous", ".coulomb"))
        below, above = bounds.get(name, (0.0 if may_vanish else min(LEAST_SHARE * value, value), math.inf))
        low.append(below)
        high.append(above)
    return np.array(low), np.array(high)


class RuleSampler:
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
        # Lengths that sections of a belt are tied to (idlers): the shortest section leaves them less room than a rule
        # for the whole belt knows of, so draws end where it does.
        self._ending = {self._all.index(owner) for tied, (owner, _) in machine.ties.items() if _is_length(tied)}
        self.draws = 0
        self._varied: list[
            tuple[int, int, RandomizeParameter]
        ] = []  # column of the parameter, of its random number, rule
        self._joint: list[tuple[list[int], int, Array]] = []  # columns, first random number, factor of the covariance
        for rule in rules:
            if rule.when == when:
                if isinstance(rule, RandomizeParameter):
                    self._add(machine, rule)
                else:
                    self._add_identified(machine, rule)
        touched = {c for c, _, _ in self._varied} | {c for columns, _, _ in self._joint for c in columns}
        self.names = tuple(self._all[c] for c in sorted(touched))

    def _take(self, count: int) -> int:
        first = self.draws
        self.draws += count
        return first

    def _add(self, machine: Machine, rule: RandomizeParameter) -> None:
        columns = matching(machine, rule)
        if not columns:
            raise ValueError(f"randomize: machine {machine.name!r} has no parameter {rule.parameter!r}")
        first = self._take(1 if rule.shared else len(columns))
        for i, column in enumerate(columns):
            self._varied.append((column, first if rule.shared else first + i, rule))
            self._widen(column, rule)

    def _widen(self, column: int, rule: RandomizeParameter) -> None:
        """What the rule can make of the parameter; all four corners, for a scale may be negative."""
        edges = rule.distribution.quantile(_EDGES)
        before = np.array([self.low[column], self.high[column]])
        corners = np.concatenate([rule.apply(before, np.full(2, edge)) for edge in edges])
        if rule.distribution.bounded and column not in self._ending:
            for value in (corners.min(), corners.max()):
                self._refuse(rule, column, value, "can make")
        least, most = self._least[column], self._most[column]
        self.low[column], self.high[column] = np.clip([corners.min(), corners.max()], least, most)

    def _refuse(self, rule: RandomizeParameter, column: int, value: float, how: str) -> None:
        """Raises ValueError for a value outside the parameter's limits (which two roundings may reach)."""
        least, most = self._least[column], self._most[column]
        room = 1e-12 * max(abs(least), abs(value))
        if not least - room <= value <= most + room:
            raise ValueError(
                f"randomize: the rule {rule} {how} {self._all[column]} = {value:g}, outside [{least:g}, {most:g}]"
                + ("" if rule.distribution.bounded else "; choose a bounded distribution")
            )

    def _add_identified(self, machine: Machine, rule: RandomizeIdentified) -> None:
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
            if column in self._ending:
                drawn = np.clip(drawn, self._least[column], self._most[column])
            elif not rule.distribution.bounded:
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


def _is_length(name: str) -> bool:
    return name.endswith(".rest_length")
