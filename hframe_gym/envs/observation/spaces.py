"""Observation spaces: bounds of every entry, and the options `normalize`, `flat` and `error`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from ...arrays import Array
from ...dynamics.codegen.compiled import compiled
from ...errors import InputError
from ...machine import AXIS_UNITS, Drive, Machine, Sensor, observed_coordinates, rest_positions_per_axis
from ..workspace import workspace_of

# m, distance by which the bounds of positions exceed the workspace, because the end stops yield.
MARGIN = 0.05
# Bound of velocities / no-load speed of the drives; no motion that a drive can cause is so fast.
SPEED_FACTOR = 3.0

_FLOAT32 = np.dtype(np.float32)  # saves its construction in every step

# m, error at which the entries of `error` change from linear to logarithmic: about the precision that a
# policy without them reaches.
ERROR_SCALE = 1e-4


@dataclass(frozen=True)
class SignalSpec:
    """Name, unit and bounds of one entry of the observation arrays `observation` or `privileged`.

    Attributes:
        name: "<coordinate>", "<coordinate> velocity", "<channel>", "<channel> rate", or full name of a
            parameter.
        unit: Unit, for example "m" or "rad/s"; "1" for a parameter divided by its nominal value.
        coordinate: Coordinate of which the entry is the position or velocity; "" for a parameter.
        velocity: Whether the entry is a velocity.
        low: Lower bound, in `unit`.
        high: Upper bound, in `unit`.
        center: Value that `normalize=True` maps to 0, in `unit`: the middle of the range of a position or
            parameter.
        scale: Difference to `center` that `normalize=True` maps to 1, in `unit`: half the range of a position
            or parameter, the drives' no-load speed for a velocity.
    """

    name: str
    unit: str
    coordinate: str
    velocity: bool
    low: float
    high: float
    center: float
    scale: float


def state_signals(machine: Machine, names: Sequence[str] | None = None) -> tuple[SignalSpec, ...]:
    """Specify the entries of an observation of the true state: positions of coordinates, then velocities.

    Args:
        names: Names of coordinates. Default: the tool's axes and the driven coordinates.

    Raises:
        InputError: If the machine has no tool axes, a tool axis without range, or not one drive per tool
            axis.
    """
    workspace = workspace_of(machine)
    # m/s of belt: without load at rated voltage, times a margin
    fastest = max(_largest_speed(machine, drive, workspace) for drive in machine.drives)
    positions, velocities = [], []
    for name in observed_coordinates(machine) if names is None else names:
        c = machine.coordinate(name)
        if name in machine.tool_axes:
            positions.append(_tool_signal(machine, workspace, name))
        else:
            farthest, high = _largest_position(machine, name, workspace)
            positions.append(SignalSpec(name, c.unit("position"), name, False, -high, high, 0.0, farthest))
        speed = fastest / c.travel_per_unit
        bounds = -speed, speed, 0.0, speed / SPEED_FACTOR
        velocities.append(SignalSpec(f"{name} velocity", c.unit("speed"), name, True, *bounds))
    return (*positions, *velocities)


def _largest_speed(machine: Machine, drive: Drive, workspace: Array) -> float:
    """Return 3 times (`SPEED_FACTOR`) the speed along the belt that a drive can cause, m/s, without load.

    A drive without back-EMF reaches the lower of two speeds: that at which viscous friction holds its rated
    force, and that after the way along the workspace with its rated force.
    """
    coordinate = machine.coordinate(drive.coordinate)
    if drive.Ke > 0.0:
        return SPEED_FACTOR * drive.rated_voltage / (drive.Ke * drive.gear_ratio) * coordinate.travel_per_unit
    force = abs(drive.gain) * drive.rated_voltage / coordinate.travel_per_unit
    mass = coordinate.mass / coordinate.travel_per_unit**2
    travel = [machine.coordinate(axis).travel_per_unit for axis in machine.tool_axes]
    way = float(np.linalg.norm(np.ptp(workspace, axis=1) * travel))
    after_way = (2.0 * force * way / mass) ** 0.5
    viscous = coordinate.viscous / coordinate.travel_per_unit**2
    return SPEED_FACTOR * (min(after_way, force / viscous) if viscous > 0.0 else after_way)


def _tool_signal(machine: Machine, workspace: Array, name: str, label: str = "") -> SignalSpec:
    """Specify the position of the tool or of a goal along an axis, with a label before its name."""
    low, high = workspace[machine.tool_axes.index(name)].tolist()
    unit = machine.axis_unit
    margin = MARGIN * unit.per_meter
    span = low - margin, high + margin, 0.5 * (low + high), 0.5 * (high - low)
    return SignalSpec(f"{label}{name}", unit.name, name, False, *span)


def _largest_position(machine: Machine, name: str, workspace: Array) -> tuple[float, float]:
    """Return a coordinate's position at the farthest corner and its upper bound, 1.5 times that, m or rad.

    Both are at least `MARGIN` of travel.
    """
    total = 0.0
    per_axis = rest_positions_per_axis(machine)[machine.coordinate_names.index(name)]
    for ratio, edges in zip(per_axis, workspace, strict=True):
        total += abs(ratio) * float(np.abs(edges).max())
    margin = MARGIN / machine.coordinate(name).travel_per_unit
    return float(max(total, margin)), float(max(1.5 * total, margin))


def sensor_signals(machine: Machine, sensors: Sequence[Sensor]) -> tuple[SignalSpec, ...]:
    """Specify the entries of an observation by sensors: measurements, then the rates of the positions.

    A rate is the difference of the last two measurements divided by the control period. An entry has the name
    of the coordinate, or of the sensor's channel if several sensors measure its position, or if it is not a
    position.

    Raises:
        InputError: As `state_signals`.
    """
    coordinates = [machine.coordinate_of_sensor(sensor) for sensor in sensors]
    located = [name for name, sensor in zip(coordinates, sensors, strict=True) if sensor.of_position]
    specs = state_signals(machine, coordinates)
    signals = []
    for spec, sensor in zip(specs, (*sensors, *sensors), strict=True):
        if not sensor.of_position:
            if not spec.velocity:
                signals.append(_other_signal(machine, sensor))
            continue
        factor = sensor.row[sensor.coordinate]
        low, high = sorted((factor * spec.low, factor * spec.high))
        name = spec.name
        if located.count(sensor.coordinate) > 1:
            name = f"{sensor.channel} rate" if spec.velocity else sensor.channel
        bounds = low, high, factor * spec.center, abs(factor) * spec.scale
        signals.append(SignalSpec(name, spec.unit, spec.coordinate, spec.velocity, *bounds))
    return tuple(signals)


def _other_signal(machine: Machine, sensor: Sensor) -> SignalSpec:
    """Specify the measurement of a sensor of another quantity than a position."""
    name = machine.coordinate_of_sensor(sensor)
    coordinate = machine.coordinate(name)
    force = sum(  # along the belts, of all drives at standstill
        abs(d.gain) * d.rated_voltage / machine.coordinate(d.coordinate).travel_per_unit
        for d in machine.drives
    )
    match sensor.quantity:
        case "speed":
            largest = state_signals(machine, [name])[1].scale
        case "acceleration":
            largest = force * coordinate.travel_per_unit / coordinate.mass  # of the coordinate alone
        case "tension":
            largest = force
        case _:
            drive = machine.drive(sensor.coordinate)
            largest = drive.rated_voltage / drive.resistance
    largest *= abs(sensor.row[sensor.coordinate])
    bound = SPEED_FACTOR * largest
    return SignalSpec(sensor.channel, machine.sensor_unit(sensor), name, False, -bound, bound, 0.0, largest)


def privileged_signals(machine: Machine, bounds: Mapping[str, tuple[float, float]]) -> tuple[SignalSpec, ...]:
    """Specify the entries of `privileged`, observed by a critic: true state, randomized parameters.

    Args:
        bounds: For each randomized parameter, by full name ("x.mass"), the smallest and largest value that it
            can have, divided by its nominal value, dimensionless (SI if that is 0).

    Raises:
        InputError: As `state_signals`.
    """
    observed = [spec.coordinate for spec in state_signals(machine) if not spec.velocity]
    others = [name for name in machine.coordinate_names if name not in observed]
    parameters = []
    for name, (low, high) in bounds.items():
        half = 0.5 * (high - low)
        # A parameter with an infinite range, or with equal bounds, is not scaled.
        center, scale = (0.5 * (low + high), half) if 0.0 < half < np.inf else (1.0, 1.0)
        parameters.append(SignalSpec(name, "1", "", False, low, high, center, scale))
    return (*state_signals(machine, [*observed, *others]), *parameters)


def observation_signals(
    machine: Machine,
    previews: int = 0,
    *,
    observed: Sequence[SignalSpec] | None = None,
    privileged: Sequence[SignalSpec] = (),
) -> dict[str, tuple[SignalSpec, ...]]:
    """Specify name, unit and bounds of the entries of all arrays of an observation.

    Args:
        previews: Number of future goals in the observation; 0 for a goal that does not move.
        observed: Entries of the array `observation`. Default: positions and velocities of the tool's axes and
            the driven coordinates.
        privileged: Entries of the array `privileged` for a critic (true state, parameters). Default: no such
            array.

    Returns:
        Entries in order by key of the array; keys in alphabetical order, as in Gymnasium.

    Raises:
        InputError: As `state_signals`.
    """
    workspace = workspace_of(machine)

    def goal(label: str) -> tuple[SignalSpec, ...]:
        return tuple(_tool_signal(machine, workspace, axis, f"{label} ") for axis in machine.tool_axes)

    signals = {
        "achieved_goal": goal("achieved_goal"),
        "desired_goal": goal("desired_goal"),
        "observation": state_signals(machine) if observed is None else tuple(observed),
        "preview": tuple(signal for i in range(previews) for signal in goal(f"preview {i + 1}")),
        "privileged": tuple(privileged),
    }
    return {key: specs for key, specs in signals.items() if specs}


def observation_space(machine: Machine, previews: int = 0) -> spaces.Dict:
    """Create the observation space of an environment with default options and `previews` future goals.

    The arguments and errors are those of `observation_signals`. The boxes are bounded, float32, one for each
    key.
    """
    signals = observation_signals(machine, previews)
    return spaces.Dict({key: box(*bounds_of(specs)) for key, specs in signals.items()})


def box(low: NDArray[np.floating[Any]], high: NDArray[np.floating[Any]]) -> spaces.Box:
    """Create a box with float32 entries from `low` to `high`, in their units, shape (n,) each."""
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _error_signal(goal: SignalSpec) -> SignalSpec:
    """Specify the entry of `error` along the axis of a goal."""
    return SignalSpec(f"error {goal.coordinate}", "1", goal.coordinate, False, -1.0, 1.0, 0.0, 1.0)


def bounds_of(signals: Sequence[SignalSpec]) -> tuple[Array, Array]:
    """Return the lower and the upper bounds of n observation entries, in their units, shape (n,) each."""
    return np.array([s.low for s in signals]), np.array([s.high for s in signals])


class ObservationFormat:
    """Conversion of observations from SI units to the format that the environment's options select.

    The options are `normalize`, `flat` and `error`. Normalized entries are (value - center) / scale, computed
    in float32; `SignalSpec` documents center and scale. The array `error` has, for each axis, sign(e) log(1 +
    |e| / 0.1 mm) of e = desired_goal - achieved_goal (1 mrad along rotary axes), divided by its value for the
    largest possible error. A flat observation is one array that holds the keys in alphabetical order, as
    Gymnasium's `FlattenObservation` does.

    Args:
        signals: Specification of every entry, by key in alphabetical order.
        normalize: Whether to normalize.
        flat: Whether to join the keys into one array.
        error: Whether to add the array `error`.

    Attributes:
        active: Whether the conversion changes observations at all.
        entries: Specifications of all entries of a flat observation, in order; None if observations have
            keys.
        space: Observation space of one environment.
    """

    def __init__(
        self, signals: Mapping[str, Sequence[SignalSpec]], *, normalize: bool, flat: bool, error: bool = False
    ) -> None:
        self.active, self.normalize, self.error = normalize or flat or error, normalize, error
        self._center = {k: np.array([s.center for s in specs], np.float32) for k, specs in signals.items()}
        self._scale = {k: np.array([s.scale for s in specs], np.float32) for k, specs in signals.items()}
        goals = signals["desired_goal"]
        scale = np.array([ERROR_SCALE * AXIS_UNITS[s.unit].per_meter for s in goals])
        largest = np.array([s.high - s.low for s in goals])
        self._error_scale = scale.astype(np.float32)
        self._error_factor = (1.0 / np.log1p(largest / scale)).astype(np.float32)
        boxes = {}
        for key, specs in signals.items():
            edges = np.stack(bounds_of(specs)).astype(np.float32)
            # The bounds are converted by the same operations as the values, which therefore stay inside them.
            boxes[key] = tuple(self._normalized(key, edges) if normalize else edges)
        # The true state of `privileged` has the same entries as `observation`.
        named = {
            **signals,
            "privileged": [replace(s, name=f"privileged {s.name}") for s in signals.get("privileged", ())],
        }
        if error:
            named["error"] = [_error_signal(s) for s in signals["desired_goal"]]
            edges = np.stack(bounds_of(named["error"])).astype(np.float32)
            boxes["error"] = tuple(edges)
        self._keys = sorted(boxes)
        self.entries = tuple(spec for key in self._keys for spec in named[key]) if flat else None
        self.space: spaces.Space[Any] = (
            box(*(np.concatenate(edges) for edges in zip(*(boxes[key] for key in self._keys), strict=True)))
            if flat
            else spaces.Dict({key: box(*edges) for key, edges in boxes.items()})
        )

    @property
    def sizes(self) -> dict[str, int]:
        """Number of entries of each array of an observation before `apply`, by key."""
        return {key: len(center) for key, center in self._center.items()}

    def _normalized(self, key: str, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (values - center) / scale of the entries of a key, values (rows, n)."""
        normalized = np.empty(values.shape, _FLOAT32)
        _normalize(values, self._center[key], self._scale[key], normalized)
        return normalized

    def _errors(self, observation: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        """Return the array `error` of observations in SI units, shape (rows, axes)."""
        error = observation["desired_goal"] - observation["achieved_goal"]
        logarithm = np.log1p(np.abs(error) / self._error_scale) * self._error_factor
        return np.copysign(np.minimum(logarithm, np.float32(1.0)), error)

    def apply(self, observation: dict[str, NDArray[np.float32]]) -> Any:
        """Convert an `observation`, SI, float32, shape (n, entries of the key), to the selected format.

        Returns:
            With `flat`, one array of shape (n, all entries). Otherwise arrays by key of the same shapes, with
            a further array `error` if this option is set. Without any of the options, `observation` itself.
        """
        if not self.active:
            return observation
        values = {
            k: self._normalized(k, observation[k]) if self.normalize else observation[k] for k in self._center
        }
        if self.error:
            values["error"] = self._errors(observation)
        if self.entries is None:
            return {key: values[key] for key in self._keys} if self.error else values
        return np.concatenate([values[key] for key in self._keys], axis=1)

    def restore(self, observation: Any) -> dict[str, NDArray[np.float32]]:
        """Convert observations in the selected format back to arrays by key in SI units (inverse of `apply`).

        Returns:
            Arrays by key, SI, float32, shape (n, entries of the key); equal to those before `apply` but for
            the rounding of float32.

        Raises:
            InputError: If the observation has other keys or another number of entries than this format.
        """
        sizes = self.sizes
        if self.entries is not None:
            joined = np.asarray(observation, np.float32)
            if joined.ndim != 2 or joined.shape[1] != len(self.entries):
                raise InputError(f"observation has shape {joined.shape}, it must be (n, {len(self.entries)})")
            widths = [sizes.get(key, len(self._error_factor)) for key in self._keys]
            parts = np.split(joined, np.cumsum(widths)[:-1], axis=1)
            observation = dict(zip(self._keys, parts, strict=True))
        if not isinstance(observation, Mapping) or not set(sizes) <= set(observation):
            given = ", ".join(observation) if isinstance(observation, Mapping) else "one array"
            raise InputError(f"observation has {given}, it must have the keys {', '.join(sizes)}")
        restored = {}
        for key, size in sizes.items():
            values = np.asarray(observation[key], np.float32)
            if values.ndim != 2 or values.shape[1] != size:
                raise InputError(f"observation: {key} has shape {values.shape}, it must be (n, {size})")
            if self.normalize:
                exact = values.astype(np.float64) * self._scale[key] + self._center[key]
                values = exact.astype(np.float32)
            restored[key] = values
        return restored

    def goal_normalization(self) -> NDArray[np.float32]:
        """Return the centers (row 0) and scales (row 1) that normalize goals, m or rad, shape (2, axes).

        A normalized goal is (goal - center) / scale. Without the option `normalize`, the scales are 0: goals
        are then observed in m or rad.
        """
        center, scale = self._center["desired_goal"], self._scale["desired_goal"]
        return np.stack([center, scale if self.normalize else np.zeros_like(scale)])

    def goal_in_axis_unit(self, goal: ArrayLike) -> NDArray[np.float32]:
        """Convert an observed `goal`, shape (axes,) or (n, axes), to m or rad, float32."""
        values = np.asarray(goal, np.float32)
        return (
            values * self._scale["desired_goal"] + self._center["desired_goal"] if self.normalize else values
        )

    def goal_as_observed(self, goal: NDArray[np.float32]) -> NDArray[np.float32]:
        """Convert a `goal`, m or rad, float32, shape (n, axes), to one as observed (`normalize`); a copy."""
        return self._normalized("desired_goal", goal) if self.normalize else goal.copy()


@compiled
def _normalize(values: Any, center: Any, scale: Any, out: Any) -> None:
    """Write (values - center) / scale to out; values and out (rows, n), center and scale (n,), float32."""
    for b in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[b, j] = (values[b, j] - center[j]) / scale[j]
