"""Integrate between the events of dry friction by Dormand and Prince's 5(4) pair, compiled.

A coordinate slides until its velocity is zero and sticks until the force on it exceeds the breakaway level.
Both events are located by a root search over the length of an actual integration step, so no interpolant
limits their accuracy. Everything else that is not smooth (clamps, gaps, |v|) is continuous, and the step-size
control resolves it.

References:
    Dormand and Prince (1980), A family of embedded Runge-Kutta formulae, J. Comp. Appl. Math. 6, 19-26.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tests.reference_simulator.equations import derivative
from tests.reference_simulator.parameter_arrays import ParameterArrays
from tests.reference_simulator.rig import Array

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
# A stuck coordinate is released at this relative excess over its breakaway level, so that its acceleration
# has the correct sign in spite of the rounding of the event's time.
RELEASE = 1e-9
_MAX_STEP_S = 0.5e-3  # events are looked for at the end of a step and at three points inside it
_TIME_TOLERANCE_S = 1e-12  # two times closer than this are the same
_MAX_EVENTS = 10_000  # per call; more means that the events accumulate


@njit(cache=True)
def _step(
    t: float,
    z: Array,
    h: float,
    volts: Array,
    mode: Array,
    arrays: ParameterArrays,
    slopes: Array,
    force: Array,
    level: Array,
    end: Array,
) -> None:  # pragma: no cover - compiled
    """Take one step of length h from z to `end`.

    The first row of slopes (7, len(z)) must be filled; the other rows are computed. Afterwards force and
    level (n,) are those at the end of the step.
    """
    for stage in range(6):
        for k in range(len(z)):
            total = 0.0
            for earlier in range(stage + 1):
                total += _A[stage, earlier] * slopes[earlier, k]
            end[k] = z[k] + h * total
        derivative(t + _C[stage] * h, end, volts, mode, arrays, slopes[stage + 1], force, level)


@njit(cache=True)
def _error(
    z: Array, end: Array, h: float, slopes: Array, rtol: float, atol: float
) -> float:  # pragma: no cover
    """Return the largest component of the embedded error estimate, divided by its tolerance."""
    worst = 0.0
    for k in range(len(z)):
        total = 0.0
        for stage in range(7):
            total += _E[stage] * slopes[stage, k]
        worst = max(worst, abs(h * total) / (atol + rtol * max(abs(z[k]), abs(end[k]))))
    return worst


@njit(cache=True)
def _margin(
    i: int, n: int, z: Array, mode: Array, force: Array, level: Array
) -> float:  # pragma: no cover - compiled
    """Return coordinate i's margin before its mode ends: its speed, or its force below breakaway."""
    if mode[i] != 0.0:
        return mode[i] * z[n + i]
    return level[i] * (1.0 + RELEASE) - abs(force[i])


@njit(cache=True)
def _event_fraction(
    i: int, n: int, z: Array, end: Array, h: float, mode: Array, slopes: Array, end_margin: float
) -> float:  # pragma: no cover - compiled
    """Return the fraction of the step at which the mode of coordinate i has ended; 0 if it has not.

    The velocity inside the step is taken from the cubic Hermite interpolant of both ends.
    """
    if mode[i] != 0.0:
        a, b = mode[i] * z[n + i], mode[i] * end[n + i]
        da, db = h * mode[i] * slopes[0, n + i], h * mode[i] * slopes[6, n + i]
        for quarter in range(1, 4):
            u = 0.25 * quarter
            w = 1.0 - u
            speed = (
                a * w * w * (1.0 + 2.0 * u) + da * u * w * w + b * u * u * (3.0 - 2.0 * u) - db * u * u * w
            )
            if speed < 0.0:
                return u
    return 1.0 if end_margin <= 0.0 else 0.0


