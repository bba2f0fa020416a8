"""What the observation is read by: the full state, or the sensors of a rig.

The paper's rig (section II) has incremental encoders on the motors' shafts, 512 lines read in quadrature before a gear
of 5.9:1, and two lasers of 100 mm range on x and y that keep their last valid reading beyond it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, rest_state
from .spaces import SignalSpec, entries

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Encoders:
    """Counters on the shafts of the driven coordinates, homed where x = y = 0.  lines: a turn of the motor."""

    lines: int = 512

    def __post_init__(self) -> None:
        if not self.lines >= 1:
            raise ValueError(f"sensors: lines is {self.lines!r}, it must be at least 1")

    def quantum(self, gear_ratio: float) -> float:
        """Angle of one count behind the gear, rad; a line has four edges."""
        return 2.0 * math.pi / (4.0 * self.lines * gear_ratio)


@dataclass(frozen=True)
class Lasers:
    """Distance sensors on x and y.

    span: length of the range, m (inf: everywhere).  centre: (x, y) of its middle, m.  noise: standard deviation, m, of
    independent normal noise on each reading.  A reading sticks at the end of the range.
    """

    span: float = 0.1
    centre: tuple[float, float] = (0.0, 0.0)
    noise: float = 20e-6

    def __post_init__(self) -> None:
        if not self.span > 0.0:
            raise ValueError(f"sensors: span is {self.span!r}, it must be a positive number of metres")
        if not (math.isfinite(self.noise) and self.noise >= 0.0):
            raise ValueError(f"sensors: noise is {self.noise!r}, it must be a number of metres that is not negative")
        if len(self.centre) != 2 or not all(map(math.isfinite, self.centre)):
            raise ValueError(f"sensors: centre is {self.centre!r}, it must be (x, y) in m")


@dataclass(frozen=True)
class Sensors:
    """Encoders and lasers of a rig, None for those it lacks.

    Entries of the observation are those of the full state, as far as there is a sensor: positions are readings, and
    velocities the difference of the last two over the control period, unfiltered.  `achieved_goal` is what these
    sensors know of the tool: the laser's reading strictly inside its range, else the position that the encoders' angles
    mean on unstretched belts.  Effects of the machine's own sensors (skew, scale, range, delay) are about its
    recordings; they do not act on these.

    Raises ValueError without any sensor.
    """

    encoders: Encoders | None = Encoders()
    lasers: Lasers | None = Lasers()

    def __post_init__(self) -> None:
        if self.encoders is None and self.lasers is None:
            raise ValueError("sensors: neither encoders nor lasers; choose sensors='state' for the full state")


RIG = Sensors()
SensorsLike: TypeAlias = Literal["state", "rig"] | Sensors


def as_sensors(sensors: SensorsLike) -> Sensors | None:
    """Sensors by the name of a preset or themselves; None for the full state.

    Raises ValueError for an unknown name or another type.
    """
    if isinstance(sensors, Sensors):
        return sensors
    presets = {"state": None, "rig": RIG}
    if not isinstance(sensors, str) or sensors not in presets:
        raise ValueError(f"sensors is {sensors!r}, choose one of {', '.join(presets)} or a Sensors")
    return presets[sensors]


def sensed_entries(machine: Machine, sensors: Sensors | None) -> tuple[SignalSpec, ...]:
    """The entries of `observation` that there are sensors for."""
    known: set[str] = set()
    if sensors is None or sensors.lasers is not None:
        known |= {"x", "y"}
    if sensors is None or sensors.encoders is not None:
        known |= {d.coordinate for d in machine.drives}
    return tuple(e for e in entries(machine) if e.coordinate in known)


class Channels(NamedTuple):
    """The sensors as arrays for `blocks.sense`, one number a position that is read, in the order of the entries."""

    quanta: Array
    noise: Array
    least: Array
    most: Array
    tool: Array  # (2, channels), x and y on unstretched belts from the readings
    lasers: Index  # channels of the lasers on x and y, or -1


def channels(machine: Machine, sensors: Sensors) -> Channels:
    """The channels of sensors on a machine."""
    names = [e.coordinate for e in sensed_entries(machine, sensors) if not e.velocity]
    quanta, noise = np.zeros(len(names)), np.zeros(len(names))
    least, most = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    lasers = np.full(2, -1, np.intp)
    if sensors.lasers is not None:
        for axis, name in enumerate(("x", "y")):
            i = lasers[axis] = names.index(name)
            middle = sensors.lasers.centre[axis]
            noise[i] = sensors.lasers.noise
            least[i], most[i] = middle - sensors.lasers.span / 2, middle + sensors.lasers.span / 2
    tool = np.zeros((2, len(names)))
    if sensors.encoders is not None:
        driven = [d.coordinate for d in machine.drives]
        columns = [names.index(name) for name in driven]
        quanta[columns] = [sensors.encoders.quantum(d.gear_ratio) for d in machine.drives]
        tool[:, columns] = np.linalg.inv(_angles(machine, driven))
    return Channels(quanta, noise, least, most, tool, lasers)


def _angles(machine: Machine, driven: list[str]) -> Array:
    """Positions of the driven coordinates per metre of x and of y on unstretched belts, (2, 2)."""
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    rows = [machine.coordinate_names.index(name) for name in driven]
    columns = [rest_state(machine, [float(c == axis) for c in linear])[rows] for axis in ("x", "y")]
    return np.stack(columns, axis=1)
