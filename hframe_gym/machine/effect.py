"""Effects: physical phenomena (friction, delay, ...) that the basic model of a machine lacks, as formulas.

An `Effect` is a definition (one file of `hframe_gym.effects`), an `AppliedEffect` a definition at a site (the
component on which it acts) with parameter values. The docstring of `Effect` lists the formulas that a
definition may give. They are called hooks, because the simulation calls each at a fixed point of its
equations. Hooks use the elementary functions of `hframe_gym.dynamics.elementwise`, so that one definition
serves NumPy arrays, the compiled simulation kernel (generated code) and CasADi. They may call helper
functions and use constants of their module.
"""

from __future__ import annotations

import builtins
import dataclasses
import difflib
import dis
import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from numbers import Real
from typing import Any, Literal, Protocol, get_args

from ..errors import InputError, suggestion
from .declaration import FIXED_UNITS, UNITS

SiteKind = Literal["coordinate", "motor", "drive", "drives", "belts", "sensor", "machine"]
ParameterRole = Literal["amplitude", "phase", "period", "rate", "switch", "shape", "fixed"]
Hook = Callable[..., Any]
#: The hooks, with the quantities that each may take as arguments; the docstring of `Effect` describes them.
HOOKS: Mapping[str, tuple[str, ...]] = {
    "force": ("q", "v", "t", "z", "u", "load", "m", "net", "friction"),
    "reaction": ("q", "v", "m"),
    "active_region": ("q", "v", "t"),
    "coulomb": ("q", "v", "t", "z", "u", "level", "drive"),
    "friction": ("q", "v", "t", "z", "level"),
    "viscous": ("b", "direction"),
    "voltage": ("V",),
    "delay": (),
    "set_point": ("V", "q"),
    "current": ("i", "z", "V", "q", "v", "dq", "dv", "N", "R"),
    "torque": ("i", "q"),
    "tension": ("s", "rate", "k", "per_radius"),
    "damping": ("k", "per_radius"),
    "energy_slope": ("s", "k"),
    "belt_travel": ("q", "z", "per_radius"),
    "lever_arm": ("q", "z", "per_radius"),
    "rest_angle_offset": ("q", "per_radius"),
    "measurement": ("r", "q", "across"),
    "measurement_delay": (),
    "clock": ("z",),
    "next_state": ("z", "dq", "dt", "v", "dv", "level", "i", "V", "q", "N", "R", "power", "stall_power"),
    "initial_spread": ("level", "N", "i", "m"),
}


class Named(Protocol):
    """Anything with a name, such as a drive."""

    @property
    def name(self) -> str:
        """Name of the component."""


class Components(Protocol):
    """The part of a `Machine` that an effect needs: the components on which effects can act."""

    @property
    def name(self) -> str:
        """Name of the machine."""

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of the coordinates."""

    @property
    def drives(self) -> Sequence[Named]:
        """The drives."""

    @property
    def belts(self) -> Sequence[Named]:
        """The belts."""

    @property
    def output_channels(self) -> tuple[str, ...]:
        """Names of the sensors' channels."""

    @property
    def effects(self) -> Sequence[AppliedEffect]:
        """Effects that the machine has."""


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect.

    Attributes:
        name: Name of the parameter: an argument of the hooks (formulas) of the effect.
        unit: Unit, such as "N/m^2", or the name of one quantity whose unit follows from the site, such as
            "force", N or Nm: a key of `machine.UNITS`, or "voltage".
        lower: Lower bound, SI.
        upper: Upper bound, SI.
        scale: Typical size. With the name of a quantity, as a multiple of its typical value at the site
            (force: a tenth of that of the drives at rated voltage; speed: the largest; position: the travel;
            mass: the declared one). So too with "A", "1/A^2" and "1/W" (current of the drive) and "m",
            "1/m^2" and "N" (extension and force of the belts). With any other unit, in this unit.
        grid: Starting values of a search, given like `scale`.
        largest: Largest value that a search may give the parameter, given like `scale`. Beyond it, the effect
            would act like another one: hysteresis over a longer distance than the motion is a spring.
        role: "amplitude": the effect is absent where it is 0. "phase": phase of a sine that the amplitude
            multiplies. "period" (m or rad), "rate" (rad per m or rad): of such a sine over the position; a
            search finds starting values. "switch": a threshold; predictions change in steps with it. "fixed":
            not fitted. "shape": any other.
        above: Name of another parameter of the effect, which is a lower bound of this one; empty if there is
            none.
        named_from: Least value, SI, with which an identification names the effect. With less, the formula
            describes something else: no cable is a spring of negative stiffness.
        simpler: Names of effects with fewer parameters, by the value of this parameter, SI, with which this
            effect is the other one: an interpolation error of one period a turn is an eccentric encoder. An
            identification names the simpler one.
        slope_of: Name of the amplitude that this parameter, a time constant, divides where it is long: the
            effect is then a change at the constant rate amplitude / time constant, which is no other effect.
            Shorter recordings determine that rate, and of the time constant only its least value. "" if there
            is none.
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: float
    grid: tuple[float, ...] = (0.0,)
    largest: float = math.inf
    role: ParameterRole = "shape"
    above: str = ""
    named_from: float = -math.inf
    simpler: Mapping[float, str] = field(default_factory=dict, hash=False)
    slope_of: str = ""

    def __post_init__(self) -> None:
        """Refuse an unknown role: a search would not find the parameter."""
        if self.role not in get_args(ParameterRole):
            roles = ", ".join(get_args(ParameterRole))
            raise InputError(f"parameter {self.name}: the role is {self.role!r}; choose one of {roles}")

    @property
    def amplitude(self) -> bool:
        """Whether the effect is absent when this parameter is zero."""
        return self.role == "amplitude"


