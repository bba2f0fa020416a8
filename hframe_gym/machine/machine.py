"""A machine as tables: coordinates with a diagonal mass, belts that stretch, drives, sensors, effects.

Every model of the paper, a single axis and a stage with a yawing bridge are this one object.  A belt's extension is a
row of numbers times the coordinates' travel, s = G p (physics: V = 1/2 sum k s^2); its length is such a row too, so
its stiffness k = EA / length follows the carriage (eq. 38-44).  A rotary coordinate enters rows as belt travel
p = radius * angle, which makes the rows small whole numbers: the machine's topology.

Machines are immutable; `replace` returns a changed one.  Values are SI, in the coordinate's own unit (kg and N, or
kg m^2 and Nm).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..registry import Registry
from .effect import AppliedEffect

if TYPE_CHECKING:
    from ..dynamics.simulation import Trajectory

Array = NDArray[np.float64]
Row = Mapping[str, float]
Kind = Literal["linear", "rotary"]

# Units of a coordinate's own quantities; an effect's parameter may name one of these keys as its unit.
UNITS: dict[Kind, dict[str, str]] = {
    "linear": {
        "position": "m",
        "speed": "m/s",
        "mass": "kg",
        "force": "N",
        "viscous": "Ns/m",
        "stiffness": "N/m",
        "drag": "Ns^2/m^2",
        "rad/position": "rad/m",
    },
    "rotary": {
        "position": "rad",
        "speed": "rad/s",
        "mass": "kg m^2",
        "force": "Nm",
        "viscous": "Nms",
        "stiffness": "Nm/rad",
        "drag": "Nms^2",
        "rad/position": "1",
    },
}


@dataclass(frozen=True)
class Coordinate:
    """One degree of freedom.

    mass: kg or kg m^2.  viscous: Ns/m or Nms.  coulomb: N or Nm.  radius: of the pulley, m (rotary only).
    range: where the coordinate can go, m or rad (None: anywhere).
    """

    name: str
    mass: float
    viscous: float = 0.0
    coulomb: float = 0.0
    kind: Kind = "linear"
    radius: float = 1.0
    range: tuple[float, float] | None = None

    def unit(self, quantity: str) -> str:
        """The unit of this coordinate's position, speed, mass, force, viscous or stiffness."""
        return UNITS[self.kind][quantity]


@dataclass(frozen=True)
class Belt:
    """One elastic section: extension s = sum(extension[c] * travel[c]), k = EA / (rest_length + length . travel).

    EA: N.  rest_length: m, at zero travel.  An empty length row means a constant stiffness.
    """

    name: str
    EA: float
    rest_length: float
    extension: Row
    length: Row = field(default_factory=dict)


@dataclass(frozen=True)
class Drive:
    """A DC motor behind a gear: torque = gear_ratio * Kt/R * (V - Ke * gear_ratio * w)   (eq. 17 with its erratum).

    channel: the recording's input, e.g. v1_V.  Kt: Nm/A.  Ke: Vs/rad.  resistance: ohm.  rated_voltage: V.
    On a linear coordinate gear_ratio is rad/m.  converter_bits: resolution of the D/A converter (0: continuous), which
    covers -voltage_range to voltage_range (V; None: the rated voltage).
    """

    name: str
    channel: str
    coordinate: str
    Kt: float
    Ke: float
    resistance: float
    gear_ratio: float
    rated_voltage: float
    converter_bits: int = 0
    voltage_range: float | None = None

    @property
    def gain(self) -> float:
        """Force or torque per volt at rest, N/V or Nm/V."""
        return self.gear_ratio * self.Kt / self.resistance

    @property
    def back_emf(self) -> float:
        """Viscous friction that the short-circuited motor adds, Ns/m or Nms."""
        return self.gear_ratio**2 * self.Kt * self.Ke / self.resistance


class SensorKind:
    """Base class of sensor kinds: what a sensor outputs for an ideal reading.

    A kind is a subclass that registers itself, `@SENSOR_KINDS.register("name")`. Kinds are never instantiated.

    Attributes:
        incremental: Whether the sensor counts from where it was switched on. Its zero is then unknown, and elastic
            belts may lie between it and the tool.
    """

    incremental: ClassVar[bool] = False

    @staticmethod
    def measure(reading: Array, noise: ArrayLike, resolution: ArrayLike, normal: ArrayLike) -> Array:
        """Add noise to ideal readings and round them to the resolution.

        All arguments broadcast against each other; the unit is the channel's.

        Args:
            reading: Ideal readings, m or rad, any shape.
            noise: Standard deviation of the noise, m or rad.
            resolution: Quantum of the sensor, m or rad; 0 for a continuous sensor.
            normal: Samples of the standard normal distribution.

        Returns:
            Measured values, m or rad, in the broadcast shape.
        """
        value = np.asarray(reading + np.asarray(noise) * normal)
        quantum = np.broadcast_to(np.asarray(resolution, float), value.shape)
        return np.where(quantum > 0.0, np.rint(value / np.where(quantum > 0.0, quantum, 1.0)) * quantum, value)


SENSOR_KINDS: Registry[type[SensorKind]] = Registry("sensor kind")


