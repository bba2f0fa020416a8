"""Play identification runs of several kinds on a simulated stage, and choose how they start.

Kinds of excitation: steps; steps of one motor only; slow triangles; multisines; random telegraph signals;
point-to-point moves under a PD controller on the encoders. Kinds of start: at rest in the center; at rest
elsewhere; after a jog of one or both motors, which leaves the belts stretched by what friction holds. Near
the end of the travel the stage is driven back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tests.reference_simulator import Array
from tests.reference_simulator.sensors import ENCODER_STEP_RAD

LIMITS_M = np.array([0.25, 0.16])  # travel of x and y that the runs use
CONVERTER_STEP_V = 20.0 / 4096  # 12 bits over +-10 V
MAX_VOLTAGE_V = 8.0
KINDS = ("steps", "single", "triangle", "multisine", "telegraph", "moves")
STARTS = ("center", "elsewhere", "jog")
RESTING_S = 0.1  # at 0 V at the beginning of every run
_SETTLING_S = 0.4  # before the recording begins
_RADIUS_M = 0.0194
_MARGIN_M = 0.03
_AHEAD_S = 0.06  # the stage coasts for about as long without voltage


class Plant(Protocol):
    """Simulated stage that advances step by step.

    Attributes:
        position: x, y of the tool, m, and phi1, phi2 of the encoders, rad, shape (4,).
        velocity: Rates of the positions, shape (4,).
    """

    @property
    def position(self) -> Array: ...  # noqa: D102 - described above

    @property
    def velocity(self) -> Array: ...  # noqa: D102 - described above

    def step(self, volts: Array, until_s: float) -> None:
        """Hold the voltages of the two motors until a time, s."""


@dataclass(frozen=True)
class Played:
    """One run.

    Attributes:
        kind: Kind of excitation.
        start: Kind of start.
        time_s: Times that the recording states, s, shape (n,).
        actual_s: Times at which the samples were taken and the voltages set, s, shape (n,).
        inputs: Voltages of the motors, V, each held until the next row, shape (n, 2).
        positions: x, y, m; phi1, phi2, rad, at the actual times, shape (n, 4).
        velocities: Rates of the positions, shape (n, 4).
    """

    kind: str
    start: str
    time_s: Array
    actual_s: Array
    inputs: Array
    positions: Array
    velocities: Array


# Maps time since the first move, s, and the measured x and y, m, to the voltages of the axes, V.
Excitation = Callable[[float, Array], Array]


def draw_start(kind: str, rng: np.random.Generator, fraction: float) -> tuple[float, float]:
    """Return the position of the carriage at which a run's stage is set up, m.

    Args:
        kind: One of `STARTS`.
        rng: Source of the draw.
        fraction: Fraction of the travel in which runs start.

    Returns:
        x and y.
    """
    if kind == "center":
        return 0.0, 0.0
    x, y = np.round(rng.uniform(-fraction, fraction, 2) * LIMITS_M, 4)
    return float(x), float(y)


def play(
    plant_at: Callable[[float], Plant],
    kind: str,
    start: str,
    time_s: Array,
    rng: np.random.Generator,
    jitter_s: float = 0.0,
    gains: tuple[float, float] = (1.0, 1.0),
    clock: Callable[[Array], Array] | None = None,
) -> Played:
    """Play one run.

    Args:
        plant_at: Function that sets up the stage at a time, s.
        kind: One of `KINDS`.
        start: One of `STARTS`.
        time_s: Nominal sample times, s, shape (n,).
        rng: Source of the excitation.
        jitter_s: Standard deviation of the actual sample times, s.
        gains: Factors of the voltages that the drives receive; the recording does not know them.
        clock: Function that returns the actual sample times, s, of the nominal ones, in place of the jitter.

    Returns:
        The run.
    """
    rows, period = len(time_s), time_s[1] - time_s[0]
    actual_s = time_s + np.clip(jitter_s * rng.standard_normal(rows), -0.4 * period, 0.4 * period)
    actual_s[0] = time_s[0]
    if clock is not None:
        actual_s = clock(time_s)
    plant = plant_at(time_s[0] - 2.0 * _SETTLING_S)
    if start == "jog":
        _jog(plant, time_s[0] - 2.0 * _SETTLING_S, rng)
    plant.step(np.zeros(2), time_s[0])
    only = int(rng.integers(2)) if kind == "single" else None
    excitation = _excitation(kind, rng, time_s[-1] - time_s[0], only)
    inputs, states = np.zeros((rows, 2)), np.empty((rows, 8))
    returning = np.zeros(2, bool)
    for row in range(rows):
        states[row, :4], states[row, 4:] = plant.position, plant.velocity
        if time_s[row] - time_s[0] >= RESTING_S - 1e-9:
            phi = np.round(states[row, 2:4] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
            measured = 0.5 * _RADIUS_M * np.array([phi[1] - phi[0], -phi[0] - phi[1]])
            axes = excitation(time_s[row] - time_s[0] - RESTING_S, measured)
            ahead = measured + (0.0 if kind == "moves" else _AHEAD_S) * states[row, 4:6]
            returning = (np.abs(ahead) > LIMITS_M - _MARGIN_M) | (
                returning & (np.abs(measured) > 0.5 * LIMITS_M)
            )
            axes = np.where(returning, np.clip(-40.0 * measured, -4.0, 4.0), axes)
            inputs[row] = _volts(axes, only)
        if row + 1 < rows:
            plant.step(inputs[row] * gains, actual_s[row + 1])
    return Played(kind, start, time_s, actual_s, inputs + 0.0, states[:, :4].copy(), states[:, 4:].copy())


def _volts(axes: Array, only: int | None) -> Array:
    """Return the motors' voltages for those of the axes, limited and rounded as the converter does."""
    volts = np.array([-axes[0] - axes[1], axes[0] - axes[1]])  # r phi1 = -x - y, r phi2 = x - y
    if only is not None:
        volts[1 - only] = 0.0
    volts *= min(1.0, MAX_VOLTAGE_V / max(float(np.abs(volts).max()), 1e-9))
    return np.round(volts / CONVERTER_STEP_V) * CONVERTER_STEP_V


