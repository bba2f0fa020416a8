"""Where a machine's effects enter its kernel, as text: each contribution's call with the arguments that it asks for.

A step evaluates forces twice (codegen.py): at the half-way point with the first velocity, then at the corrected point
with the half-way velocity.  `Point` holds the names of what a contribution may see at each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from ..machine.effect import AppliedEffect, asked
from ..machine.machine import Machine
from .source_text import identifier, plus


@dataclass(frozen=True)
class Point:
    """Prefixes of travel and velocity in the kernel's text, and how far into the step they stand."""

    travel: str
    velocity: str
    after: str


HALF_WAY = Point("m", "v", "half")
CORRECTED = Point("k", "w", "half")


class Contributions:
    """The effects of one machine shape; `p` gives the source of a parameter by its full name."""

    def __init__(self, machine: Machine, p: Callable[[str], str]) -> None:
        self.machine = machine
        self.p = p
        self.numbered = list(enumerate(machine.effects))
        self.states = [k for k, e in self.numbered if e.definition.evolve]
        # Coordinates whose force or friction is worked out anew at both points of a step.
        self.moving = {self.coordinate(e) for _, e in self.numbered if self._moves(e)}
        # ... and those that a table of another one looks at.
        variables = (e.definition.against.partition(" of ")[2] for e in machine.effects)
        self.seen = self.moving | {c for c in variables if c}
        self.directional = {e.site for _, e in self.numbered if e.definition.viscous}
        self.delayed = any(e.definition.delay for e in machine.effects)
        self.lagged = any(e.definition.lag for e in machine.effects)
        # Belts whose force is not linear near the half-way point: evaluated in full at both.
        self.bent = any(e.definition.tension or e.definition.travel for e in machine.effects)

    @staticmethod
    def _moves(e: AppliedEffect) -> bool:
        d = e.definition
        return bool(d.force or d.coulomb or d.friction or d.current)

    def coordinate(self, e: AppliedEffect) -> str:
        """The coordinate that an effect acts on: its site's, or the one that its structure added."""
        return e.definition.coordinate or self.machine.site_coordinate(e.site) or e.site

    def at(self, contribution: str, *sites: str) -> Iterator[tuple[int, AppliedEffect]]:
        """Effects with a contribution at one of the sites, with their numbers in the machine."""
        for k, e in self.numbered:
            if getattr(e.definition, contribution) and e.site in sites:
                yield k, e

    def on(self, contribution: str, coordinate: str) -> Iterator[tuple[int, AppliedEffect]]:
        """Effects with a contribution that act on a coordinate."""
        for k, e in self.numbered:
            if getattr(e.definition, contribution) and self.coordinate(e) == coordinate:
                yield k, e

    def call(
        self, contribution: str, k: int, e: AppliedEffect, scope: Mapping[str, str], *, inline: bool = False
    ) -> str:
        """The text of a call; scope: what its arguments are, by name.  inline: parameters straight from their block."""

        def argument(name: str) -> str:
            if name in scope:
                return scope[name]
            full = f"{e.label}.{name}"
            return self.p(full) if inline else identifier(full)

        function = getattr(e.definition, contribution)
        return f"{contribution}_{k}({', '.join(map(argument, asked(function)))})"

    # -- scope -----------------------------------------------------------------------------------------------------

    def scale(self, coordinate: str) -> str:
        """What turns travel into the coordinate's own unit."""
        rotary = self.machine.coordinate(coordinate).kind == "rotary"
        return f" * {identifier(coordinate)}_per_radius" if rotary else ""

    def motion(self, coordinate: str, point: Point) -> dict[str, str]:
        name, scale = identifier(coordinate), self.scale(coordinate)
        return {
            "q": f"{point.travel}_{name}{scale}",
            "v": f"{point.velocity}_{name}{scale}",
            "t": f"time + {point.after}",
        }

    def variable(self, e: AppliedEffect, point: Point, z: str) -> str:
        """The variable of a table: `position of C`, `velocity of C`, `time`, `path of C` (the effect's own state)."""
        kind, _, coordinate = e.definition.against.partition(" of ")
        motion = self.motion(coordinate or self.coordinate(e), point)
        return {"position": motion["q"], "velocity": motion["v"], "time": motion["t"], "path": z}.get(kind, "")

    # -- text ------------------------------------------------------------------------------------------------------

    def loads(self) -> Iterator[str]:
        """Names that stay the same over the steps of a call."""
        for _, e in self.numbered:
            for name in e.parameters:
                yield f"{identifier(f'{e.label}.{name}')} = {self.p(f'{e.label}.{name}')}"
        turning = {self.coordinate(e) for _, e in self.numbered if e.definition.travel}
        for c in sorted(self.seen | turning):
            if self.machine.coordinate(c).kind == "rotary":
                yield f"{identifier(c)}_per_radius = 1.0 / {self.p(f'{c}.radius')}"
        for c in sorted({self.coordinate(e) for _, e in self.numbered if e.definition.friction}):
            if self.machine.coordinate(c).kind == "rotary":
                yield f"{identifier(c)}_radius = {self.p(f'{c}.radius')}"
        for d in self.machine.drives:
            if any(self.at("current", d.name)):
                name = identifier(d.name)
                gear, Kt, Ke, R = (self.p(f"{d.name}.{key}") for key in ("gear_ratio", "Kt", "Ke", "resistance"))
                yield f"{name}_torque = {gear} * {Kt}"
                yield f"{name}_emf = {gear} * {Ke}"
                yield f"{name}_per_resistance = 1.0 / {R}"

    def voltages(self, load: Callable[[int], str]) -> Iterator[str]:
        """Volts at the drives that have effects of their own."""
        for j, d in enumerate(self.machine.drives):
            if self.commanded(j):
                name = f"volts_{identifier(d.name)}"
                yield f"{name} = {load(j)}"
                for k, e in self.at("voltage", d.name, "drives"):
                    yield f"{name} = {self.call('voltage', k, e, {'V': name})}"

    def commanded(self, j: int) -> bool:
        """Whether the volts of drive j have a name (see `voltages`) instead of being loaded in place."""
        d = self.machine.drives[j]
        return any(self.at("voltage", d.name, "drives")) or any(self.at("current", d.name))

    def stretched(self, coordinate: str, point: Point) -> str:
        """Belt travel of a coordinate: its own, and what an eccentric pulley adds."""
        name = identifier(coordinate)
        added = "".join(
            f" + {self.call('travel', k, e, self._turned(k, e, coordinate, point))}"
            for k, e in self.on("travel", coordinate)
        )
        return f"({point.travel}_{name}{added})" if added else f"{point.travel}_{name}"

    def arm(self, coordinate: str, point: Point) -> str:
        """Factor of the belts' force on a coordinate, or nothing."""
        parts = [
            f" + {self.call('arm', k, e, self._turned(k, e, coordinate, point))}" for k, e in self.on("arm", coordinate)
        ]
        return f"(1.0 + ({''.join(parts)[3:]}){self.scale(coordinate)})" if parts else ""

    def tension(self, belt: str, s: str, rate: str, k: str) -> Iterator[str]:
        """The belt's tension from its linear one, effect by effect: each adds what it changes."""
        for j, e in self.at("tension", "belts", belt):
            yield f"T_{belt} = T_{belt} + ({self.call('tension', j, e, {'s': s, 'rate': rate, 'k': k})} - {k} * {s})"

    def growth(self, belt: str, s: str, k: str) -> str:
        """How the belt's energy grows with its stiffness, where it is not s^2/2."""
        own = [self.call("growth", j, e, {"s": s, "k": k}) for j, e in self.at("growth", "belts", belt)]
        return own[0] + "".join(f" + ({more} - 0.5 * {s} * {s})" for more in own[1:]) if own else ""

    def forces(self, point: Point) -> Iterator[str]:
        """Forces f and friction levels F of all coordinates at a point; f of the belts and drives is there already."""
        for c in self.machine.coordinate_names:
            name = identifier(c)
            yield f"F_{name} = {name}_coulomb"
            if c in self.moving:
                yield from self._forces_on(c, point)
        yield from self._guarded(point)

    def _forces_on(self, c: str, point: Point) -> Iterator[str]:
        name, scale, motion = identifier(c), self.scale(c), self.motion(c, point)
        for k, e in self.on("coulomb", c):
            if e.definition.evolve:
                yield f"half_z_{k} = {self.evolved(k, e, point)}"
            scope = motion | {"z": f"half_z_{k}", "u": self.variable(e, point, f"half_z_{k}")}
            yield f"F_{name} = F_{name} + {self.call('coulomb', k, e, scope)}{scale}"
        if any(self.on("coulomb", c)):
            yield f"F_{name} = maximum(F_{name}, 0.0)"
        added = ""
        for k, e in self.on("friction", c):
            yield f"level_{k} = F_{name}{self.unscale(c)}"
            yield f"half_z_{k} = {self.evolved(k, e, point)}"
            call = self.call("friction", k, e, motion | {"z": f"half_z_{k}", "level": f"level_{k}"})
            added += f" - {call}{scale}"
            yield f"F_{name} = 0.0 * F_{name}"
        for k, e in self.on("force", c):
            if e.definition.guard:
                continue
            if e.definition.evolve:
                yield f"half_z_{k} = {self.evolved(k, e, point)}"
            scope = motion | {"z": f"half_z_{k}", "u": self.variable(e, point, f"half_z_{k}")}
            added += f" {plus(self.call('force', k, e, scope))}{scale}"
        for d in self.machine.drives:
            if d.coordinate == c and any(self.at("current", d.name)):
                yield from self._currents(d.name, motion["v"])
                drive = identifier(d.name)
                added += f" + {drive}_torque * (current_{drive} - ohm_{drive}){scale}"
        if added:
            yield f"f_{name} = f_{name}{added}"

    def _guarded(self, point: Point) -> Iterator[str]:
        """Forces that are zero for most stages: worked out only where a lane of the block is on guard.

        Elsewhere they add a zero of the sign that changes nothing, so no lane's bits hang on its neighbours'.
        """
        own = [(k, e) for k, e in self.numbered if e.definition.guard]
        if not own:
            return
        motions = {k: self.motion(self.coordinate(e), point) for k, e in own}
        alarms = [self.call("guard", k, e, motions[k]) for k, e in own]
        yield f"if any_of({' | '.join(f'({alarm})' for alarm in alarms)}):"
        for k, e in own:
            name = identifier(self.coordinate(e))
            force = f"{self.call('force', k, e, motions[k])}{self.scale(self.coordinate(e))}"
            yield f"    f_{name} = f_{name} {plus(force)}"

    def _currents(self, drive: str, speed: str) -> Iterator[str]:
        """The drive's current by Ohm's law, which the exact flow holds already, and what effects make of it."""
        name = identifier(drive)
        yield f"ohm_{name} = (volts_{name} - {name}_emf * ({speed})) * {name}_per_resistance"
        yield f"current_{name} = ohm_{name}"
        for k, e in self.at("current", drive):
            yield f"ohm_{k} = current_{name}"
            if e.definition.evolve:
                scope = {"z": f"z_{k}", "dt": "half", "i": f"ohm_{k}"}
                yield f"half_z_{k} = {self.call('evolve', k, e, scope)}"
            yield f"current_{name} = {self.call('current', k, e, {'i': f'ohm_{k}', 'z': f'half_z_{k}'})}"

    def unscale(self, coordinate: str) -> str:
        rotary = self.machine.coordinate(coordinate).kind == "rotary"
        return f" * {identifier(coordinate)}_radius" if rotary else ""

    def _turned(self, k: int, e: AppliedEffect, coordinate: str, point: Point) -> dict[str, str]:
        z = self.evolved(k, e, point) if e.definition.evolve else ""
        return self.motion(coordinate, point) | {"z": z, "per_radius": f"{identifier(coordinate)}_per_radius"}

    def evolved(self, k: int, e: AppliedEffect, point: Point) -> str:
        """An effect's own state half a step on."""
        v = self.motion(self.coordinate(e), point)["v"]
        scope = {"z": f"z_{k}", "dq": f"half * {v}", "dt": "half", "v": v, "level": f"level_{k}"}
        return self.call("evolve", k, e, scope)

    def ends(self) -> Iterator[str]:
        """Every effect's own state at the end of the step, by the way that was gone."""
        for k, e in self.numbered:
            if e.definition.evolve:
                name, scale = identifier(self.coordinate(e)), self.scale(self.coordinate(e))
                scope = {"dq": f"(n_{name} - q_{name}){scale}", "v": f"w_{name}{scale}"}
                own = {"z": f"z_{k}", "dt": "h", "level": f"level_{k}", "i": f"ohm_{k}"}
                yield f"z_{k} = {self.call('evolve', k, e, scope | own)}"
