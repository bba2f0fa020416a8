"""The machine model: coordinates with a diagonal mass matrix, elastic belts, drives, sensors and effects.

Extension s = G p and length of a belt are linear in the belt travel p of the coordinates (p = radius * angle
of a pulley). The potential energy is 1/2 sum k s^2, k = EA / length (eq. 38-44 of Sollmann et al. 2010).
Values are SI.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, ParameterRows
from ..errors import InputError, suggestion
from .axis_unit import DEFAULT_TURNS, METERS, RADIANS, AxisUnit
from .components import Belt, Coordinate, Drive, Row, Sensor
from .declaration import FIXED_UNITS, UNITS, Component, Variant
from .drive_kinds import DRIVE_KINDS, DriveLaw
from .effect import AppliedEffect, SiteKind
from .sensor_kinds import SENSOR_KINDS
from .trajectory import SIMULATORS, Trajectory
from .uncertainty import Uncertainty

_COMPONENTS = {Coordinate: "coordinates", Belt: "belts", Drive: "drives", Sensor: "sensors"}


class Contact(NamedTuple):
    """Stiff contact of two coordinates, such as the teeth of a gear.

    Attributes:
        near: Name of the coordinate before it, on the drive's side.
        far: Name of the coordinate behind it.
        half_gap: Half the gap, m or rad: they touch where their positions differ by more.
    """

    near: str
    far: str
    half_gap: float


@dataclass(frozen=True)
class Machine:
    """A belt-driven positioning system. Load one by name or from a file with `hframe_gym.load_machine`.

    Attributes:
        name: Name of the machine.
        coordinates: Degrees of freedom.
        belts: Elastic belt sections.
        drives: Motors, in the order of the input channels.
        sensors: Sensors, in the order of the output channels.
        effects: Additional physical phenomena, each at its site, the component on which it acts.
        uncertainty: Covariance of the parameters, if they were identified.
        description: One sentence for people.
        ties: Parameters that equal a factor times another parameter, by full name, for example
            {"phi3.radius": ("phi1.radius", 1.0)}. An effect that adds coordinates ties their parameters to
            its parameters; without the effect, they keep their values and are parameters of their own.
    """

    name: str
    coordinates: tuple[Coordinate, ...]
    belts: tuple[Belt, ...]
    drives: tuple[Drive, ...]
    sensors: tuple[Sensor, ...]
    effects: tuple[AppliedEffect, ...] = ()
    uncertainty: Uncertainty | None = None
    description: str = ""
    ties: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Drop ties to parameters of effects that the machine does not have."""
        if self.ties:
            components: tuple[Component, ...] = (*self.coordinates, *self.belts, *self.drives)
            owners = {*(c.label for c in components), *(e.label for e in self.effects)}
            kept = {tied: tie for tied, tie in self.ties.items() if tie[0].rpartition(".")[0] in owners}
            object.__setattr__(self, "ties", kept)

    @cached_property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of the coordinates, in the order of state vectors."""
        return tuple(c.name for c in self.coordinates)

    @cached_property
    def input_channels(self) -> tuple[str, ...]:
        """Names of the channels of the drives' commands, such as voltages, in the order of the drives."""
        return tuple(d.channel for d in self.drives)

    @cached_property
    def supply_channels(self) -> tuple[str, ...]:
        """Names of the channels of measured supply voltages, each once."""
        return tuple(dict.fromkeys(d.supply for d in self.drives if d.supply))

    @cached_property
    def output_channels(self) -> tuple[str, ...]:
        """Names of the measured channels, in the order of the sensors."""
        return tuple(s.channel for s in self.sensors)

    @cached_property
    def measuring_ranges(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest measurement of the sensors with a limited range, in their units, by channel."""
        ranges: dict[str, tuple[float, float]] = {}
        for effect in self.effects:
            if limits := effect.measuring_range:
                low, high = ranges.get(effect.site, (-math.inf, math.inf))
                ranges[effect.site] = max(low, limits[0]), min(high, limits[1])
        return ranges

    @cached_property
    def drive_laws(self) -> tuple[DriveLaw, ...]:
        """Torque laws of the drives that have one, such as servos."""
        return tuple(law for law in (drive.law for drive in self.drives) if law)

    @cached_property
    def shape(self) -> tuple[object, ...]:
        """Structure without parameter values: components, coefficients, effects.

        Machines with equal ones share compiled code.
        """
        return (
            tuple((c.name, c.kind) for c in self.coordinates),
            tuple((b.name, tuple(b.extension.items()), tuple(b.length.items())) for b in self.belts),
            tuple(
                (d.name, d.coordinate, d.parameter_names, DRIVE_KINDS.get(d.kind).law) for d in self.drives
            ),
            tuple((s.channel, SENSOR_KINDS.get(s.kind).signal, tuple(s.row.items())) for s in self.sensors),
            tuple((e.definition, e.site) for e in self.effects),
            tuple(self.ties.items()),
        )

    def coordinate(self, name: str) -> Coordinate:
        """Return the coordinate with a name; an InputError lists the names if there is none."""
        return self.coordinates[self._index("coordinate", name, self.coordinate_names)]

    def belt(self, name: str) -> Belt:
        """Return the belt with a name; an InputError lists the names if there is none."""
        return self.belts[self._index("belt", name, [b.name for b in self.belts])]

    def drive(self, name: str) -> Drive:
        """Return the drive with a name; an InputError lists the names if there is none."""
        return self.drives[self._index("drive", name, [d.name for d in self.drives])]

    def sensor(self, channel: str) -> Sensor:
        """Return the sensor of a channel, for example "x_m"; an InputError lists the channels otherwise."""
        return self.sensors[self._index("sensor", channel, self.output_channels)]

    def _index(self, kind: str, name: str, names: Sequence[str]) -> int:
        """Return the index of a component of a kind; an InputError lists the names if there is none."""
        if name not in names:
            choices = f"choose one of {', '.join(names)}" if names else f"it has no {kind}s"
            raise InputError(
                f"machine {self.name!r} has no {kind} {name!r}; {choices}{suggestion(name, names)}"
            )
        return names.index(name)

    def coefficients(self, row: Row) -> Array:
        """Convert the coefficients of a belt or sensor from a dictionary to an array over all coordinates.

        Coordinates that the row does not name get zero; keys that are products ("y*yaw") are ignored.

        Returns:
            Extension per belt travel, m/m, or measurement per unit of a coordinate, SI, shape (coordinates,).
        """
        return np.array([row.get(name, 0.0) for name in self.coordinate_names])

    @cached_property
    def travel_per_unit(self) -> Array:
        """Belt travel per unit of each coordinate: a pulley's radius, m/rad, else 1; shape (coordinates,)."""
        return np.array([c.travel_per_unit for c in self.coordinates])

    @cached_property
    def belt_matrix(self) -> Array:
        """Extension of each belt per unit of each coordinate, m/m or m/rad, shape (belts, coordinates)."""
        rows = [self.coefficients(b.extension) * self.travel_per_unit for b in self.belts]
        return np.array(rows).reshape(len(self.belts), len(self.coordinates))

    @cached_property
    def highest_frequency(self) -> float:
        """Highest natural frequency of the masses on the belts at position 0, without effects, rad/s.

        It is 0 without belts.
        """
        # Squared frequencies are the squared singular values of diag(k)^(1/2) G M^(-1/2).
        mass = np.array([c.mass for c in self.coordinates])
        stiffness = np.array([b.EA / b.rest_length for b in self.belts])
        return float(np.linalg.norm(np.sqrt(stiffness)[:, None] * self.belt_matrix / np.sqrt(mass), 2))

    @cached_property
    def sensor_matrix(self) -> Array:
        """Readings of the position sensors per unit of each coordinate, SI, shape (sensors, coordinates).

        Rows of other sensors are zero. Products such as "y*yaw" (`Sensor.row`) are left out.
        """
        nothing = np.zeros(len(self.coordinates))
        rows = [self.coefficients(s.row) if s.of_position else nothing for s in self.sensors]
        return np.array(rows).reshape(-1, len(self.coordinates))

    @cached_property
    def position_commands(self) -> dict[str, int]:
        """Index of the input that commands a coordinate's position, by the coordinate's name."""
        return {d.coordinate: k for k, d in enumerate(self.drives) if d.command == "position"}

    @property
    def commands_in_words(self) -> str:
        """The inputs in words: "voltages", "duty cycles", "currents", "torques" or "set points".

        For drives of several kinds it is "commands".
        """
        quantities = {
            "duty cycle" if DRIVE_KINDS.get(drive.kind).fraction else drive.command for drive in self.drives
        }
        if quantities and quantities <= {"position", "speed"}:
            return "set points"
        return f"{quantities.pop()}s" if len(quantities) == 1 else "commands"

    def measures_position(self, channel: str) -> bool:
        """Return whether the sensor of a channel measures a position, not a speed or a current."""
        return self.sensor(channel).of_position

    @cached_property
    def position_sensors(self) -> NDArray[np.bool_]:
        """Whether each sensor measures positions, shape (sensors,)."""
        return np.array([s.of_position for s in self.sensors], np.bool_)

    @property
    def shows_direction(self) -> bool:
        """Whether any sensor measures a motion with its sign; a counter of pulses does not."""
        return any(sensor.has_direction for sensor in self.sensors)

    def sensor_unit(self, sensor: Sensor) -> str:
        """Return the unit of a sensor's measurements, such as "rad/s"."""
        return self.variant(sensor).units["measurement"]

    def coordinate_of_sensor(self, sensor: Sensor) -> str:
        """Return the name of the coordinate that a sensor mainly measures.

        For a current sensor it is the coordinate that the drive moves, for a tension sensor the coordinate
        that stretches the belt most.
        """
        match sensor.sensed.component:
            case "drive":
                return self.drive(sensor.coordinate).coordinate
            case "belt":
                extension = self.belt(sensor.coordinate).extension
                return max(extension, key=lambda name: abs(extension[name]))
        return sensor.coordinate

    def coordinate_of_site(self, site: str, kind: SiteKind) -> str | None:
        """Return the coordinate on which an effect acts, given the component that is its site.

        It is the site itself, what the drive there moves, or what the sensor there measures. It is None for a
        belt, for "drives", "belts" and "machine" (several coordinates), and for unknown sites.

        Args:
            site: Name of the component, such as "x", "motor1" or "x_m".
            kind: Kind of the component (`Effect.site`), because components of different kinds may have the
                same name.
        """
        coordinates = {
            "coordinate": {name: name for name in self.coordinate_names},
            "sensor": {s.channel: self.coordinate_of_sensor(s) for s in self.sensors},
        }
        if kind in ("motor", "drive", "drives"):
            return {d.name: d.coordinate for d in self.drives}.get(site)
        return coordinates.get(kind, {}).get(site)

    @cached_property
    def tool_axes(self) -> tuple[str, ...]:
        """Names of the coordinates that give the tool position, in the order of its axes.

        With one or two linear coordinates: all of them. With more: ("x", "y"), or () if one of these names is
        missing. Without linear coordinates there must be as many axes as drives, one or two: the rotary
        coordinates that no drive moves directly (a load behind an elastic belt), or else the driven ones; ()
        if neither number fits.
        """
        linear = tuple(c.name for c in self.coordinates if c.kind == "linear")
        if len(linear) > 2:
            return ("x", "y") if {"x", "y"} <= set(linear) else ()
        if linear:
            return linear
        driven = {d.coordinate for d in self.drives}
        free = [name for name in self.coordinate_names if name not in self.spring_loaded]
        for names in ([n for n in free if n not in driven], [n for n in free if n in driven]):
            if names and len(names) == len(self.drives) <= 2:
                return tuple(names)
        return ()

    @cached_property
    def axis_unit(self) -> AxisUnit:
        """Unit of the tool position: meters, or radians if the controlled axes are rotary."""
        rotary = bool(self.tool_axes) and self.coordinate(self.tool_axes[0]).kind == "rotary"
        return RADIANS if rotary else METERS

    @cached_property
    def axis_ranges(self) -> tuple[tuple[float, float] | None, ...]:
        """Lowest and highest position of each controlled axis, in its unit.

        A rotary axis without a declared range has `DEFAULT_TURNS`, one turn to either side of zero. A linear
        axis without one has None.
        """
        declared = [self.coordinate(name).range for name in self.tool_axes]
        default = DEFAULT_TURNS if self.axis_unit is RADIANS else None
        return tuple(default if limits is None else limits for limits in declared)

    @cached_property
    def spring_loaded(self) -> tuple[str, ...]:
        """Names of coordinates that effects add and a spring holds at zero, such as bridge yaw."""
        return tuple(e.coordinate for e in self.effects if e.coordinate)

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """Stiff contacts that effects add, such as the teeth of a gear with backlash.

        Each has the names of the coordinates before and behind it, and half of the gap between them.
        """
        extensions, contacts = {belt.name: belt.extension for belt in self.belts}, []
        for effect in self.effects:
            if effect.added_belt:
                near, far = extensions[effect.added_belt]
                contacts.append(Contact(near, far, effect.parameters[effect.definition.half_gap]))
        return tuple(contacts)

    def other_axis(self, coordinate: str) -> str | None:
        """Return the other one of two linear coordinates, such as y for x; None if there are not two."""
        others = [c.name for c in self.coordinates if c.kind == "linear" and c.name != coordinate]
        return others[0] if len(others) == 1 else None

    @cached_property
    def parameters(self) -> dict[str, float]:
        """Parameters that can be identified or randomized, SI, by full name, such as `x.coulomb`, `left.EA`.

        Tied parameters (`ties`) are not included; their values follow from the parameters to which they are
        tied.
        """
        values: dict[str, float] = {}
        for component in (*self.coordinates, *self.belts, *self.drives):
            of_component = {f"{component.label}.{key}": v for key, v in component.parameter_values.items()}
            values |= {name: value for name, value in of_component.items() if name not in self.ties}
        for effect in self.effects:
            values |= {f"{effect.label}.{key}": value for key, value in effect.parameters.items()}
        return values

    def untied(self, name: str) -> tuple[str, float]:
        """Return the parameter that determines this one by `ties`, and the factor; itself and 1 if none."""
        factor = 1.0
        while name in self.ties:
            name, tie = self.ties[name]
            factor *= tie
        return name, factor

    @cached_property
    def radius_parameters(self) -> dict[int, tuple[int, float]]:
        """Where `parameters` has each pulley's radius, by the index of the pulley in `coordinates`.

        A value is the index in `parameters` and the factor by which that parameter is multiplied to give the
        radius; the factor is 1 unless the radius is tied (`ties`).
        """
        columns = {name: column for column, name in enumerate(self.parameters)}
        rotary = [i for i, c in enumerate(self.coordinates) if c.kind == "rotary"]
        owners = {i: self.untied(f"{self.coordinates[i].name}.radius") for i in rotary}
        return {i: (columns[name], factor) for i, (name, factor) in owners.items()}

    def travel_per_unit_of(self, parameters: ParameterRows) -> Array:
        """Compute `travel_per_unit` of machines with other parameters, m/m or m/rad, shape (B, coordinates).

        Further columns of `parameters` are ignored.
        """
        travel = np.ones((len(parameters), len(self.coordinates)))
        for i, (column, factor) in self.radius_parameters.items():
            travel[:, i] = factor * parameters[:, column]
        return travel

    def with_tied(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return parameter values together with those of the parameters tied to them (`ties`).

        Args:
            values: Values by full name, SI: numbers or arrays.
        """
        owners = {tied: self.untied(tied) for tied in self.ties}
        return {**values, **{n: factor * values[o] for n, (o, factor) in owners.items() if o in values}}

    @cached_property
    def device_parameters(self) -> dict[str, float]:
        """Parameters of sensors and drives that do not enter the equations of motion, by full name.

        They can be randomized: `x_m.noise` and `x_m.resolution` (in its unit) of every sensor;
        `motor1.converter_bits` (number of bits) and `motor1.voltage_range` (V, by default the rated voltage)
        of every drive.
        """
        return {
            f"{component.label}.{key}": value
            for component in (*self.sensors, *self.drives)
            for key, value in component.device_parameters.items()
        }

    def variant(self, component: Component) -> Variant:
        """Return what a component's kind and its coordinate determine: units, defaults, absent attributes.

        Args:
            component: Coordinate, belt, drive or sensor; it need not be one of this machine, but the
                coordinates that it names must be.
        """
        if isinstance(component, Coordinate):
            return Coordinate.variant(component.kind)
        if isinstance(component, Drive):
            return Drive.variant(self.coordinate(component.coordinate).kind, component.kind)
        if isinstance(component, Sensor):
            return Sensor.variant(self.coordinate(self.coordinate_of_sensor(component)).kind, component.kind)
        return Variant()

    def unit(self, parameter: str) -> str:
        """Return the unit of a parameter, such as "Ns/m" of "x.viscous", or "1"; KeyError if unknown."""
        owner, _, key = parameter.rpartition(".")
        if effect := {e.label: e for e in self.effects}.get(owner):
            return self.effect_unit(effect, key)
        for component in (*self.sensors, *self.coordinates, *self.belts, *self.drives):
            if component.label == owner:
                declared = component.numbers().get(key)
                if declared is not None:
                    return self.variant(component).unit(key, declared)
                if isinstance(component, Drive) and key in component.law_parameters:
                    return self.variant(component).units[key]
        raise KeyError(f"machine {self.name!r} has no parameter {parameter}")

    def command_unit(self, drive: Drive) -> str:
        """Return the unit of a drive's command on this machine, such as V, or rad for a servo at a pulley."""
        return self.variant(drive).units["command"]

    def effect_unit(self, effect: AppliedEffect, parameter: str) -> str:
        """Return the unit of a parameter of an effect on its component: "N" at a carriage, "Nm" at a motor.

        The machine need not have the effect.

        Raises:
            KeyError: If the effect has no such parameter.
        """
        unit = effect.definition.parameter(parameter).unit
        if effect.definition.site == "sensor" and unit == "position" and effect.site in self.output_channels:
            return self.sensor_unit(self.sensor(effect.site))
        coordinate = self.coordinate_of_site(effect.site, effect.definition.site)
        return (FIXED_UNITS | (UNITS[self.coordinate(coordinate).kind] if coordinate else {})).get(unit, unit)

    def replace(self, values: Mapping[str, float] | None = None, **fields: object) -> Machine:
        """Return a copy of the machine with other parameter values, or with other values of its attributes.

        Args:
            values: New values by full name in `parameters` or `device_parameters`, SI. Tied parameters
                (`ties`) change with them; `converter_bits` are rounded to integers. None: no new values.
            **fields: New values of attributes of the machine, for example `name` or `drives`.

        Raises:
            KeyError: If a name in `values` is not a parameter of this machine.
            TypeError: If a machine has no attribute of a name in `fields`.
        """
        values = values or {}
        unknown = sorted(set(values) - set(self.parameters) - set(self.device_parameters))
        if unknown:
            meant = suggestion(unknown[0], (*self.parameters, *self.device_parameters))
            raise KeyError(f"machine {self.name!r} has no parameter {', '.join(unknown)}{meant}")
        values = self.with_tied(values)
        changed = {name.rpartition(".")[0] for name in values}

        def with_values(parts: Sequence[Any]) -> tuple[Any, ...]:
            return tuple(_with_values(part, values) if part.label in changed else part for part in parts)

        parts = (*_COMPONENTS.values(), "effects")
        new: dict[str, Any] = {name: with_values(getattr(self, name)) for name in parts} | fields
        return dataclasses.replace(self, **new)

    def with_components(
        self, *components: Component, ties: Mapping[str, tuple[str, float]] | None = None
    ) -> Machine:
        """Return a copy with these components; each replaces the one of its type and name, or is added.

        Args:
            *components: Coordinates, belts, drives and sensors, in any order.
            ties: Ties to add to those of the machine (`ties`).

        Raises:
            InputError: If one of these components names a coordinate, drive or belt that the machine does not
                have.
        """
        new: dict[str, Any] = {}
        for kind, name in _COMPONENTS.items():
            given = {c.label: c for c in components if isinstance(c, kind)}
            kept = [given.pop(part.label, part) for part in getattr(self, name)]
            new[name] = (*kept, *given.values())
        machine = dataclasses.replace(self, ties={**self.ties, **(ties or {})}, **new)
        for component in components:
            machine._check_references(component)
        return machine

    def _check_references(self, component: Component) -> None:
        """Raise an InputError if a component names another one that the machine does not have."""
        find: Callable[[str], Component] = self.coordinate
        names = list[str]()
        if isinstance(component, Drive):
            names = [component.coordinate]
        elif isinstance(component, Belt):
            names = list(component.extension)
        elif isinstance(component, Sensor):
            find = {"coordinate": self.coordinate, "drive": self.drive, "belt": self.belt}[
                component.sensed.component
            ]
            names = [factor for key in component.row for factor in key.split("*")]
        for name in names:
            try:
                find(name)
            except InputError as error:
                raise InputError(f"{type(component).__name__} {component.label!r}: {error}") from None

    def with_effects(self, *effects: AppliedEffect) -> Machine:
        """Return a copy with more effects; some also add components to the machine (`Effect.structure`).

        Raises:
            InputError: If an argument is not an `AppliedEffect`.
            ValueError: If the machine lacks the site of an effect or components that it needs, or already has
                the effect there.
        """
        machine = self
        for effect in effects:
            if not isinstance(effect, AppliedEffect):
                name = getattr(effect, "name", effect)
                raise InputError(
                    f"with_effects needs an effect at a site: EFFECTS[{name!r}].at(SITE, NAME=VALUE, ...)"
                )
            effect.check_site(machine)
            definition = effect.definition
            if definition.structure and definition.fits and not definition.fits(machine):
                reason = "it lacks components, or has the names of those that the effect adds"
                raise ValueError(f"effect {effect.name}: does not fit machine {self.name!r}: {reason}")
            machine = dataclasses.replace(machine, effects=(*machine.effects, effect))
            if definition.structure:
                machine = definition.structure(machine, effect)
        return machine

    def simulate(self, time_s: ArrayLike, inputs: ArrayLike, initial: ArrayLike | None = None) -> Trajectory:
        """Simulate the machine over a history of commands, each held until the next sample.

        `Trajectory` states the shape of each array of the result.

        Args:
            time_s: Times of N samples, s, strictly increasing, shape (N,).
            inputs: Command of each drive, in its unit (`command_unit`), usually V, shape (N, drives).
            initial: Positions (m, rad), then velocities (m/s, rad/s), at the first sample,
                shape (2 * coordinates,). Default: at rest at the origin with unstretched belts.

        Raises:
            ValueError: If the shapes do not fit the machine, times do not increase, or a value is not finite.
            ArithmeticError: If the simulated motion diverges (`dynamics.NotFiniteError`).
            RuntimeError: If no simulator is registered; `import hframe_gym` registers one.
        """
        if "default" not in SIMULATORS:
            raise RuntimeError("no simulator is registered; import hframe_gym before Machine.simulate")
        return SIMULATORS.get("default")(self, time_s, inputs, initial)


def require_machine(machine: object) -> None:
    """Raise an InputError if an argument is not a `Machine` (but a name or a path), or has impossible values.

    Readers of files check their values, but a program may have given a component a negative mass or NaN.
    """
    if not isinstance(machine, Machine):
        raise InputError(f"machine is {machine!r}; give a Machine, such as that of load_machine('hframe')")
    for component in (*machine.coordinates, *machine.belts, *machine.drives, *machine.sensors):
        component.require_possible()


def _with_values(part: Component | AppliedEffect, values: Mapping[str, float]) -> Any:
    """Return a component or effect with the parameters that `values` holds under `label.key`."""
    if isinstance(part, AppliedEffect):
        return part.with_parameters(
            {k: values.get(f"{part.label}.{k}", v) for k, v in part.parameters.items()}
        )
    keys = (*part.parameter_names, *part.names("device"))
    return part.with_values({key: values[name] for key in keys if (name := f"{part.label}.{key}") in values})