@dataclass(frozen=True)
class Effect:
    """Definition of an effect: physics (friction, delay, ...) that may act at some site of a machine.

    A definition gives one or more hooks: functions, one for each formula. The names of its arguments tell
    what a hook receives: parameters of the effect, by their names, and quantities of the last column, by
    their symbols:

    hook                returns                                                      arguments
    force               force added to the coordinate, N or Nm                       q, v, t, z, u, load, m,
                                                                                     net, friction
    reaction            force of an added coordinate on that at the site, N or Nm    q, v, m
    active_region       where the force may differ from zero (default: everywhere)   q, v, t
    coulomb             change of the Coulomb friction force, N or Nm (sum >= 0)     q, v, t, z, u, level,
                                                                                     drive
    friction            dry friction force that replaces Coulomb friction, N or Nm   q, v, t, z, level
    viscous             viscous coefficient of the coordinate, Ns/m or Nms           b, direction
    voltage             voltage that reaches the drive, V                            V
    delay               delay of the drive's voltage, s
    set_point           command as the law of the drive sees it, in its unit         V, q
    current             current of the drive, A (the mean over a step)               i, z, V, q, v, dq, dv, N,
                                                                                     R
    torque              current that makes torque without the effect, A              i, q
    tension             tension of a belt, N                                         s, rate, k, per_radius
    damping             derivative of the tension by the rate where parts touch,     k, per_radius
                        Ns/m, at least 0; the integrator then takes a rate that
                        this damper cannot reverse in one step
    energy_slope        derivative of the belt's energy by its stiffness, m^2        s, k
                        (default: s^2/2)
    belt_travel         belt travel that a pulley adds, m                            q, z, per_radius
    lever_arm           derivative of that travel by the angle, m/rad                q, z, per_radius
    rest_angle_offset   angle by which a pulley at rest lags a round one, rad        q, per_radius
    measurement         measured value of a sensor, in its unit                      r, q, across
    measurement_delay   delay of a sensor, s
    clock               by which fraction steps last longer than by the log's clock  z
    next_state          state of the effect after the time dt                        z, dq, dt, v, dv, level,
                                                                                     i, V, q, N, R, power,
                                                                                     stall_power
    initial_spread      standard deviation of the state when a recording begins,     level, N, i, m
                        after motion that was not recorded (default: it is zero);
                        of an effect that adds a coordinate, those of position and
                        speed of this coordinate

    - Coordinate: q, v: position and speed, m or rad, m/s or rad/s; per_radius: 1/radius of a pulley, 1/m; b:
      viscous coefficient without the effect, Ns/m or Nms; direction: sign of the motion, +1 or -1; level:
      Coulomb friction force with the effects on it, N or Nm; drive, load: force of its drives and of its
      belts, N or Nm (load only without an `active_region`). For a force on a coordinate that `structure`
      adds, if it has the argument net: net, friction: net force and friction (dry and viscous) on the
      coordinate at the site, N or Nm; m: mass of the added coordinate, kg or kg m^2. For `reaction`, q, v, m
      are those of the added coordinate.
    - Effect: z: its state, 0 when a simulation starts; u: the variable that `against` names; t: time since
      the machine was switched on, s; dt: length of a step, s; dq: distance that the coordinate moves in dt, m
      or rad; dv: change of its speed in dt, m/s or rad/s, 0 where it is not known.
    - Drive: V: voltage, V; i: current by Ohm's law, A (for `torque`, with the effects on it); q, v: position
      and speed of its coordinate, for `current` in the middle of a step in which they change by dq and dv,
      both 0 for the current at an instant; N, R: its gear ratio and resistance, ohm; power: sum of V i by
      Ohm's law over the drives on which the effect acts, W; stall_power: this sum if they stood still, W. For
      `initial_spread`, i is the current at standstill and the rated voltage, level that of the coordinate at
      the site without effects. Belt: s, rate, k: extension, m, its rate, m/s, stiffness, N/m (per_radius only
      for a belt that `structure` adds behind a drive). Sensor: r: ideal reading, in its unit; q: position of
      the coordinate that it mainly measures, m or rad; across: position of the other linear coordinate, m.

    Attributes:
        name: Unique name.
        family: Name of the group of effects with the same physical cause that reports treat as one effect.
            Default: the name of the effect.
        site: Kind of site at which the effect can act. "motor": the coordinate of a drive. "drive", "drives":
            amplifier and winding of one drive, or of all at once ("drives" where this is the usual case).
            "belts": all belts or one. "machine": all coordinates, or the structure that `structure` changes.
            On several components, the effect has the same parameter values, but a separate state for each.
        parameters: Parameters, in the order in which `Machine.parameters` lists them.
        formula: The equation, for tables and reports.
        source: Reference of the formula.
        structure: Function (machine, applied effect) -> machine that changes the machine itself: it adds
            coordinates, belts and sensor rows whose parameters are tied to the effect's parameters.
        fits: Predicate (machine) -> bool: whether the machine has the components that the effect needs.
        fits_site: Predicate (machine, site) -> bool: whether the effect can act at that site.
        equivalent: Causes that no recording can distinguish from the effect, in words.
        equivalent_site: Predicate (machine, site, other site) -> bool: whether no recording can distinguish
            the effect at one of the sites from that at the other one.
        shared: Whether a search also tries an effect of the kind "drive" on all drives at once.
        refitted: Whether other parameter values of the machine have the same influence; a search then omits
            the effect, unless an effect of all drives changes the same voltage after it.
        against: Variable `u` of a tabulated effect: "position of y", "velocity of y", "path of y" or "time".
        rigid: Function (machine without the added `coordinate`, applied effect) -> machine that returns to
            the site what `structure` took from it, and removes its other coordinates and belts, for
            controllers (`rigid_counterpart`). Default: nothing.
        coordinate: Name of the coordinate that `structure` adds, on which `force` acts, with "{site}" for
            that of the component; empty if none.
        belt: Name of the belt section that `structure` adds, on which alone `tension` acts; "{site}" stands
            for the effect's site. Its extension names the coordinates before and behind the contact that it
            stands for. Effects at "belts" do not act on it. Empty if there is none.
        half_gap: Name of the parameter that is half the gap of this contact, in the unit of the coordinate
            before it.
        requires: Name of the effect that must be in the model at the same site before a search adds this one;
            or empty.
        needs_part: Part that not every machine has, and without which the effect does not exist, such as
            "magnets". Of effects that explain the same, those that need none are preferred. Empty if it needs
            none.
        impacts: Whether parts collide, so that small changes of a parameter change the motion irregularly.
        fastest: Function (machine, applied effect) -> rate, rad/s, at which what the effect adds vibrates, or
            at which its damper brakes it, whichever is higher; `dynamics.resolved_step` follows it.
            Default: slow.
        range_ends: Names of the parameters that are the lowest and the highest measurement of a sensor, if
            the effect limits its range (`Machine.measuring_ranges`).
        starting_values: For an effect of a sensor, function (measurements of each run, shapes (m,), and their
            noise, in the sensor's unit) -> sets of starting values of a search, by parameter name. Default:
            those of the parameters' `grid`.
        signal_order: Place on the way of a signal. Where several effects change the same voltage, current or
            measurement, those with smaller numbers act first, in whichever order they are listed in the
            machine.

    Raises:
        InputError: If an argument of a hook is neither a parameter nor a quantity of the hook, or is both, if
            the body of a hook uses a name that is not defined, if a unit misspells the name of a quantity, if
            the kind of site is unknown, or if there is no hook.
    """

    name: str
    site: SiteKind
    parameters: tuple[EffectParameter, ...]
    formula: str
    source: str
    family: str = ""
    force: Hook | None = None
    reaction: Hook | None = None
    active_region: Hook | None = None
    coulomb: Hook | None = None
    friction: Hook | None = None
    viscous: Hook | None = None
    voltage: Hook | None = None
    delay: Hook | None = None
    set_point: Hook | None = None
    current: Hook | None = None
    torque: Hook | None = None
    tension: Hook | None = None
    damping: Hook | None = None
    energy_slope: Hook | None = None
    belt_travel: Hook | None = None
    lever_arm: Hook | None = None
    rest_angle_offset: Hook | None = None
    measurement: Hook | None = None
    measurement_delay: Hook | None = None
    clock: Hook | None = None
    next_state: Hook | None = None
    initial_spread: Hook | None = None
    structure: Callable[..., Any] | None = None
    rigid: Callable[..., Any] | None = None
    fits: Callable[..., bool] | None = None
    fits_site: Callable[..., bool] | None = None
    equivalent: tuple[str, ...] = ()
    equivalent_site: Callable[..., bool] | None = None
    shared: bool = False
    refitted: bool = False
    against: str = ""
    coordinate: str = ""
    belt: str = ""
    half_gap: str = ""
    needs_part: str = ""
    impacts: bool = False
    fastest: Callable[..., float] | None = None
    requires: str = ""
    range_ends: tuple[str, str] | None = None
    starting_values: Callable[..., Sequence[Mapping[str, float]]] | None = None
    signal_order: int = 0

    def __post_init__(self) -> None:
        """Complete the family, and check the site, the hooks and the names of their arguments."""
        if not self.family:
            object.__setattr__(self, "family", self.name)
        if self.site not in get_args(SiteKind):
            kinds = ", ".join(get_args(SiteKind))
            raise InputError(f"effect {self.name}: the site is {self.site!r}; choose one of {kinds}")
        if not self.structure and not any(getattr(self, hook) for hook in HOOKS):
            raise InputError(f"effect {self.name}: has no formula; give one of {', '.join(HOOKS)}")
        for p in self.parameters:
            self._check_unit(p)
        parameters = [p.name for p in self.parameters]
        for hook, quantities in HOOKS.items():
            function = getattr(self, hook)
            for name in argument_names(function) if function else ():
                if name in parameters and name in quantities:
                    raise InputError(
                        f"effect {self.name}: the parameter {name} has the name "
                        f"of a quantity of the formula {hook}, and would hide it; "
                        f"rename the parameter ({hook} knows {', '.join(quantities)})"
                    )
                if name not in parameters and name not in quantities:
                    raise InputError(
                        f"effect {self.name}: the argument {name} of the formula "
                        f"{hook} is neither a parameter ({', '.join(parameters)}) "
                        f"nor a quantity of {hook} ({', '.join(quantities) or 'none'})"
                    )
            self._check_names(hook, function)

    def _check_names(self, hook: str, function: Callable[..., Any] | None) -> None:
        """Refuse a formula whose body uses a name that neither Python nor its module knows."""
        for name in _undefined_names(function):
            known = [*(p.name for p in self.parameters), *HOOKS[hook]]
            hint = "; make it an argument" if name in known else suggestion(name, known)
            raise InputError(
                f"effect {self.name}: the formula {hook} uses {name}, which is not defined{hint} "
                f"(the arguments of {hook} may be its parameters {', '.join(known[: len(self.parameters)])} "
                f"and the quantities {', '.join(HOOKS[hook]) or 'none'})"
            )

    def _check_unit(self, parameter: EffectParameter) -> None:
        """Refuse a misspelled name of a quantity, and one inside a unit, which would count as a unit."""
        names, unit = [*UNITS["linear"], *FIXED_UNITS], parameter.unit
        words = re.findall(r"[A-Za-z]{4,}", unit)  # symbols of units are shorter
        if unit not in names and any(difflib.get_close_matches(word, names, cutoff=0.8) for word in words):
            meant = suggestion(unit, names) if words == [unit] else ""
            raise InputError(
                f"effect {self.name}: the unit of {parameter.name} is {unit!r}; "
                f"give a unit such as N/m^2, or one of {', '.join(names)} alone{meant}"
            )

    def __hash__(self) -> int:
        """Return a hash of the name: hashing all formulas would take longer than finding a machine's code."""
        return hash(self.name)

    def parameter(self, name: str) -> EffectParameter:
        """Return the declaration of a parameter of the effect (unit, bounds, role), or raise a KeyError."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(f"effect {self.name!r} has no parameter {name!r}")

    def possible_sites(self, machine: Components) -> tuple[str, ...]:
        """List the components of a machine on which the effect can act, given the attribute `site`.

        "drives" and "belts" stand for all drives or belts at once, "machine" for all coordinates. The further
        conditions `fits` and `fits_site` are not checked.
        """
        drives = tuple(d.name for d in machine.drives)
        belts = _declared_belts(machine)
        return {
            "coordinate": machine.coordinate_names,
            "motor": drives,
            "drive": (*drives, "drives"),
            "drives": ("drives", *drives),
            "belts": ("belts", *belts) if belts else (),
            "sensor": machine.output_channels,
            "machine": ("machine",),
        }[self.site]

    def is_equivalent(self, machine: Components, site: str, cause: str) -> bool:
        """Return whether no recording of a machine can distinguish the effect from another cause.

        Args:
            machine: Machine with the effect.
            site: Component on which the effect acts.
            cause: Label (name@site) of the same effect at another site, which `equivalent_site` judges, or
                one of the causes in words that `equivalent` lists. Anything else gives False.
        """
        name, _, other = cause.partition("@")
        if self.equivalent_site is None or name != self.name:
            return cause in self.equivalent
        return self.equivalent_site(machine, site, other)

    @property
    def replaces_model_part(self) -> bool:
        """Whether the effect adds coordinates or replaces dry friction.

        It then has no parameter whose value 0 removes it.
        """
        return bool(self.structure or self.friction)

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of the parameters whose value 0 means that the effect is absent."""
        return tuple(p.name for p in self.parameters if p.amplitude)

    def at(self, site: str, **parameters: float) -> AppliedEffect:
        """Return the effect on a component, with parameter values, for `Machine.with_effects`.

        Args:
            site: Name of the coordinate, drive, belt or sensor channel on which the effect acts; or "drives"
                or "belts" for all of them, or "machine". `possible_sites` lists the choices,
                `Machine.with_effects` checks them.
            **parameters: Value of every parameter of the effect, SI, within its bounds (`EffectParameter`).

        Raises:
            InputError: If a parameter is missing, unknown, no number, outside its bounds or below the
                parameter that its `above` names; the message names it.
        """
        names, label = [p.name for p in self.parameters], f"effect {self.name} at {site}"
        problems = [f"{name} is missing" for name in names if name not in parameters]
        problems += [f"{name} is no parameter of it" for name in parameters if name not in names]
        if problems:
            raise InputError(f"{label} takes {', '.join(names)}: {', '.join(problems)}")
        for p in self.parameters:
            value = parameters[p.name]
            if not isinstance(value, Real):
                raise InputError(f"{label}: {p.name} is {value!r}, it must be a number")
            if not p.lower <= value <= p.upper:
                raise InputError(f"{label}: {p.name} = {value:g} is outside [{p.lower:g}, {p.upper:g}]")
            if p.above and value < parameters[p.above]:
                other = f"{p.above} = {parameters[p.above]:g}"
                raise InputError(f"{label}: {p.name} = {value:g} is below {other}; it must not be smaller")
        return AppliedEffect(self, site, {n: float(parameters[n]) for n in names})


