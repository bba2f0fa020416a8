"""The voltage histories of a good identification session on the H-frame stage.

A run strings together moves of 0.3 to 0.8 s: steps, square waves, slow ramps through zero speed,
chirps, multi-sines (open loop), or a crude position P-controller with dither on slow triangles and
fast point-to-point moves (closed loop, on the encoders). Each move drives x, y or both. A person
at a rig watches its travel, and so does this: near the end of an axis the move gives way to a
drive back to the middle, so every history is played on a reference stage as it is made. What is
recorded is the voltages, as on a real rig.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.reference_simulator import Array, Rig, Stage
from tests.reference_simulator.sensors import ENCODER_STEP_RAD

LIMIT_X_M, LIMIT_Y_M = 0.25, 0.16
VOLTAGE_STEP_V = 0.005  # about the step of a 12-bit converter over +-10 V
MAX_VOLTAGE_V = 8.0

OPEN_MOVES = ("step", "ramp", "square", "chirp", "multisine")
CLOSED_MOVES = ("slow", "fast")


@dataclass(frozen=True)
class PreparedRecording:
    """One run: what was commanded, and what the stage it was made on did (noise-free)."""

    time_s: Array  # (n,) on the session's clock [s]
    inputs: Array  # (n, 2) voltages, held from their row until the next [V]
    start_xy: tuple[float, float]  # [m]
    positions: Array  # (n, 4) x, y [m], phi1, phi2 [rad]
    velocities: Array  # (n, 4)


# A move: (time since its start, measured place of the axis) -> voltage of the axis.
Move = Callable[[float, float], float]


def _open_move(kind: str, rng: np.random.Generator, length_s: float, toward: float) -> Move:
    """One open-loop move of an axis; ``toward`` is the sign of the direction to the middle."""
    if kind == "step":
        level = toward * rng.uniform(1.0, MAX_VOLTAGE_V)
        pulse = min(length_s, rng.uniform(0.06, 0.14) * MAX_VOLTAGE_V / abs(level))
        return lambda t, _: level if t < pulse else 0.0
    if kind == "ramp":
        # Passes through zero speed slowly, and turns the stage round.
        level = toward * rng.uniform(0.8, 2.5)
        return lambda t, _: level * (1.0 - 2.0 * t / length_s)
    if kind == "square":
        level, period = toward * rng.uniform(1.0, 6.0), rng.uniform(0.08, 0.25)
        # A first quarter period puts the travel's middle at the start.
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


def _closed_move(kind: str, rng: np.random.Generator, length_s: float, place: float, limit: float) -> Move:
    """One move of an axis under a P-controller with dither, whose target starts at ``place``."""
    gain = rng.uniform(80.0, 250.0)  # V/m
    toward = -1.0 if place > 0.0 else 1.0
    dither = rng.uniform(-0.3, 0.3, int(length_s / 0.005) + 2)
    if kind == "slow":
        # Triangle: both directions, at the speeds where friction depends on speed the most.
        speed, half = toward * rng.uniform(0.005, 0.05), 0.5 * length_s
        goal = place
    elif kind == "fast":
        speed = half = 0.0
        goal = toward * rng.uniform(0.2, 0.85) * limit
    else:
        speed = half = 0.0
        goal = place

    def move(t: float, at: float) -> float:
        target = goal + speed * (half - abs(t - half))
        return gain * (target - at) + dither[int(t / 0.005)]

    return move


def runs(
    seed: int,
    count: int,
    duration_s: float = 2.5,
    rate_hz: float = 1000.0,
    *,
    rig: Rig | None = None,
    rest_s: float = 0.1,
    closed: tuple[bool, ...] = (False, True),
    start_share: float = 0.6,
    rtol: float = 1e-8,
    atol: float = 1e-11,
) -> list[PreparedRecording]:
    """The runs of one session, the same for the same arguments.

    Args:
        seed, count: the session and its number of runs.
        duration_s, rate_hz: length and sampling rate of every run; n = duration_s * rate_hz rows.
        rig: the stage on which they are played, the paper's by default.
        rest_s: rows at 0 V at the beginning.
        closed: which runs are closed loop; run i takes ``closed[i % len(closed)]``.
        start_share: share of the travel in which runs start.
        rtol, atol: the reference's tolerances.
    """
    rig = rig or Rig()
    rng = np.random.default_rng(seed)
    clock, session = 0.0, []
    for index in range(count):
        rows = round(duration_s * rate_hz)
        time_s = np.round(clock + np.arange(rows) / rate_hz, 9)
        start = (
            float(np.round(rng.uniform(-start_share, start_share) * LIMIT_X_M, 4)),
            float(np.round(rng.uniform(-start_share, start_share) * LIMIT_Y_M, 4)),
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
) -> PreparedRecording:
    rows, r = len(time_s), stage.rig.pulley_radius_m
    limits = np.array([LIMIT_X_M, LIMIT_Y_M])
    inputs, states = np.zeros((rows, 2)), np.empty((rows, 8))
    moves: list[Move | None] = [None, None]
    began = ends = time_s[0] + rest_s
    returning = [False, False]
    for row in range(rows):
        states[row, :4], states[row, 4:] = stage.position, stage.velocity
        phi = np.round(stage.position[2:] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
        place = 0.5 * r * np.array([phi[1] - phi[0], -phi[0] - phi[1]])
        t = time_s[row]
        if t >= ends - 1e-9:
            began = t
            length = rng.uniform(0.3, 0.8)
            ends = began + length
            driven = rng.choice(["x", "y", "xy"], p=[0.3, 0.3, 0.4])
            for axis, name in enumerate("xy"):
                kinds = CLOSED_MOVES if closed else OPEN_MOVES
                kind = str(rng.choice(kinds))
                toward = -1.0 if place[axis] > 0.0 else 1.0
                if closed:
                    kind = kind if name in driven else "hold"
                    moves[axis] = _closed_move(kind, rng, length, place[axis], limits[axis])
                else:
                    move = _open_move(kind, rng, length, toward)
                    moves[axis] = move if name in driven else None
        if t >= time_s[0] + rest_s - 1e-9:
            axes = np.zeros(2)
            for axis in range(2):
                # Left alone the stage runs on for about 0.03 s: heed its speed too, unless a
                # controller is about to stop it.
                ahead = place[axis] + (0.0 if closed else 0.05) * states[row, 4 + axis]
                if abs(ahead) > limits[axis] - 0.02:
                    returning[axis] = True
                elif abs(place[axis]) < 0.5 * limits[axis]:
                    returning[axis] = False
                if returning[axis]:
                    axes[axis] = np.clip(-30.0 * place[axis], -3.0, 3.0)
                elif (move := moves[axis]) is not None:
                    axes[axis] = move(t - began, place[axis])
            # r phi1 = -x - y, r phi2 = x - y.
            volts = np.array([-axes[0] - axes[1], axes[0] - axes[1]])
            volts *= min(1.0, MAX_VOLTAGE_V / max(np.abs(volts).max(), 1e-9))
            inputs[row] = np.round(np.round(volts / VOLTAGE_STEP_V) * VOLTAGE_STEP_V, 3)
        if row + 1 < rows:
            stage.step(inputs[row], time_s[row + 1])
    return PreparedRecording(time_s, inputs + 0.0, start, states[:, :4].copy(), states[:, 4:].copy())