def _jog(plant: Plant, start_s: float, rng: np.random.Generator) -> None:
    """Move the stage by one or both motors before the recording begins."""
    toward = -np.sign(plant.position[:2] + 1e-9)
    volts = np.array([-toward[0] - toward[1], toward[0] - toward[1]])
    volts[int(rng.integers(2))] *= float(rng.integers(2))
    if not volts.any():
        volts[:] = -toward[1], -toward[1]
    volts *= rng.uniform(2.0, 5.0) / np.abs(volts).max()
    plant.step(volts, start_s + float(rng.uniform(0.1, 0.3)))


def _excitation(kind: str, rng: np.random.Generator, length_s: float, only: int | None) -> Excitation:
    """Return the excitation of a run; `only` is the motor that a run of kind "single" drives."""
    if kind in ("steps", "single"):
        return _steps(rng, length_s, only)
    if kind == "triangle":
        return _triangle(rng)
    if kind == "multisine":
        hertz = np.exp(rng.uniform(np.log(0.7), np.log(60.0), (int(rng.integers(4, 9)), 2)))
        phase, level = rng.uniform(0.0, 2.0 * np.pi, hertz.shape), rng.uniform(2.5, 6.0) / np.sqrt(len(hertz))
        return lambda t, _: level * np.sin(2.0 * np.pi * hertz * t + phase).sum(axis=0)
    if kind == "telegraph":
        return _telegraph(rng, length_s)
    return _moves(rng, length_s)


def _steps(rng: np.random.Generator, length_s: float, only: int | None) -> Excitation:
    """Return random levels, held for 0.1 to 0.5 s; with one motor alternating in sign, along its diagonal."""
    ends = np.cumsum(rng.uniform(0.1, 0.5, int(length_s / 0.1) + 2))
    levels = rng.uniform(1.0, 4.0, (len(ends), 2)) * rng.choice([-1.0, 1.0], (len(ends), 2))
    levels[rng.random(len(ends)) < 0.2] = 0.0
    if only is not None:
        levels[:, 0] = levels[:, 1] = np.abs(levels[:, 0]) * np.where(np.arange(len(ends)) % 2, 1.0, -1.0)
        mirror = np.array([1.0, 1.0]) if only == 0 else np.array([-1.0, 1.0])
        return lambda t, _: levels[np.searchsorted(ends, t)] * mirror
    return lambda t, _: levels[np.searchsorted(ends, t)]


def _triangle(rng: np.random.Generator) -> Excitation:
    """Return slow triangles of voltage through zero speed, of one or both axes."""
    period = rng.uniform(0.8, 2.0, 2)
    level = rng.uniform(1.2, 3.0, 2) * rng.choice([-1.0, 1.0], 2)
    level *= np.array([(1.0, 1.0), (1.0, 0.0), (0.0, 1.0)][int(rng.integers(3))])
    return lambda t, _: level * (1.0 - 4.0 * np.abs((t / period + 0.25) % 1.0 - 0.5))


def _telegraph(rng: np.random.Generator, length_s: float) -> Excitation:
    """Return a level of random sign per axis, which may change every 10 to 40 ms."""
    hold, level = rng.uniform(0.01, 0.04), rng.uniform(1.5, 4.0, 2)
    signs = rng.choice([-1.0, 1.0], (int(length_s / hold) + 2, 2))
    return lambda t, _: level * signs[int(t / hold)]


def _moves(rng: np.random.Generator, length_s: float) -> Excitation:
    """Return point-to-point moves under a PD controller on the encoders, with steps as references."""
    ends = np.cumsum(rng.uniform(0.3, 0.9, int(length_s / 0.3) + 2))
    targets = rng.uniform(-0.6, 0.6, (len(ends), 2)) * LIMITS_M
    proportional, derivative = rng.uniform(60.0, 200.0), rng.uniform(0.5, 3.0)
    last: list[tuple[float, Array]] = []

    def control(t: float, measured: Array) -> Array:
        rate = np.zeros(2)
        if last:
            before, position = last.pop()
            rate = (measured - position) / max(t - before, 1e-6)
        last.append((t, measured))
        return proportional * (targets[np.searchsorted(ends, t)] - measured) - derivative * rate

    return control