@njit(cache=True)
def _update_modes_at_rest(
    t: float,
    z: Array,
    volts: Array,
    mode: Array,
    dry: Array,
    arrays: ParameterArrays,
    dz: Array,
    force: Array,
    level: Array,
) -> None:  # pragma: no cover - compiled
    """Set the modes of the coordinates at zero velocity, as the force may have jumped with the voltage."""
    n = len(mode)
    derivative(t, z, volts, mode, arrays, dz, force, level)
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
    arrays: ParameterArrays,
    rtol: float,
    atol: float,
) -> float:  # pragma: no cover - compiled
    """Integrate the state and the modes in place under constant voltages, event by event.

    Args:
        t: Start time, s.
        until: End time, s.
        h: Step length to begin with, s.
        z: State, shape (5 n + m + 9,), changed in place.
        volts: Voltages at the drives, V, shape (2,).
        mode: Modes of dry friction, shape (n,), changed in place.
        dry: Whether a coordinate has rigid dry friction, shape (n,).
        arrays: Parameters of the stage.
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step, in the units of the state.

    Returns:
        Step length to continue with, s; NaN if the state diverged or the events accumulate.
    """
    n, size = len(mode), len(z)
    slopes, end, probe = np.empty((7, size)), np.empty(size), np.empty((7, size))
    force, level = np.empty(n), np.empty(n)
    start_margin, end_margin = np.empty(n), np.empty(n)
    events = 0
    _update_modes_at_rest(t, z, volts, mode, dry, arrays, slopes[0], force, level)
    while until - t > _TIME_TOLERANCE_S:
        derivative(t, z, volts, mode, arrays, slopes[0], force, level)
        for i in range(n):
            start_margin[i] = _margin(i, n, z, mode, force, level)
        step = min(h, until - t, _MAX_STEP_S)
        _step(t, z, step, volts, mode, arrays, slopes, force, level, end)
        error = _error(z, end, step, slopes, rtol, atol)
        if not error < np.inf:
            return np.nan
        if error > 1.0:
            h = step * max(0.2, 0.9 * error**-0.2)
            continue
        for i in range(n):
            end_margin[i] = _margin(i, n, end, mode, force, level)
        first, first_step = -1, step  # the coordinate of the first event, and the time from t until then
        for i in range(n):
            if not dry[i]:
                continue
            fraction = _event_fraction(i, n, z, end, step, mode, slopes, end_margin[i])
            if fraction == 0.0:
                continue
            if start_margin[i] <= 0.0:
                # The coordinate has just begun to slide and stops again, or it should not have been stuck.
                event_step = 0.0 if mode[i] == 0.0 else 0.125 * step
            else:
                probe[0] = slopes[0]
                event_step = _event_step(
                    t, z, fraction * step, start_margin[i], i, volts, mode, arrays, probe, force, level, end
                )
            if first < 0 or event_step < first_step:
                first, first_step = i, event_step
        if first >= 0:
            events += 1
            if events > _MAX_EVENTS:
                return np.nan
            if first_step > 0.0:
                _step(t, z, first_step, volts, mode, arrays, slopes, force, level, end)
                z[:] = end
                t += first_step
            if mode[first] != 0.0:
                z[n + first] = 0.0
                mode[first] = 0.0
                derivative(t, z, volts, mode, arrays, slopes[0], force, level)
                if abs(force[first]) > level[first] * (1.0 + RELEASE):
                    mode[first] = np.sign(force[first])
            else:
                derivative(t, z, volts, mode, arrays, slopes[0], force, level)
                mode[first] = np.sign(force[first])
            continue
        z[:] = end
        t += step
        grown = step * min(5.0, 0.9 * max(error, 1e-10) ** -0.2)
        # A step that was cut short by the end of the interval is no reason to continue with a shorter one.
        h = max(h, grown) if step < h else grown
    return h


@njit(cache=True)
def _event_step(
    t: float,
    z: Array,
    longest: float,
    start_margin: float,
    i: int,
    volts: Array,
    mode: Array,
    arrays: ParameterArrays,
    slopes: Array,
    force: Array,
    level: Array,
    end: Array,
) -> float:  # pragma: no cover - compiled
    """Return the length of the step that ends at coordinate i's zero margin, by regula falsi (Illinois)."""
    n = len(mode)
    low, f_low, high = 0.0, start_margin, longest
    _step(t, z, high, volts, mode, arrays, slopes, force, level, end)
    f_high = _margin(i, n, end, mode, force, level)
    if f_high > 0.0:
        return longest  # the interpolant was slightly wrong: search again from there
    for _ in range(100):
        if high - low <= 1e-15:
            break
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        _step(t, z, middle, volts, mode, arrays, slopes, force, level, end)
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