@SENSOR_KINDS.register("encoder")
class Encoder(SensorKind):
    """An incremental encoder: it counts from where it was switched on."""

    incremental = True


@SENSOR_KINDS.register("laser")
class Laser(SensorKind):
    """A distance sensor with a fixed zero."""


@dataclass(frozen=True)
class Sensor:
    """A measured channel: reading = sum(row[c] * position[c]), in the coordinates' own units.

    A row's key may be a product, "y*yaw": the reading then has that coefficient times both positions.
    noise: standard deviation; resolution: quantum (0: none); both in the channel's unit.  kind: "encoder" for an
    incremental sensor, which counts from where it was switched on, or "laser" for one with a fixed zero.
    """

    channel: str
    row: Row
    noise: float = 0.0
    resolution: float = 0.0
    kind: str = "laser"

    @property
    def incremental(self) -> bool:
        """Whether the sensor counts from where it was switched on, so that its zero is unknown."""
        return SENSOR_KINDS.get(self.kind).incremental

    @property
    def coordinate(self) -> str:
        """The coordinate that it measures above all."""
        return max((c for c in self.row if "*" not in c), key=lambda c: abs(self.row[c]))


@dataclass(frozen=True)
class Uncertainty:
    """What identification left open: a covariance over named parameters (and, beside it, the evidence's size)."""

    names: tuple[str, ...]
    covariance: NDArray[np.float64]

    def std(self, name: str) -> float | None:
        """Standard deviation of a parameter, or None where it was not identified."""
        if name not in self.names:
            return None
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))


# The numbers of each table that may be fitted or randomised, and the units of those that do not follow a coordinate.
PARAMETERS: dict[type, tuple[str, ...]] = {
    Coordinate: ("mass", "viscous", "coulomb", "radius"),
    Belt: ("EA", "rest_length"),
    Drive: ("Kt", "Ke", "resistance", "gear_ratio"),
}
# The quantities of sensors and drives that the equations of motion do not use, but that randomization may vary.
DEVICE_PARAMETERS: dict[type, tuple[str, ...]] = {
    Sensor: ("noise", "resolution"),
    Drive: ("converter_bits", "voltage_range"),
}
FIXED_UNITS = {
    "radius": "m",
    "EA": "N",
    "rest_length": "m",
    "Kt": "Nm/A",
    "Ke": "Vs/rad",
    "resistance": "ohm",
    "gear_ratio": "1",
    "converter_bits": "1",
    "voltage_range": "V",
}


