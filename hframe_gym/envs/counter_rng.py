"""Random numbers by counting: number `channel` of step `step` is a hash of (key, step, channel), whoever asks.

An episode's key is made of one 64-bit draw of its environment's own generator and of the episode's number; all else
that is random in the episode follows from it, in any order, batch, lane or thread.  The hash is the finaliser of
SplitMix64 (Steele, Lea and Flood 2014), applied after each of the three; normals are Box and Muller's (1958).
Logarithm, sine and cosine are polynomials, for the system's own would differ between systems.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

Function = TypeVar("Function", bound=Callable[..., Any])

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S11, _S27, _S30, _S31 = (np.uint64(n) for n in (11, 27, 30, 31))
_ONE = np.uint64(1)
# The draws of a reset stand at a step that no episode reaches.
RESET_STEP = 2**62


def compiled(function: Function) -> Function:
    """The function compiled by Numba, without the interpreter lock, kept on disk."""
    result: Any = njit(nogil=True, cache=True, error_model="numpy")(function)
    return result


@compiled
def _mix(z: Any) -> Any:
    z = (z ^ (z >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    return z ^ (z >> _S31)


@compiled
def uniform(key: Any, step: Any, channel: Any) -> float:
    """A number in (0, 1), uniform, never 0 or 1.  key: uint64."""
    z = _mix(np.uint64(key) + _GOLDEN)
    z = _mix(z + _GOLDEN * (np.uint64(step) + _ONE))
    z = _mix(z + _GOLDEN * (np.uint64(channel) + _ONE))
    return (np.float64(z >> _S11) + 0.5) * 2.0**-53


@compiled
def _log(x: float) -> float:
    """Natural logarithm of a positive number, to 1e-13."""
    fraction, exponent = math.frexp(x)
    if fraction < 0.7071067811865476:
        fraction, exponent = 2.0 * fraction, exponent - 1
    # atanh's series: |s| <= 0.172
    s = (fraction - 1.0) / (fraction + 1.0)
    square = s * s
    series = 1.0 / 15.0
    for n in (13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0):
        series = series * square + 1.0 / n
    return exponent * 0.6931471805599453 + 2.0 * s * series


@compiled
def turn(u: float) -> tuple[float, float]:
    """Cosine and sine of u turns, to 1e-15."""
    quarter = math.floor(4.0 * u + 0.5)
    r = (4.0 * u - quarter) * 1.5707963267948966
    s = r * r
    # Taylor to r**14 and r**15: |r| <= pi/4, remainders 1e-15 and 5e-17.
    cosine = 1.0 / 479001600 - s * (1.0 / 87178291200)
    sine = 1.0 / 6227020800 - s * (1.0 / 1307674368000)
    cosine = 1.0 - s * (0.5 - s * (1.0 / 24 - s * (1.0 / 720 - s * (1.0 / 40320 - s * (1.0 / 3628800 - s * cosine)))))
    sine = 1.0 / 120 - s * (1.0 / 5040 - s * (1.0 / 362880 - s * (1.0 / 39916800 - s * sine)))
    sine = r * (1.0 - s * (1.0 / 6 - s * sine))
    odd, back = (quarter & 1) == 1, (quarter & 2) == 2
    along, across = (-sine, cosine) if odd else (cosine, sine)
    return (-along, -across) if back else (along, across)


@compiled
def normal_pair(key: Any, step: Any, channel: Any) -> tuple[float, float]:
    """Two independent standard normal numbers; takes the uniform numbers channel and channel + 1."""
    radius = math.sqrt(-2.0 * _log(uniform(key, step, channel)))
    cosine, sine = turn(uniform(key, step, channel + 1))
    return radius * cosine, radius * sine


@compiled
def _fill(keys: Any, out: Any) -> None:
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = uniform(keys[i], RESET_STEP, j)


def reset_uniforms(keys: NDArray[np.uint64], count: int) -> NDArray[np.float64]:
    """`count` uniform numbers (k, count) in (0, 1) for the resets with keys (k,)."""
    out = np.empty((len(keys), count))
    _fill(keys, out)
    return out


def episode_keys(keys: NDArray[np.uint64], episodes: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Keys (k,) of episodes number `episodes` (k,) of environments with keys (k,): SplitMix64's sequence of seeds."""
    return keys + _GOLDEN * episodes.astype(np.uint64)
