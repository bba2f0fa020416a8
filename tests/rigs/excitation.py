"""Generate the voltage histories of an identification session by playing them on a reference stage.

A run is a sequence of moves of 0.3 to 0.8 s. In open loop these are steps, square waves, slow ramps through
zero velocity, chirps and multi-sines. In closed loop a proportional position controller with dither, on the
encoders, follows slow triangles or fast point-to-point moves. Each move drives x, y or both. As an operator
would, the generator watches the travel: near the end of an axis it replaces the move by a drive back to the
middle. Therefore a history depends on the stage on which it is played. The recorded inputs are the voltages,
as on a real rig.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.reference_simulator import Array, Rig, Stage
from tests.reference_simulator.sensors import ENCODER_STEP_RAD

LIMIT_X_M, LIMIT_Y_M = 0.25, 0.16
VOLTAGE_STEP_V = 0.005  # approximately the step of a 12-bit converter over +-10 V
MAX_VOLTAGE_V = 8.0

OPEN_MOVES = ("step", "ramp", "square", "chirp", "multisine")
CLOSED_MOVES = ("slow", "fast")


@dataclass(frozen=True)
class ExcitationRun:
    """One run: the commands, and the noise-free motion of the stage.

    Attributes:
        time_s: Sample times on the session's clock, s, shape (n,).
        inputs: Voltages, V, each held from its row until the next, shape (n, 2).
        start_xy: Position of the carriage at the first row, m.
        positions: x, y, m; phi1, phi2, rad; shape (n, 4).
        velocities: Rates of the positions, shape (n, 4).
    """

    time_s: Array
    inputs: Array
    start_xy: tuple[float, float]
    positions: Array
    velocities: Array


# A move maps the time since its start, s, and the measured position of the axis, m, to the voltage of the
# axis, V.
Move = Callable[[float, float], float]


def _open_move(kind: str, rng: np.random.Generator, length_s: float, toward: float) -> Move:
    """Return an open-loop move of an axis; `toward` is the sign of the way to the middle of the travel."""
    if kind == "step":
        level = toward * rng.uniform(1.0, MAX_VOLTAGE_V)
        pulse = min(length_s, rng.uniform(0.06, 0.14) * MAX_VOLTAGE_V / abs(level))
        return lambda t, _: level if t < pulse else 0.0
    if kind == "ramp":
        # Passes slowly through zero velocity and reverses the stage.
        level = toward * rng.uniform(0.8, 2.5)
        return lambda t, _: level * (1.0 - 2.0 * t / length_s)
    if kind == "square":
        level, period = toward * rng.uniform(1.0, 6.0), rng.uniform(0.08, 0.25)
        # The first quarter period centers the motion on the start position.
        return lambda t, _: level if (t / period + 0.25) % 1.0 < 0.5 else -level
    if kind == "chirp":
        level, low, high = rng.uniform(2.0, 5.0), rng.uniform(2.0, 5.0), rng.uniform(30.0, 80.0)
        rate = (high - low) / length_s
        return lambda t, _: level * np.cos(2.0 * np.pi * (low + 0.5 * rate * t) * t)
    if kind == "multisine":
        hertz = np.array([2.0, 5.0, 11.0, 23.0, 41.0, 57.0]) * rng.uniform(0.8, 1.2)
        phase = rng.uniform(0.0, 2.0 * np.pi, hertz.size)
        level = rng.uniform(0.8, 2.0)
        return lambda t, _: level * np.sin(2.0 * np.pi * hertz * t + phase).sum()
    raise ValueError(kind)


def _closed_move(kind: str, rng: np.random.Generator, length_s: float, position: float, limit: float) -> Move:
    """Return a move of an axis under a P-controller with dither, whose target starts at `position`, m."""
    gain = rng.uniform(80.0, 250.0)  # V/m
    toward = -1.0 if position > 0.0 else 1.0
    dither = rng.uniform(-0.3, 0.3, int(length_s / 0.005) + 2)
    if kind == "slow":
        # Triangle: both directions, at the speeds where friction depends most on speed.
        speed, half = toward * rng.uniform(0.005, 0.05), 0.5 * length_s
        goal = position
    elif kind == "fast":
        speed = half = 0.0
        goal = toward * rng.uniform(0.2, 0.85) * limit
    else:
        speed = half = 0.0
        goal = position

    def move(t: float, measured: float) -> float:
        target = goal + speed * (half - abs(t - half))
        return gain * (target - measured) + dither[int(t / 0.005)]

    return move


def record_runs(
    seed: int,
    count: int,
    duration_s: float = 2.5,
    rate_hz: float = 1000.0,
    *,
    rig: Rig | None = None,
    rest_s: float = 0.1,
    closed: tuple[bool, ...] = (False, True),
    start_fraction: float = 0.6,
    rtol: float = 1e-8,
    atol: float = 1e-11,
) -> list[ExcitationRun]:
    """Play the runs of one session. The same arguments give the same runs.

    Args:
        seed: Seed of the session.
        count: Number of runs.
        duration_s: Length of a run, s.
        rate_hz: Sampling rate, Hz; a run has n = duration_s * rate_hz rows.
        rig: Stage on which the runs are played. Default: the paper's.
        rest_s: Time at 0 V at the beginning of a run, s.
        closed: Whether a run is closed loop; run i uses `closed[i % len(closed)]`.
        start_fraction: Fraction of the travel in which runs start.
        rtol: Relative tolerance of the simulator.
        atol: Absolute tolerance of the simulator, SI.

    Returns:
        The runs, in the order of the session's clock.
    """
    rig = rig or Rig()
    rng = np.random.default_rng(seed)
    clock, session = 0.0, []
    for index in range(count):
        rows = round(duration_s * rate_hz)
        time_s = np.round(clock + np.arange(rows) / rate_hz, 9)
        start = (
            float(np.round(rng.uniform(-start_fraction, start_fraction) * LIMIT_X_M, 4)),
            float(np.round(rng.uniform(-start_fraction, start_fraction) * LIMIT_Y_M, 4)),
        )
        stage = Stage(rig.at_run(index), start, time_s[0], rtol=rtol, atol=atol)
        session.append(_play(stage, time_s, start, rest_s, closed[index % len(closed)], rng))
        clock = float(np.round(time_s[-1] + rng.uniform(5.0, 20.0), 3))
    return session


def _play(
    stage: Stage,
    time_s: Array,
    start: tuple[float, float],
    rest_s: float,
    closed: bool,
    rng: np.random.Generator,
) -> ExcitationRun:
    """Play a run on a stage at rest: choose moves, keep the carriage in the travel, record the motion."""
    rows, r = len(time_s), stage.rig.pulley_radius_m
    limits = np.array([LIMIT_X_M, LIMIT_Y_M])
    inputs, states = np.zeros((rows, 2)), np.empty((rows, 8))
    moves: list[Move | None] = [None, None]
    began = ends = time_s[0] + rest_s
    returning = [False, False]
    for row in range(rows):
        states[row, :4], states[row, 4:] = stage.position, stage.velocity
        phi = np.round(stage.position[2:] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
        position = 0.5 * r * np.array([phi[1] - phi[0], -phi[0] - phi[1]])
        t = time_s[row]
        if t >= ends - 1e-9:
            began = t
            length = rng.uniform(0.3, 0.8)
            ends = began + length
            driven = rng.choice(["x", "y", "xy"], p=[0.3, 0.3, 0.4])
            for axis, name in enumerate("xy"):
                kinds = CLOSED_MOVES if closed else OPEN_MOVES
                kind = str(rng.choice(kinds))
                toward = -1.0 if position[axis] > 0.0 else 1.0
                if closed:
                    kind = kind if name in driven else "hold"
                    moves[axis] = _closed_move(kind, rng, length, position[axis], limits[axis])
                else:
                    move = _open_move(kind, rng, length, toward)
                    moves[axis] = move if name in driven else None
        if t >= time_s[0] + rest_s - 1e-9:
            axes = np.zeros(2)
            for axis in range(2):
                # Without voltage the stage coasts for about 0.03 s, so its velocity counts as well, unless a
                # controller is about to stop it.
                ahead = position[axis] + (0.0 if closed else 0.05) * states[row, 4 + axis]
                if abs(ahead) > limits[axis] - 0.02:
                    returning[axis] = True
                elif abs(position[axis]) < 0.5 * limits[axis]:
                    returning[axis] = False
                if returning[axis]:
                    axes[axis] = np.clip(-30.0 * position[axis], -3.0, 3.0)
                elif (current := moves[axis]) is not None:
                    axes[axis] = current(t - began, position[axis])
            # r phi1 = -x - y, r phi2 = x - y.
            volts = np.array([-axes[0] - axes[1], axes[0] - axes[1]])
            volts *= min(1.0, MAX_VOLTAGE_V / max(np.abs(volts).max(), 1e-9))
            inputs[row] = np.round(np.round(volts / VOLTAGE_STEP_V) * VOLTAGE_STEP_V, 3)
        if row + 1 < rows:
            stage.step(inputs[row], time_s[row + 1])
    return ExcitationRun(time_s, inputs + 0.0, start, states[:, :4].copy(), states[:, 4:].copy())
