"""Dormand and Prince's 5(4) pair between the events of dry friction, compiled.

A coordinate slides until its speed is zero and sticks until the force on it exceeds the breakaway level. Both are found
by a root search over the length of a real step, so no interpolant limits their accuracy. Everything else that is not
smooth (clamps, gaps, |v|) is continuous, and the step-size control resolves it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tests.reference_simulator.equations import derivative
from tests.reference_simulator.rig import Array
from tests.reference_simulator.tables import Tables

# Dormand and Prince (1980), J. Comp. Appl. Math. 6, 19-26.
_A = np.array(
    [
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_C = np.array([1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
_E = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
# A stuck coordinate lets go this much (relative) above its breakaway level, so that it leaves with an acceleration of
# the right sign whatever the rounding of the event's time.
RELEASE = 1e-9
_LONGEST_S = 0.5e-3  # events are looked for at a step's end and thrice inside it
_INSTANT_S = 1e-12
_MOST_EVENTS = 10_000


@njit(cache=True)
def _step(
    t: float,
    z: Array,
    h: float,
    volts: Array,
    mode: Array,
    tables: Tables,
    slopes: Array,
    force: Array,
    level: Array,
    end: Array,
) -> None:  # pragma: no cover - compiled
    """One step of h from z into ``end``; slopes (7, N) has its first row filled and gets the rest.

    force and level (n,) are left as they are at the step's end.
    """
    for stage in range(6):
        for k in range(len(z)):
            total = 0.0
            for earlier in range(stage + 1):
                total += _A[stage, earlier] * slopes[earlier, k]
            end[k] = z[k] + h * total
        derivative(t + _C[stage] * h, end, volts, mode, tables, slopes[stage + 1], force, level)


@njit(cache=True)
def _error(z: Array, end: Array, h: float, slopes: Array, rtol: float, atol: float) -> float:  # pragma: no cover
    """Largest component of the embedded error, in units of its tolerance."""
    worst = 0.0
    for k in range(len(z)):
        total = 0.0
        for stage in range(7):
            total += _E[stage] * slopes[stage, k]
        worst = max(worst, abs(h * total) / (atol + rtol * max(abs(z[k]), abs(end[k]))))
    return worst


@njit(cache=True)
def _margin(i: int, n: int, z: Array, mode: Array, force: Array, level: Array) -> float:  # pragma: no cover - compiled
    """What coordinate i has left until its mode ends: speed, or force below breakaway."""
    if mode[i] != 0.0:
        return mode[i] * z[n + i]
    return level[i] * (1.0 + RELEASE) - abs(force[i])


@njit(cache=True)
def _suspect(
    i: int, n: int, z: Array, end: Array, h: float, mode: Array, slopes: Array, end_margin: float
) -> float:  # pragma: no cover - compiled
    """Share of the step by which coordinate i's mode has ended, by the cubic through both ends; 0: it has not."""
    if mode[i] != 0.0:
        a, b = mode[i] * z[n + i], mode[i] * end[n + i]
        da, db = h * mode[i] * slopes[0, n + i], h * mode[i] * slopes[6, n + i]
        for quarter in range(1, 4):
            u = 0.25 * quarter
            w = 1.0 - u
            speed = a * w * w * (1.0 + 2.0 * u) + da * u * w * w + b * u * u * (3.0 - 2.0 * u) - db * u * u * w
            if speed < 0.0:
                return u
    return 1.0 if end_margin <= 0.0 else 0.0


@njit(cache=True)
def _settle_modes(
    t: float, z: Array, volts: Array, mode: Array, dry: Array, tables: Tables, dz: Array, force: Array, level: Array
) -> None:  # pragma: no cover - compiled
    """Choose the modes of the coordinates that stand still: the force may have jumped."""
    n = len(mode)
    derivative(t, z, volts, mode, tables, dz, force, level)
    for i in range(n):
        if not dry[i]:
            mode[i] = 1.0
        elif z[n + i] == 0.0:
            mode[i] = 0.0 if abs(force[i]) <= level[i] * (1.0 + RELEASE) else np.sign(force[i])


