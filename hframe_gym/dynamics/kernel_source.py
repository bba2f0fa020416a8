"""Writes the source of a machine's kernel from its tables.

What is the same for all machines of one *shape* (which coordinates, rows of G and of the belt lengths, where drives
and effects sit) becomes text: zeros vanish, ones become additions, an effect that is not there costs nothing.  What
differs between them (every number of `Machine.parameters`) is data, a row of lanes each.

One step of length h, from travel q and velocity v (SI, travel in m):

    1. forces f at the half-way point q + h/2 v; from them the acceleration a (zero where friction holds).
    2. forces again at q + h/2 v + h^2/12 a.  Position Verlet's frequency error, (omega h)^2/24, cancels
       (Takahashi and Imada 1984; Chin 1997); speed-dependent friction is taken at v + h/2 a.
    3. exact flow of m v' = f - b v - F sign v (friction.py), and its exact travel: weights `first` and `last` of the
       two velocities instead of Verlet's halves, so that strong damping costs no accuracy.

Second order, symmetric but for the weights, two force evaluations and one division for the belts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..machine.machine import Machine
from .effect_codegen import CORRECTED, HALF_WAY, Contributions, Point
from .source_text import combination, identifier, plus

# Rows of derived numbers that `prepare` writes for each coordinate; those of PER_DIRECTION twice where they differ.
PER_COORDINATE = ("mass", "per_mass", "coulomb", "curve")
PER_DIRECTION = ("viscous", "slow", "decay", "gain", "first", "last")


@dataclass(frozen=True)
class Layout:
    """Where each number lies: rows of the parameter block P and of the derived block C."""

    parameters: dict[str, int]
    derived: dict[str, int]


class KernelSource:
    """The source text of one machine shape.  `text` is complete but for imports and contributions' sources."""

    def __init__(self, machine: Machine, *, forced: bool) -> None:
        self.machine = machine
        self.forced = forced
        self.names = [identifier(n) for n in machine.coordinate_names]
        self.parameters = {name: i for i, name in enumerate(machine.parameters)}
        self.effects = Contributions(machine, self.p)
        self.derived: dict[str, int] = {}
        for c in machine.coordinate_names:
            keys = PER_COORDINATE + tuple(f"{k}{s}" for s in self.signs(c) for k in PER_DIRECTION)
            for key in keys:
                self.derived[f"{c}.{key}"] = len(self.derived)
        for d in machine.drives:
            self.derived[f"{d.name}.force"] = len(self.derived)
        for b in machine.belts:
            if not b.length:
                self.derived[f"{b.name}.stiffness"] = len(self.derived)

    @property
    def layout(self) -> Layout:
        return Layout(self.parameters, self.derived)

    @property
    def text(self) -> str:
        parts = (self.prepare(), self.delays(), self.advance(), self.read_sensors(), self.lags())
        return "\n\n".join(parts) + "\n"

    @property
    def states(self) -> int:
        """Rows of a state: travel and velocity of each coordinate, the clock, effects' own."""
        return 2 * len(self.names) + 1 + len(self.effects.states)

    # -- names -----------------------------------------------------------------------------------------------------

    def signs(self, coordinate: str) -> tuple[str, ...]:
        return ("", "_back") if coordinate in self.effects.directional else ("",)

    def p(self, name: str) -> str:
        """The source of a number of the tables, or of an effect, by its full name."""
        if name in self.machine.ties:
            owner, factor = self.machine.ties[name]
            return f"({factor!r} * {self.p(owner)})"
        return f"load(P, {self.parameters[name]})"

    def is_rotary(self, coordinate: str) -> bool:
        return self.machine.coordinate(coordinate).kind == "rotary"

    # -- derived numbers -------------------------------------------------------------------------------------------

    def prepare(self) -> str:
        """C from P for a step of length h: everything that does not change while parameters and h do not."""
        lines = ["@inlined", "def prepare(P, C, h):"]
        add = lines.append
        for d in self.machine.drives:
            radius = f" / {self.p(d.coordinate + '.radius')}" if self.is_rotary(d.coordinate) else ""
            gear, Kt, Ke, R = (self.p(f"{d.name}.{k}") for k in ("gear_ratio", "Kt", "Ke", "resistance"))
            name = identifier(d.name)
            add(f"    gain_{name} = {gear} * {Kt} / {R}")
            add(f"    emf_{name} = gain_{name} * {gear} * {Ke}")
            add(f"    store(C, {self.derived[d.name + '.force']}, gain_{name}{radius})")
        for c in self.machine.coordinate_names:
            lines += self.prepare_coordinate(c)
        for b in self.machine.belts:
            if not b.length:
                ratio = f"{self.p(b.name + '.EA')} / {self.p(b.name + '.rest_length')}"
                add(f"    store(C, {self.derived[b.name + '.stiffness']}, {ratio})")
        return "\n".join(lines)

    def prepare_coordinate(self, c: str) -> Iterable[str]:
        yield f"    radius = {self.p(c + '.radius') if self.is_rotary(c) else '1.0'}"
        yield f"    mass = {self.p(c + '.mass')} / (radius * radius)"
        yield f"    store(C, {self.derived[c + '.mass']}, mass)"
        yield f"    store(C, {self.derived[c + '.per_mass']}, 1.0 / mass)"
        yield f"    store(C, {self.derived[c + '.coulomb']}, {self.p(c + '.coulomb')} / radius)"
        yield f"    store(C, {self.derived[c + '.curve']}, h * h / 12.0 / mass)"
        for sign in self.signs(c):
            friction = self.p(c + ".viscous")
            for k, e in self.effects.on("viscous", c):
                direction = "-1.0" if sign else "1.0"
                friction = self.effects.call("viscous", k, e, {"b": friction, "direction": direction}, inline=True)
            emf = "".join(f" + emf_{identifier(d.name)}" for d in self.machine.drives if d.coordinate == c)
            yield f"    viscous = ({friction}{emf}) / (radius * radius)"
            yield "    z = viscous * h / mass"
            yield "    weight = end_weight(z)"
            forces = ("viscous", "-h * h / 12.0 / mass * viscous", "exp(-z)", "h / mass * decay_integral(z)")
            values = (*forces, "h * (1.0 - weight)", "h * weight")
            for key, value in zip(PER_DIRECTION, values, strict=True):
                yield f"    store(C, {self.derived[f'{c}.{key}{sign}']}, {value})"

    def delays(self) -> str:
        """D, the time by which each input's voltage arrives late, s."""
        lines = ["@inlined", "def delays(P, D):"]
        for i, d in enumerate(self.machine.drives):
            late = self.effects.at("delay", d.name, "drives")
            terms = [self.effects.call("delay", k, e, {}, inline=True) for k, e in late]
            lines.append(f"    store(D, {i}, {' + '.join(terms) or '0.0'})")
        return "\n".join(lines)

    # -- sensors -----------------------------------------------------------------------------------------------------

    def read_sensors(self) -> str:
        """R, what every sensor shows, in its own unit."""
        lines = ["@inlined", "def read_sensors(S, P, R):"]
        for i, c in enumerate(self.machine.coordinate_names):
            radius = f" / {self.p(c + '.radius')}" if self.is_rotary(c) else ""
            lines.append(f"    q_{identifier(c)} = load(S, {i}){radius}")

        def position(key: str) -> str:
            return " * ".join(f"q_{identifier(c)}" for c in key.split("*"))

        for j, sensor in enumerate(self.machine.sensors):
            lines.append(f"    r = {combination(sensor.row, position)}")
            other = self.machine.across(sensor.coordinate)
            across = f"q_{identifier(other)}" if other else ""
            for k, e in self.effects.at("reading", sensor.channel):
                lines.append(f"    r = {self.effects.call('reading', k, e, {'r': 'r', 'across': across}, inline=True)}")
            lines.append(f"    store(R, {j}, r)")
        return "\n".join(lines)

    def lags(self) -> str:
        """L, the time by which each sensor is late, s."""
        lines = ["@inlined", "def lags(P, L):"]
        for j, sensor in enumerate(self.machine.sensors):
            late = self.effects.at("lag", sensor.channel)
            terms = [self.effects.call("lag", k, e, {}, inline=True) for k, e in late]
            lines.append(f"    store(L, {j}, {' + '.join(terms) or '0.0'})")
        return "\n".join(lines)

    # -- the step --------------------------------------------------------------------------------------------------

    def advance(self) -> str:
        """`steps` steps of length h of one block of lanes, in place."""
        lines = ["@inlined", "def advance(S, P, C, U, W, h, steps):", "    align_stack()"]
        lines += [f"    {line}" for line in self.read()]
        lines += ["    for step in range(steps):"]
        lines += [f"        {line}" for line in self.step()]
        lines += [f"    {line}" for line in self.write()]
        return "\n".join(lines)

    def read(self) -> Iterable[str]:
        n = len(self.names)
        for i, c in enumerate(self.names):
            yield f"q_{c} = load(S, {i})"
            yield f"v_{c} = load(S, {n + i})"
        yield f"time = load(S, {2 * n})"
        for name, row in self.derived.items():
            yield f"{identifier(name)} = load(C, {row})"
        for row, k in enumerate(self.effects.states):
            yield f"z_{k} = load(S, {2 * n + 1 + row})"
        yield from self.effects.loads()
        for b in self.machine.belts:
            if b.length:
                yield f"{identifier(b.name)}_EA = {self.p(b.name + '.EA')}"
                yield f"{identifier(b.name)}_rest_length = {self.p(b.name + '.rest_length')}"
        yield "half = 0.5 * h"

    def write(self) -> Iterable[str]:
        n = len(self.names)
        for i, c in enumerate(self.names):
            yield f"store(S, {i}, q_{c})"
            yield f"store(S, {n + i}, v_{c})"
        yield f"store(S, {2 * n}, time{'' if self.effects.moving else ' + h * steps'})"
        for row, k in enumerate(self.effects.states):
            yield f"store(S, {2 * n + 1 + row}, z_{k})"

    def step(self) -> Iterable[str]:
        yield "# half-way"
        for c in self.names:
            yield f"m_{c} = fma(half, v_{c}, q_{c})"
        yield from self.effects.voltages(self.voltage)
        yield from self.belts(HALF_WAY)
        yield "# forces at the half-way point, and the acceleration they give"
        yield from self.forces(HALF_WAY)
        if not self.effects.bent:
            for name in map(identifier, sorted(self.effects.moving)):
                yield f"bare_{name} = f_{name}"
        yield from self.effects.forces(HALF_WAY)
        for c in self.machine.coordinate_names:
            yield from self.acceleration(c)
        yield "# forces again, where that acceleration leads"
        if self.effects.bent:
            yield from self.belts(CORRECTED)
            yield from self.forces(CORRECTED)
        else:
            yield from self.correction()
        yield from self.effects.forces(CORRECTED)
        yield "# exact flow with friction"
        for c in self.names:
            yield from self.flow(c)
        for c in self.names:
            yield f"if any_of(stop_{c}):"
            yield from (f"    {line}" for line in self.event(c))
        yield from self.effects.ends()
        for c in self.names:
            yield f"q_{c} = n_{c}"
            yield f"v_{c} = u_{c}"
        if self.effects.moving:
            yield "time = time + h"

    def belts(self, point: Point) -> Iterable[str]:
        """Tension, stiffness and the pull towards longer belts, by 1/2 s^2 dk/dq = -T s / (2 length)."""
        lengths = []

        def travel(c: str) -> str:
            return self.effects.stretched(c, point)

        def speed(c: str) -> str:
            own, arm = f"{point.velocity}_{identifier(c)}", self.effects.arm(c, point)
            return f"({own} * {arm})" if arm else own

        for b in self.machine.belts:
            name = identifier(b.name)
            rest = dict(b.extension)
            shared = ""
            if b.length and all(b.extension.get(c) == factor for c, factor in b.length.items()):
                # s and length share the carriage's part: worked out once.
                yield f"run_{name} = {combination(b.length, travel)}"
                rest = {c: factor for c, factor in b.extension.items() if c not in b.length}
                shared = f"run_{name}"
            own = combination(rest, travel)
            yield f"s_{name} = {f'{shared} {plus(own)}' if shared and rest else shared or own}"
            if b.length:
                along = shared or combination(b.length, travel)
                yield f"length_{name} = {name}_rest_length + {along}"
                lengths.append(name)
        yield from self.reciprocals(lengths)
        for b in self.machine.belts:
            name = identifier(b.name)
            if b.length:
                yield f"stiffness_{name} = {name}_EA * per_{name}"
            else:
                yield f"stiffness_{name} = {name}_stiffness"
            yield f"T_{name} = stiffness_{name} * s_{name}"
            rate = combination(b.extension, speed)
            yield from self.effects.tension(b.name, f"s_{name}", f"({rate})", f"stiffness_{name}")
            if b.length:
                growth = self.effects.growth(b.name, f"s_{name}", f"stiffness_{name}")
                if growth:
                    yield f"e_{name} = {growth} * stiffness_{name} * per_{name}"
                    yield f"net_{name} = T_{name} - e_{name}"
                    continue
                yield f"half_strain_{name} = 0.5 * (s_{name} * per_{name})"
                if all(b.extension.get(c) == factor for c, factor in b.length.items()):
                    yield f"net_{name} = fma(-half_strain_{name}, T_{name}, T_{name})"
                else:
                    yield f"e_{name} = half_strain_{name} * T_{name}"
                    yield f"net_{name} = T_{name} - e_{name}"

    def reciprocals(self, lengths: list[str]) -> Iterable[str]:
        """1/length of up to three belts at a time by one division, which costs as much as ten products."""
        for group in (lengths[i : i + 3] for i in range(0, len(lengths), 3)):
            if len(group) == 1:
                yield f"per_{group[0]} = 1.0 / length_{group[0]}"
                continue
            a, b, *rest = group
            yield f"pair_{a} = length_{a} * length_{b}"
            if rest:
                yield f"whole_{a} = 1.0 / (pair_{a} * length_{rest[0]})"
                yield f"per_{rest[0]} = whole_{a} * pair_{a}"
                yield f"rest_{a} = whole_{a} * length_{rest[0]}"
            else:
                yield f"rest_{a} = 1.0 / pair_{a}"
            yield f"per_{a} = rest_{a} * length_{b}"
            yield f"per_{b} = rest_{a} * length_{a}"

    def forces(self, point: Point) -> Iterable[str]:
        """Forces on the coordinates: -G' T + L' (T s / 2 length) + drives (+ what the caller adds)."""
        for c in self.machine.coordinate_names:
            row: dict[str, float] = {}
            for b in self.machine.belts:
                name = identifier(b.name)
                stretch, grow = b.extension.get(c, 0.0), b.length.get(c, 0.0)
                if grow and grow == stretch:
                    row[f"net_{name}"] = -stretch
                else:
                    row |= {f"T_{name}": -stretch, f"e_{name}": grow}
            text = combination(row, str)
            arm = self.effects.arm(c, point)
            if arm:
                text = f"({text}) * {arm}"
            for j, d in enumerate(self.machine.drives):
                if d.coordinate == c:
                    volts = f"volts_{identifier(d.name)}" if self.effects.commanded(j) else self.voltage(j)
                    text = f"fma({identifier(f'{d.name}.force')}, {volts}, {text})"
            if self.forced:
                text += f" + load(W, {self.machine.coordinate_names.index(c)})"
            yield f"f_{identifier(c)} = {text}"

    def voltage(self, j: int) -> str:
        """Drive j's voltage during this step."""
        row = f"step * {len(self.machine.drives)} + {j}" if self.effects.delayed else str(j)
        return f"load(U, {row})"

    def acceleration(self, c: str) -> Iterable[str]:
        name = identifier(c)
        if c in self.effects.directional:
            yield f"d_{name} = direction(v_{name}, f_{name})"
        slow = self.by_direction(c, "slow")
        yield f"a_{name} = fma({name}_curve, f_{name} - answer(v_{name}, f_{name}, F_{name}), {slow} * v_{name})"
        if self.effects.bent or c in self.effects.seen:
            yield f"k_{name} = m_{name} + a_{name}"
            yield f"w_{name} = v_{name} + (6.0 / h) * a_{name}"

    def correction(self) -> Iterable[str]:
        """Belt forces after the displacement h^2/12 a, by the stiffness at the half-way point."""
        for b in self.machine.belts:
            name = identifier(b.name)
            stretch = combination(b.extension, lambda c: f"a_{identifier(c)}")
            yield f"g_{name} = stiffness_{name} * ({stretch})"
        for c in self.machine.coordinate_names:
            name = identifier(c)
            row = {identifier(b.name): -b.extension.get(c, 0.0) for b in self.machine.belts}
            base = f"bare_{name}" if c in self.effects.moving else f"f_{name}"
            yield f"f_{name} = {base} + ({combination(row, lambda b: f'g_{b}')})"

    def by_direction(self, c: str, key: str, *, back: bool = False) -> str:
        name = identifier(c)
        if c not in self.effects.directional:
            return f"{name}_{key}"
        ahead, behind = (f"{name}_{key}", f"{name}_{key}_back")
        return f"where(d_{name} >= 0.0, {behind if back else ahead}, {ahead if back else behind})"

    def flow(self, name: str) -> Iterable[str]:
        c = self.machine.coordinate_names[self.names.index(name)]
        if c in self.effects.directional:
            yield f"d_{name} = direction(v_{name}, f_{name})"
        decay, gain = (self.by_direction(c, key) for key in ("decay", "gain"))
        yield f"u_{name}, stop_{name} = kick(v_{name}, f_{name}, F_{name}, {decay}, {gain})"
        first, last = (self.by_direction(c, key) for key in ("first", "last"))
        yield f"n_{name} = fma({last}, u_{name}, fma({first}, v_{name}, q_{name}))"

    def event(self, name: str) -> Iterable[str]:
        c = self.machine.coordinate_names[self.names.index(name)]
        viscous = f"{self.by_direction(c, 'viscous')}, {self.by_direction(c, 'viscous', back=True)}"
        state = f"v_{name}, f_{name}, F_{name}"
        yield f"after_{name}, travel_{name} = reverse({state}, {viscous}, {name}_mass, {name}_per_mass, h)"
        yield f"u_{name} = where(stop_{name}, after_{name}, u_{name})"
        yield f"n_{name} = where(stop_{name}, q_{name} + travel_{name}, n_{name})"