@dataclass(frozen=True)
class AppliedEffect:
    """An effect at a site of a machine, with parameter values.

    Attributes:
        definition: The effect, such as `EFFECTS["cogging"]`.
        site: Name of the coordinate, drive, belt or sensor channel, or "drives", "belts", "machine".
        parameters: Values by name, SI: floats, or arrays for many variants at once.
    """

    definition: Effect
    site: str
    parameters: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Name of the effect without the component on which it acts, for example "stribeck_friction"."""
        return self.definition.name

    @property
    def label(self) -> str:
        """Name and component, e.g. "stribeck_friction@x"; its parameters' full names begin with it."""
        return f"{self.definition.name}@{self.site}"

    @property
    def coordinate(self) -> str:
        """Name of the coordinate that the effect adds to its machine; "" if none."""
        return self.definition.coordinate.format(site=self.site)

    @property
    def added_belt(self) -> str:
        """Name of the belt section that the effect adds to its machine; "" if none."""
        return self.definition.belt.format(site=self.site)

    @property
    def measuring_range(self) -> tuple[Any, Any] | None:
        """Lowest and highest measurement of the sensor, in its unit, if the effect limits them; else None."""
        ends = self.definition.range_ends
        return ends and (self.parameters[ends[0]], self.parameters[ends[1]])

    def components(self, machine: Components) -> tuple[str, ...]:
        """Return the names of the components of a machine on which the effect acts.

        The site "drives" means all drives, "belts" all belts, "machine" all coordinates. An effect that adds
        components (`Effect.structure`) or changes the clock acts on ("machine",) and on the belt that it
        adds, if any.
        """
        kind = self.definition.site
        if self.definition.belt:
            return (self.added_belt,)
        if kind == "machine":
            whole = self.definition.structure or self.definition.clock
            return ("machine",) if whole else machine.coordinate_names
        drives = tuple(d.name for d in machine.drives)
        names = {"drive": drives, "drives": drives, "belts": _declared_belts(machine)}.get(kind, ())
        # A component that is called "drives" or "belts" comes before all of them.
        return (self.site,) if self.site in names or not names else names

    def with_parameters(self, parameters: Mapping[str, float]) -> AppliedEffect:
        """Return a copy with other parameter values, without checks.

        Args:
            parameters: Value of every parameter of the effect, SI, by name; none keeps its present value.
        """
        return dataclasses.replace(self, parameters=dict(parameters))

    def check_site(self, machine: Components) -> None:
        """Raise a ValueError if the machine lacks the site, or already has this effect there."""
        if any(present.label == self.label for present in machine.effects):
            raise ValueError(f"effect {self.label}: machine {machine.name!r} has it already")
        sites = self.definition.possible_sites(machine)
        if self.site not in sites:
            choices = ", ".join(sites)
            raise ValueError(
                f"effect {self.name}: machine {machine.name!r} has no site {self.site!r}; "
                f"choose one of {choices}"
            )

    def __call__(self, hook: str, **quantities: Any) -> Any:
        """Evaluate one hook (a formula of the effect) with the effect's parameter values.

        Args:
            hook: Name of a hook that the effect has, for example "force"; `Effect` lists all hooks with their
                units.
            **quantities: Quantities that the hook takes as arguments by their symbols, for example q
                (position) and v (speed). Surplus quantities are ignored.

        Raises:
            KeyError: If an argument of the hook is not given; the message names it.
            TypeError: If the effect does not have the hook.
        """
        function = getattr(self.definition, hook)
        values = {**quantities, **self.parameters}
        return function(*(values[name] for name in argument_names(function)))


def _declared_belts(machine: Components) -> tuple[str, ...]:
    """Return the names of a machine's belts without the contacts that effects added."""
    added = {effect.added_belt for effect in machine.effects}
    return tuple(b.name for b in machine.belts if b.name not in added)


def _undefined_names(function: Callable[..., Any] | None) -> list[str]:
    """Return the global names in the body of a Python function that are not defined."""
    code, defined = getattr(function, "__code__", None), getattr(function, "__globals__", {})
    if code is None:
        return []  # no formula, or a callable that Python did not compile
    unknown = [n for n in code.co_names if n not in defined and not hasattr(builtins, n)]
    if not unknown:
        return []  # attributes are names as well; only where one is unknown, instructions are read, slowly
    read = {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}
    return [name for name in unknown if name in read]


@lru_cache(maxsize=1024)
def argument_names(function: Hook) -> tuple[str, ...]:
    """Return the names of the quantities that a hook takes as arguments, e.g. ("q", "k") of `force(q, k)`."""
    return tuple(inspect.signature(function).parameters)
