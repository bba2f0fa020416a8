"""Let a position controller follow machine programs on a simulated stage, as real machines are recorded.

Programs: point-to-point moves with dwells, a rectangle, circles, jogs of one axis, and picks: two stations in
turn, at each of which y goes down, waits and goes up. The controller reads the motors' encoders once per row;
its voltages saturate and pass a 12-bit converter. The commanded voltage is therefore correlated with whatever
disturbs the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.reference_simulator import Array
from tests.reference_simulator.sensors import ENCODER_STEP_RAD, Sensors
from tests.rigs.random_excitation import CONVERTER_STEP_V, LIMITS_M, MAX_VOLTAGE_V, RESTING_S, Plant, Played

PROGRAMS = ("point to point", "rectangle", "circle", "jog")
PICKS = "picks"  # not one of `PROGRAMS`, over which sets of rigs cycle that were recorded before
_SETTLING_S = 0.8  # before the recording begins
_RADIUS_M = 0.0194
_REACH = 0.55  # of the travel
_VOLTS_PER_SPEED = 8.0  # V s/m, about the back-EMF and the viscous friction of the declared machine


@dataclass(frozen=True)
class Controller:
    """Controller of x and y with the same gains, from errors of position and speed to the axis's voltage.

    Attributes:
        proportional: Gain of the position error, V/m.
        derivative: Gain of the speed error, Vs/m.
        integral: Gain of the integrated position error, V/(ms); it does not integrate while a voltage
            saturates.
        feedforward: Gain of the reference's speed, Vs/m.
        filter_fraction: Fraction by which the measured speed follows the differences of two rows, in a row.
    """

    proportional: float
    derivative: float
    integral: float
    feedforward: float = _VOLTS_PER_SPEED
    filter_fraction: float = 0.2


def draw_controller(rng: np.random.Generator) -> Controller:
    """Draw a controller with integral and feedforward."""
    return Controller(rng.uniform(150.0, 500.0), rng.uniform(3.0, 10.0), rng.uniform(500.0, 3000.0))


def draw_path(kind: str, time_s: Array, start_xy: Array, rng: np.random.Generator) -> Array:
    """Draw the reference of a program.

    Args:
        kind: One of `PROGRAMS`, or `PICKS`.
        time_s: Sample times from the beginning of the run, s, shape (n,).
        start_xy: Position at the beginning, m, shape (2,).
        rng: Source of the draw.

    Returns:
        Reference of x and y, m, shape (n, 2); at rest in the first `RESTING_S`.
    """
    speed, acceleration = rng.uniform(0.15, 0.6), rng.uniform(2.0, 8.0)
    moving = np.maximum(time_s - RESTING_S, 0.0)
    if kind == "circle":
        radius = min(rng.uniform(0.02, 0.07), 0.4 * LIMITS_M[1])
        ramp = speed / acceleration
        travel = np.where(moving < ramp, 0.5 * acceleration * moving**2, speed * (moving - 0.5 * ramp))
        angle = rng.choice([-1.0, 1.0]) * travel / radius
        turned = radius * np.stack([np.cos(angle) - 1.0, np.sin(angle)], axis=1)
        first = rng.uniform(0.0, 2.0 * np.pi)
        rotation = np.array([[np.cos(first), -np.sin(first)], [np.sin(first), np.cos(first)]])
        return np.asarray(start_xy + turned @ rotation.T)
    places, dwells = _waypoints(kind, start_xy, rng)
    path, begin = np.tile(start_xy, (len(time_s), 1)).astype(float), 0.0
    for before, after, dwell in zip(places[:-1], places[1:], dwells, strict=True):
        length = float(np.linalg.norm(after - before))
        fraction, duration = _trapezoid(moving - begin, length, speed, acceleration)
        path += fraction[:, None] * (after - before)
        begin += duration + dwell
    return path


def _waypoints(kind: str, start_xy: Array, rng: np.random.Generator) -> tuple[list[Array], Array]:
    """Return the corners of a program, m, and the times of rest after each move, s."""
    reach = _REACH * LIMITS_M
    if kind == "rectangle":
        size = rng.uniform(0.3, 0.9, 2) * reach * -np.sign(start_xy + 1e-9)
        corners = [start_xy, start_xy + size * [1, 0], start_xy + size, start_xy + size * [0, 1]]
        return [*corners, *corners, start_xy], np.full(8, rng.choice([0.0, 0.05]))
    if kind == PICKS:
        stations = rng.uniform(-1.0, 1.0, (2, 2)) * reach
        down = np.array([0.0, rng.uniform(0.1, 0.4) * reach[1]])
        visits = [station - offset for station in stations for offset in (0.0 * down, down, 0.0 * down)]
        return [start_xy, *visits, *visits], np.tile([0.0, rng.uniform(0.05, 0.2), 0.0], 4)
    if kind == "jog":
        axis, places = int(rng.integers(2)), [start_xy]
        for _ in range(8):
            place = places[-1].copy()
            place[axis] = rng.uniform(-1.0, 1.0) * reach[axis]
            places.append(place)
        return places, rng.uniform(0.05, 0.4, 8)
    return [start_xy, *(rng.uniform(-1.0, 1.0, (8, 2)) * reach)], rng.uniform(0.02, 0.3, 8)


def _trapezoid(elapsed: Array, length: float, speed: float, acceleration: float) -> tuple[Array, float]:
    """Return the fraction of a move that is done (n,), and the duration of the move, s."""
    if length == 0.0:
        return np.zeros_like(elapsed), 0.0
    ramp = min(speed / acceleration, np.sqrt(length / acceleration))
    duration = 2.0 * ramp if ramp < speed / acceleration else ramp + length / speed
    t = np.clip(elapsed, 0.0, duration)
    left = duration - t
    top = acceleration * ramp
    done = np.where(t < ramp, 0.5 * acceleration * t**2, 0.5 * acceleration * ramp**2 + top * (t - ramp))
    done = np.where(left < ramp, length - 0.5 * acceleration * left**2, done)
    return done / length, float(duration)


def follow(
    plant_at: Callable[[float], Plant],
    sensors: Sensors,
    kind: str,
    time_s: Array,
    rng: np.random.Generator,
    clock: Callable[[Array], Array] | None = None,
    controller: Controller | None = None,
    gains: tuple[float, float] = (1.0, 1.0),
) -> Played:
    """Let a controller follow a program.

    Args:
        plant_at: Function that sets up the stage at a time, s.
        sensors: Sensors of the stage; the controller reads the encoders.
        kind: One of `PROGRAMS`, or `PICKS`.
        time_s: Nominal sample times, s, shape (n,).
        rng: Source of program and controller.
        clock: Function that returns the actual sample times, s, of the nominal ones. Default: the nominal
            ones.
        controller: The controller. Default: drawn by `draw_controller`.
        gains: Factors of the voltages that the drives receive; the recording does not know them.

    Returns:
        The run.
    """
    actual_s = time_s if clock is None else clock(time_s)
    period = float(time_s[1] - time_s[0])
    plant = plant_at(time_s[0] - _SETTLING_S)
    plant.step(np.zeros(2), time_s[0])
    control = controller or draw_controller(rng)
    reference = draw_path(kind, time_s - time_s[0], _axes(plant, sensors), rng)
    rate = np.gradient(reference, period, axis=0)
    inputs, states = np.zeros((len(time_s), 2)), np.empty((len(time_s), 8))
    last, speed, total = _axes(plant, sensors), np.zeros(2), np.zeros(2)
    for row in range(len(time_s)):
        states[row, :4], states[row, 4:] = plant.position, plant.velocity
        measured = _axes(plant, sensors)
        speed += control.filter_fraction * ((measured - last) / period - speed)
        last = measured
        error = reference[row] - measured
        axes = (
            control.proportional * error
            + control.derivative * (rate[row] - speed)
            + control.integral * total
            + control.feedforward * rate[row]
        )
        volts = np.array([-axes[0] - axes[1], axes[0] - axes[1]])
        if np.abs(volts).max() < MAX_VOLTAGE_V:
            total += error * period  # no integration while the voltage saturates
        if time_s[row] - time_s[0] < RESTING_S - 1e-9:
            volts, total = np.zeros(2), np.zeros(2)
        volts = np.clip(volts, -MAX_VOLTAGE_V, MAX_VOLTAGE_V)
        inputs[row] = np.round(volts / CONVERTER_STEP_V) * CONVERTER_STEP_V
        if row + 1 < len(time_s):
            plant.step(inputs[row] * gains, actual_s[row + 1])
    return Played(kind, "center", time_s, actual_s, inputs + 0.0, states[:, :4].copy(), states[:, 4:].copy())


def _axes(plant: Plant, sensors: Sensors) -> Array:
    """Return x and y, m, as the encoders measure them."""
    position = plant.position
    measured = sensors.graduated(np.array([position[2], position[3], position[0], position[1]]))[:2]
    phi = np.round(measured / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
    return 0.5 * _RADIUS_M * np.array([phi[1] - phi[0], -phi[0] - phi[1]])