@dataclass(frozen=True)
class Machine:
    """The stage.  Build one from the built-in names or a file with `hframe_gym.load_machine`.

    ties: numbers of the tables that are no parameters of their own but a factor times one, by full name, e.g.
    {"phi3.radius": ("phi1.radius", 1.0)}: what a structural effect adds hangs on its parameters.
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

    @cached_property
    def coordinate_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.coordinates)

    @cached_property
    def input_channels(self) -> tuple[str, ...]:
        return tuple(d.channel for d in self.drives)

    @cached_property
    def output_channels(self) -> tuple[str, ...]:
        return tuple(s.channel for s in self.sensors)

    @cached_property
    def shape(self) -> tuple[object, ...]:
        """What a kernel is compiled for: the machine without its numbers, hashable."""
        return (
            tuple((c.name, c.kind) for c in self.coordinates),
            tuple((b.name, tuple(b.extension.items()), tuple(b.length.items())) for b in self.belts),
            tuple((d.name, d.coordinate) for d in self.drives),
            tuple((s.channel, tuple(s.row.items())) for s in self.sensors),
            tuple((e.definition, e.site) for e in self.effects),
            tuple(self.ties.items()),
        )

    def coordinate(self, name: str) -> Coordinate:
        return self.coordinates[self.coordinate_names.index(name)]

    def row(self, row: Row) -> NDArray[np.float64]:
        """A row over names as an array over all coordinates, shape (n,); products have no place in it."""
        return np.array([row.get(name, 0.0) for name in self.coordinate_names])

    @cached_property
    def radii(self) -> NDArray[np.float64]:
        """Travel per unit of each coordinate, shape (n,): pulley radius, or 1 for a linear one."""
        return np.array([c.radius if c.kind == "rotary" else 1.0 for c in self.coordinates])

    @cached_property
    def sensor_matrix(self) -> NDArray[np.float64]:
        """C of reading = C q, shape (sensors, coordinates), without products and effects."""
        return np.array([self.row(s.row) for s in self.sensors])

    def drive(self, name: str) -> Drive:
        return next(d for d in self.drives if d.name == name)

    def sensor(self, channel: str) -> Sensor:
        return next(s for s in self.sensors if s.channel == channel)

    def site_coordinate(self, site: str) -> str | None:
        """The coordinate of a site: itself, the drive's, or the one that the sensor measures; None for wider sites."""
        if site in self.coordinate_names:
            return site
        by_drive = {d.name: d.coordinate for d in self.drives}
        by_sensor = {s.channel: s.coordinate for s in self.sensors}
        return (by_drive | by_sensor).get(site)

    @cached_property
    def sprung(self) -> tuple[str, ...]:
        """Coordinates with a spring of their own, which an effect added: zero at rest."""
        return tuple(e.definition.coordinate for e in self.effects if e.definition.coordinate)

    def across(self, coordinate: str) -> str | None:
        """The other linear coordinate, where there are just two."""
        others = [c.name for c in self.coordinates if c.kind == "linear" and c.name != coordinate]
        return others[0] if len(others) == 1 else None

    @cached_property
    def parameters(self) -> dict[str, float]:
        """Every number that may be fitted or randomised, by its full name, e.g. `x.coulomb`, `left.EA`."""
        values: dict[str, float] = {}
        tables: tuple[Any, ...] = (*self.coordinates, *self.belts, *self.drives)
        for item in tables:
            names = {key: f"{item.name}.{key}" for key in PARAMETERS[type(item)]}
            values |= {name: getattr(item, key) for key, name in names.items() if name not in self.ties}
        for e in self.effects:
            values |= {f"{e.label}.{key}": value for key, value in e.parameters.items()}
        return values

    @cached_property
    def device_parameters(self) -> dict[str, float]:
        """Quantities of sensors and drives that the simulation kernel does not use, by full name.

        They are the noise and resolution of every sensor (`x_m.noise`, `x_m.resolution`, in the channel's unit) and
        the converter of every drive (`motor1.converter_bits`; `motor1.voltage_range`, V, by default the rated
        voltage). Domain randomization may vary them like `parameters`; `replace` accepts their names.
        """
        values: dict[str, float] = {}
        for sensor in self.sensors:
            values |= {f"{sensor.channel}.noise": sensor.noise, f"{sensor.channel}.resolution": sensor.resolution}
        for drive in self.drives:
            limit = drive.rated_voltage if drive.voltage_range is None else drive.voltage_range
            values |= {f"{drive.name}.converter_bits": drive.converter_bits, f"{drive.name}.voltage_range": limit}
        return values

    def unit(self, parameter: str) -> str:
        """The unit of a parameter or device parameter by its full name."""
        owner, _, key = parameter.rpartition(".")
        if key in DEVICE_PARAMETERS[Sensor] and owner in self.output_channels:
            return self.coordinate(self.sensor(owner).coordinate).unit("position")
        if owner in self.coordinate_names and key not in FIXED_UNITS:
            return self.coordinate(owner).unit("force" if key == "coulomb" else key)
        for e in self.effects:
            if e.label == owner:
                return self.effect_unit(e, key)
        return FIXED_UNITS[key]

    def effect_unit(self, effect: AppliedEffect, key: str) -> str:
        """The unit of an effect's parameter at its site (a friction level is N at x and Nm at a motor)."""
        unit = effect.definition.parameter(key).unit
        coordinate = self.site_coordinate(effect.site)
        return UNITS[self.coordinate(coordinate).kind].get(unit, unit) if coordinate else unit

    def replace(self, values: Mapping[str, float] | None = None, **fields: object) -> Machine:
        """This machine with other parameter values (by full name) and other fields.

        Raises KeyError for a name that is no parameter or device parameter of this machine.
        """
        values = dict(values or {})
        unknown = sorted(set(values) - set(self.parameters) - set(self.device_parameters))
        if unknown:
            raise KeyError(f"machine {self.name!r} has no parameter {', '.join(unknown)}")
        values |= {tied: factor * values[name] for tied, (name, factor) in self.ties.items() if name in values}

        def changed(item: Any) -> Any:
            keys = (*PARAMETERS.get(type(item), ()), *DEVICE_PARAMETERS.get(type(item), ()))
            name = item.channel if isinstance(item, Sensor) else item.name
            new: dict[str, Any] = {key: values[f"{name}.{key}"] for key in keys if f"{name}.{key}" in values}
            if "converter_bits" in new:
                new["converter_bits"] = round(new["converter_bits"])
            return dataclasses.replace(item, **new) if new else item

        effects = tuple(
            e.with_parameters({k: values.get(f"{e.label}.{k}", v) for k, v in e.parameters.items()})
            for e in self.effects
        )
        tables: dict[str, object] = {
            "coordinates": tuple(map(changed, self.coordinates)),
            "belts": tuple(map(changed, self.belts)),
            "drives": tuple(map(changed, self.drives)),
            "sensors": tuple(map(changed, self.sensors)),
            "effects": effects,
        }
        return dataclasses.replace(self, **(tables | fields))  # type: ignore[arg-type]

    def simulate(self, time_s: ArrayLike, inputs: ArrayLike, initial: ArrayLike | None = None) -> Trajectory:
        """The machine's free run; see `hframe_gym.dynamics.simulation`."""
        from ..dynamics.simulation import simulate  # the tables know nothing of kernels until one is asked for

        return simulate(self, time_s, inputs, initial)

    def with_effects(self, *effects: AppliedEffect) -> Machine:
        """This machine with more effects; structural ones change its tables."""
        machine = self
        for e in effects:
            machine = dataclasses.replace(machine, effects=(*machine.effects, e))
            if e.definition.structure:
                machine = e.definition.structure(machine, e)
        return machine