@njit(cache=True)
def advance(
    t: float,
    until: float,
    h: float,
    z: Array,
    volts: Array,
    mode: Array,
    dry: Array,
    tables: Tables,
    rtol: float,
    atol: float,
) -> float:  # pragma: no cover - compiled
    """Integrate z and mode in place from t to ``until`` under constant voltages, event by event.

    Returns the step to go on with; NaN where the state blew up or the events do not end.
    """
    n, size = len(mode), len(z)
    slopes, end, probe = np.empty((7, size)), np.empty(size), np.empty((7, size))
    force, level = np.empty(n), np.empty(n)
    start_margin, end_margin = np.empty(n), np.empty(n)
    events = 0
    _settle_modes(t, z, volts, mode, dry, tables, slopes[0], force, level)
    while until - t > _INSTANT_S:
        derivative(t, z, volts, mode, tables, slopes[0], force, level)
        for i in range(n):
            start_margin[i] = _margin(i, n, z, mode, force, level)
        step = min(h, until - t, _LONGEST_S)
        _step(t, z, step, volts, mode, tables, slopes, force, level, end)
        error = _error(z, end, step, slopes, rtol, atol)
        if not error < np.inf:
            return np.nan
        if error > 1.0:
            h = step * max(0.2, 0.9 * error**-0.2)
            continue
        for i in range(n):
            end_margin[i] = _margin(i, n, end, mode, force, level)
        first, where = -1, step
        for i in range(n):
            if not dry[i]:
                continue
            share = _suspect(i, n, z, end, step, mode, slopes, end_margin[i])
            if share == 0.0:
                continue
            if start_margin[i] <= 0.0:
                # It has just begun to slide, and does not get away; or it should not have been stuck.
                at = 0.0 if mode[i] == 0.0 else 0.125 * step
            else:
                probe[0] = slopes[0]
                at = _root(t, z, share * step, start_margin[i], i, volts, mode, tables, probe, force, level, end)
            if first < 0 or at < where:
                first, where = i, at
        if first >= 0:
            events += 1
            if events > _MOST_EVENTS:
                return np.nan
            if where > 0.0:
                _step(t, z, where, volts, mode, tables, slopes, force, level, end)
                z[:] = end
                t += where
            if mode[first] != 0.0:
                z[n + first] = 0.0
                mode[first] = 0.0
                derivative(t, z, volts, mode, tables, slopes[0], force, level)
                if abs(force[first]) > level[first] * (1.0 + RELEASE):
                    mode[first] = np.sign(force[first])
            else:
                derivative(t, z, volts, mode, tables, slopes[0], force, level)
                mode[first] = np.sign(force[first])
            continue
        z[:] = end
        t += step
        grown = step * min(5.0, 0.9 * max(error, 1e-10) ** -0.2)
        # A step cut short by the piece's end says nothing against the longer one.
        h = max(h, grown) if step < h else grown
    return h


@njit(cache=True)
def _root(
    t: float,
    z: Array,
    longest: float,
    start_margin: float,
    i: int,
    volts: Array,
    mode: Array,
    tables: Tables,
    slopes: Array,
    force: Array,
    level: Array,
    end: Array,
) -> float:  # pragma: no cover - compiled
    """Length of the step at whose end coordinate i's margin is zero, by regula falsi (Illinois)."""
    n = len(mode)
    low, f_low, high = 0.0, start_margin, longest
    _step(t, z, high, volts, mode, tables, slopes, force, level, end)
    f_high = _margin(i, n, end, mode, force, level)
    if f_high > 0.0:
        return longest  # the interpolant was wrong by a hair: look again from there
    for _ in range(100):
        if high - low <= 1e-15:
            break
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        _step(t, z, middle, volts, mode, tables, slopes, force, level, end)
        f = _margin(i, n, end, mode, force, level)
        if abs(f) < 1e-15:
            return middle
        if f > 0.0:
            low, f_low = middle, f
            f_high *= 0.5
        else:
            high, f_high = middle, f
            f_low *= 0.5
    return high
