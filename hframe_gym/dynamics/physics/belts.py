"""Belts: extension, stiffness, tension and forces on the coordinates; see `equations` for the formulas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ...machine import AppliedEffect
from ..symbolic.elementwise import fma, named
from ..symbolic.tracing import Expression
from .parameterized_machine import IndexRow, MotionPoint, ParameterizedMachine, Value


class BeltState(NamedTuple):
    """State of one belt.

    Attributes:
        extension: Extension s, m.
        rate: Rate ds/dt, m/s.
        stiffness: Stiffness k = EA / l, N/m, with the length l, m.
        tension: Tension T beyond the pretension, N.
        stiffness_force: Force e = -(1/2) s^2 dk/dl, N, due to the change of stiffness with length; 0 for
            constant k.
        net_tension: T - e, N: force of the belt on a coordinate that changes extension and length by equal
            amounts.
    """

    extension: Value
    rate: Value
    stiffness: Value
    tension: Value
    stiffness_force: Value
    net_tension: Value


class BeltEquations(ParameterizedMachine):
    """Equations of the belts of one machine.

    Args:
        values: Parameter values (floats, arrays or symbolic expressions) by full name, for example "left.EA";
            other parameters keep the machine's values.
    """

    @property
    def nonlinear_belts(self) -> bool:
        """Whether an effect makes the force of a belt nonlinear.

        The integrator then evaluates the belts at both points of a step; otherwise it extrapolates their
        forces from the half-way point with constant stiffness.
        """
        return any(e.definition.tension or e.definition.belt_travel for e in self.machine.effects)

    def belt_states(self, point: MotionPoint) -> list[BeltState]:
        """Return extension, stiffness and tension of each belt (eq. 38-44 of Sollmann et al. 2010)."""
        travel = [self._belt_travel(i, point) for i in range(len(point.travel))]  # with eccentric pulleys
        speed = [v * arm for v, arm in zip(point.speed, self._lever_arms(point), strict=True)]
        extensions, lengths = [], {}
        for b, (row, length_row) in enumerate(zip(self.extension_rows, self.length_rows, strict=True)):
            if not length_row:
                extensions.append(named("extension", b, combination(row, travel)))
                continue
            # The carriage's displacement changes extension and length equally; motors change the extension
            # only.
            displacement = named("displacement", b, combination(length_row, travel))
            shared = all(row.get(i) == factor for i, factor in length_row.items())
            rest = {i: factor for i, factor in row.items() if not shared or i not in length_row}
            extension = add_combination(displacement, rest, travel) if shared else combination(rest, travel)
            extensions.append(named("extension", b, extension))
            rest_length = self.parameter(f"{self.machine.belts[b].name}.rest_length")
            lengths[b] = named("length", b, rest_length + displacement)
        per_length = {  # 1/l
            b: named("per_length", b, value)
            for b, value in zip(lengths, reciprocals(list(lengths.values())), strict=True)
        }
        rates = [combination(row, speed) for row in self.extension_rows]
        return [self._belt_state(b, s, rates[b], per_length.get(b), point) for b, s in enumerate(extensions)]

    def constant_stiffness(self, b: int) -> Value:
        """Return the stiffness EA / rest length, N/m, of a belt whose length does not depend on position."""
        name = self.machine.belts[b].name
        return self.parameter(f"{name}.EA") / self.parameter(f"{name}.rest_length")

    def _belt_state(
        self, b: int, extension: Value, rate: Value, per_length: Value | None, point: MotionPoint
    ) -> BeltState:
        """Return the state of belt b; per_length: 1/l, 1/m, None for constant stiffness."""
        s, name = extension, self.machine.belts[b].name
        k = self.constant_stiffness(b) if per_length is None else self.parameter(f"{name}.EA") * per_length
        k = named("stiffness", b, k)
        linear = k * s
        tension = linear
        tension_effects = list(self.effects_at("tension", name))
        for j, e in tension_effects:
            quantities = {"s": s, "rate": rate, "k": k}
            if (i := self.instances[j].coordinate) >= 0:
                quantities["per_radius"] = self.per_radius(i)
            if e.definition.damping and point.elapsed is not None:
                quantities["rate"] = self._mean_rate(b, e, quantities, point, 2.0 * point.elapsed)
            tension = tension + (self.evaluate(e, "tension", quantities) - linear)
        tension = named("tension", b, tension)
        if per_length is None:
            return BeltState(s, rate, k, tension, 0.0, tension)
        effects = self.effects_at("energy_slope", name)
        slopes = [self.evaluate(e, "energy_slope", {"s": s, "k": k}) for _, e in effects]
        if slopes:  # dV/dk in place of s^2/2
            slope = slopes[0]
            for more in slopes[1:]:
                slope = slope + (more - 0.5 * s * s)
            force = named("stiffness_force", b, slope * k * per_length)
            return BeltState(s, rate, k, tension, force, named("net_tension", b, tension - force))
        strain = named("strain", b, s * per_length)
        elastic = linear if tension_effects else tension  # damping stores no energy
        net = named("net_tension", b, fma(-0.5 * strain, elastic, tension))
        return BeltState(s, rate, k, tension, 0.5 * strain * elastic, net)

    def _mean_rate(
        self, b: int, effect: AppliedEffect, quantities: Mapping[str, Value], point: MotionPoint, step: Value
    ) -> Value:
        """Return the rate of belt b, m/s, that a damper feels in the mean over an integration `step`, s.

        With x = h c (G^2/m), the step h in units of the time in which the damper c alone brakes the belt, the
        rate r at the beginning and the change g by all other forces, the mean rate is

            (1 - x share) r + share g,    share = (1 + x) / (2 + 2 x + x^2),

        so that the damper alone leaves 1 / (1 + x + x^2/2) of the rate: of second order for small x, and at
        rest, without overshoot, for large x. At the half-way point, g is not known yet, and left out.
        """
        row, rate = self.extension_rows[b], quantities["rate"]
        squared = {i: factor * factor for i, factor in row.items()}
        per_mass = combination(squared, [1.0 / self.mass(i) for i in range(len(point.travel))])
        x = step * per_mass * self.evaluate(effect, "damping", quantities)
        share = (1.0 + x) / (2.0 + x * (2.0 + x))
        if point.gained is None:
            return 2.0 * share * rate
        gained = combination(row, point.gained)
        rate = rate - 0.5 * gained
        half_way = {"s": quantities["s"] - (1.0 / 12.0) * step * gained, "rate": 2.0 * share * rate}
        # What the contact has in `gained` is replaced by its elastic part at this point.
        change = self.evaluate(effect, "tension", {**quantities, **half_way}) - self.evaluate(
            effect, "tension", {**quantities, "rate": 0.0}
        )
        return (1.0 - x * share) * rate + share * (gained + step * per_mass * change)

    def _pulley_quantities(self, k: int, i: int, point: MotionPoint) -> dict[str, Value]:
        return {
            "q": self.position(point, i),
            "z": self.effect_state(k, point),
            "per_radius": self.per_radius(i),
        }

    def _belt_travel(self, i: int, point: MotionPoint) -> Value:
        """Return the travel of coordinate i for the belts, m, with the part that an eccentric pulley adds."""
        travel = point.travel[i]
        for k, e in self.effects_on("belt_travel", i):
            travel = travel + self.evaluate(e, "belt_travel", self._pulley_quantities(k, i, point))
        return travel

    def _lever_arms(self, point: MotionPoint) -> list[Value]:
        """Return d(belt travel)/d(travel) of each coordinate: 1 except for eccentric pulleys."""
        arms: list[Value] = []
        for i in range(len(point.travel)):
            effects = list(self.effects_on("lever_arm", i))
            added = [self.evaluate(e, "lever_arm", self._pulley_quantities(k, i, point)) for k, e in effects]
            arms.append(1.0 + sum(added[1:], added[0]) * self.per_radius(i) if added else 1.0)
        return arms

    def belt_forces(self, point: MotionPoint, belts: Sequence[BeltState]) -> list[Value]:
        """Return the force of the belts on each coordinate, N: -G' T - (1/2) s^2 dk/dp.

        Here p is the belt travel, s the extension, k the stiffness, T the tension, and G = ds/dp.
        """
        forces = []
        for i, arm in enumerate(self._lever_arms(point)):
            row: dict[int, float] = {}  # factor of each of the terms
            terms: list[Value] = []
            for b, belt in enumerate(belts):
                stretch, lengthen = (rows[b].get(i, 0.0) for rows in (self.extension_rows, self.length_rows))
                if lengthen and lengthen == stretch:  # `net_tension` combines both terms
                    parts = [(-stretch, belt.net_tension)]
                else:
                    parts = [(-stretch, belt.tension), (lengthen, belt.stiffness_force)]
                for factor, value in parts:
                    if factor:
                        row[len(terms)] = factor
                        terms.append(value)
            forces.append(combination(row, terms) * arm)
        return forces


def combination(row: IndexRow, values: Sequence[Value]) -> Value:
    """Return the sum of row[i] * values[i] over the indices i in `row`; 0.0 without any.

    Terms with positive factors come first, because generated code with a minus at the beginning costs an
    instruction.
    """
    terms = sorted(((i, factor) for i, factor in row.items() if factor), key=lambda term: term[1] < 0)
    if not terms:
        return 0.0
    i, factor = terms[0]
    first = values[i] if factor == 1.0 else -values[i] if factor == -1.0 else factor * values[i]
    return add_combination(first, dict(terms[1:]), values)


def add_combination(total: Value, row: IndexRow, values: Sequence[Value]) -> Value:
    """Return total + the sum of row[i] * values[i] over the indices i in `row`."""
    for i, factor in sorted(row.items(), key=lambda term: term[1] < 0):
        size = values[i] if abs(factor) == 1.0 else abs(factor) * values[i]
        total = total - size if factor < 0 else total + size
    return total


def reciprocals(values: Sequence[Value]) -> list[Value]:
    """Return the reciprocals of values; a simulation kernel uses one division for up to three of them.

    A division costs as much as ten multiplications. With p = 1 / (a b c), the reciprocals are 1/a = p c b,
    1/b = p c a and 1/c = p a b. They may differ from the results of separate divisions in the last digits.
    """
    if not any(isinstance(value, Expression) for value in values):  # no kernel is being generated
        return [1.0 / value for value in values]
    results: list[Value] = []
    for start in range(0, len(values), 3):
        match list(values[start : start + 3]):
            case [a, b, c]:
                product = a * b
                per_product = 1.0 / (product * c)
                results += [per_product * c * b, per_product * c * a, per_product * product]
            case [a, b]:
                per_product = 1.0 / (a * b)
                results += [per_product * b, per_product * a]
            case [a]:
                results += [1.0 / a]
    return results
