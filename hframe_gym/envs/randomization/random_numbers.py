"""Random numbers of episodes, and joint normal samples of parameters from them.

Uniform and normal random numbers are counter-based: each is a hash of (key, step, channel). The key of an
episode is derived from one 64-bit number of its environment's generator and the number of the episode.
Everything else that is random in the episode follows from the key, independently of evaluation order, batch
size, SIMD lane and thread. Logarithm, sine and cosine are polynomials, because those of the C library differ
between systems.

`CorrelatedSampler` converts uniform numbers to parameters from their joint normal distribution within limits,
such that known sums of parameters are kept.

References:
    Steele, Lea and Flood, "Fast splittable pseudorandom number generators" (2014): the hash is the finalizer
    of SplitMix64, applied after each of the three inputs. Box and Muller, "A note on the generation of random
    normal deviates" (1958).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from ...arrays import Array, EpisodeKeys
from ...dynamics.codegen.compiled import compiled

# Constants of SplitMix64, as uint64, so that the arithmetic stays in integers of 64 bits.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S11, _S27, _S30, _S31 = (np.uint64(n) for n in (11, 27, 30, 31))
_ONE = np.uint64(1)
# Step of the random numbers that a reset uses; no episode reaches it.
RESET_STEP = 2**62
# Smallest number of `uniform`. The largest, as close to 1, rounds to 1, whose quantile can be infinite:
# resets use the number below it.
SMALLEST_UNIFORM, LARGEST_UNIFORM = 0.5 * 2.0**-53, 1.0 - 2.0**-53
_LARGEST_NORMAL = -float(ndtri(SMALLEST_UNIFORM))
_ROUNDING = 1e-12  # fraction of a variance below which a difference of variances is rounding


@compiled
def _mix(z: Any) -> Any:
    """Apply the finalizer of SplitMix64 to a 64-bit number."""
    z = (z ^ (z >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    return z ^ (z >> _S31)


@compiled
def uniform(key: Any, step: Any, channel: Any) -> float:
    """Generate one uniform random number in (0, 1], dimensionless, as a hash of a key and two counters.

    Equal arguments always give the same number; there is no internal state. The number is exactly 1 with
    probability 2^-53 only.

    Args:
        key: Key of the episode, which `episode_keys` derives from a seed, uint64.
        step: Number of the control period since the reset, from 0, integer; 2^62 (`RESET_STEP`) for the
            numbers that the reset itself uses.
        channel: Index of the random number within the step, from 0; integer.
    """
    z = _mix(np.uint64(key) + _GOLDEN)
    z = _mix(z + _GOLDEN * (np.uint64(step) + _ONE))
    z = _mix(z + _GOLDEN * (np.uint64(channel) + _ONE))
    return (np.float64(z >> _S11) + 0.5) * 2.0**-53


@compiled
def _log(x: float) -> float:
    """Return the natural logarithm of a positive normal number with a relative error below 1e-13."""
    # Fraction in [0.5, 1) and exponent by bits, not by `math.frexp`, so that the compiler vectorizes loops.
    bits: Any = np.float64(x).view(np.int64)
    exponent = (bits >> 52) - 1022
    fraction: Any = np.int64(bits & 0xFFFFFFFFFFFFF | 0x3FE0000000000000).view(np.float64)
    if fraction < 0.7071067811865476:
        fraction, exponent = 2.0 * fraction, exponent - 1
    # Series of the inverse hyperbolic tangent, |s| <= 0.172.
    s = (fraction - 1.0) / (fraction + 1.0)
    square = s * s
    series = 1.0 / 15.0
    for n in (13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0):
        series = series * square + 1.0 / n
    return exponent * 0.6931471805599453 + 2.0 * s * series


@compiled
def cos_sin_of_turns(u: Any) -> Any:
    """Compute cosine and sine of one angle in turns (1 turn is 2 pi rad), each with an error below 1e-15.

    Unlike results of the C library, they have the same bits on every system.

    Args:
        u: The angle, turns: a float, not an array; in compiled code also a SIMD register.

    Returns:
        Cosine and sine, dimensionless, of the type of `u`.
    """
    quarter = np.floor(4.0 * u + 0.5)  # nearest multiple of a quarter turn
    r = (4.0 * u - quarter) * 1.5707963267948966  # rest of the angle, rad, -pi/4 to pi/4
    s = r * r
    # Taylor series to r**14 and r**15; for |r| <= pi/4 the remainders are 1e-15 and 5e-17.
    cosine = 1.0 / 479001600 - s * (1.0 / 87178291200)
    sine = 1.0 / 6227020800 - s * (1.0 / 1307674368000)
    cosine = 1.0 - s * (
        0.5 - s * (1.0 / 24 - s * (1.0 / 720 - s * (1.0 / 40320 - s * (1.0 / 3628800 - s * cosine))))
    )
    sine = 1.0 / 120 - s * (1.0 / 5040 - s * (1.0 / 362880 - s * (1.0 / 39916800 - s * sine)))
    sine = r * (1.0 - s * (1.0 / 6 - s * sine))
    # Turn the vector (cosine, sine) of the rest by 0 to 3 quarter turns: by one if odd, then by two if at
    # least two.
    turns = quarter - 4.0 * np.floor(0.25 * quarter)
    odd, back = (turns == 1.0) | (turns == 3.0), turns >= 2.0
    first, second = -sine if odd else cosine, cosine if odd else sine
    return -first if back else first, -second if back else second


@compiled
def normal_pair(key: Any, step: Any, channel: Any) -> tuple[float, float]:
    """Generate two independent standard normal random numbers, dimensionless (Box and Muller 1958).

    They are computed from the uniform random numbers `channel` and `channel + 1` of the step, see `uniform`.
    """
    radius = math.sqrt(-2.0 * _log(uniform(key, step, channel)))
    cosine, sine = cos_sin_of_turns(uniform(key, step, channel + 1))
    return radius * cosine, radius * sine


@compiled
def normal_pairs(keys: Any, steps: Any, channel: Any, first: Any, second: Any) -> None:
    """Generate two independent normal random numbers for each of k episodes, as `normal_pair` does for one.

    Keys, uint64, steps, int64, and the outputs `first` and `second` have the shape (k,); the channel is
    common.
    """
    for i in range(len(keys)):
        first[i] = uniform(keys[i], steps[i], channel)
        second[i] = uniform(keys[i], steps[i], channel + 1)
    for i in range(len(keys)):
        first[i] = math.sqrt(-2.0 * _log(first[i]))
    for i in range(len(keys)):
        radius = first[i]
        cosine, sine = cos_sin_of_turns(second[i])
        first[i], second[i] = radius * cosine, radius * sine


@compiled
def _fill(keys: Any, out: Any) -> None:
    """Write the uniform numbers of the resets with keys (k,) to out (k, n)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = min(uniform(keys[i], RESET_STEP, j), LARGEST_UNIFORM)


def reset_uniforms(keys: EpisodeKeys, count: int) -> NDArray[np.float64]:
    """Generate `count` uniform numbers in (0, 1) for the reset of each of k episodes, shape (k, count)."""
    out = np.empty((len(keys), count))
    _fill(keys, out)
    return out


def episode_keys(keys: EpisodeKeys, episodes: NDArray[np.int64]) -> EpisodeKeys:
    """Derive the keys of new episodes in k environments; an episode's random numbers follow from its key.

    The keys of successive episodes of an environment differ by a constant, as do the states of the generator
    SplitMix64 (Steele, Lea and Flood 2014).

    Args:
        keys: Keys of the environments, one 64-bit random number each.
        episodes: Number of the new episode of each environment since it was seeded, from 0, shape (k,); -1
            gives the key for the parameters that are sampled once per seed.
    """
    return keys + _GOLDEN * episodes.astype(np.uint64)


def pivoted_cholesky(covariance: Array, scale: Array) -> Array:
    """Factorize a covariance matrix, which may be singular, into L L^T by the Cholesky method with pivoting.

    If z holds independent standard normal numbers, L z has this covariance. Column j of L contains the
    changes of all parameters with z[j]. Its pivot is the parameter with the largest variance that the columns
    before j do not explain (in units of `scale`). Example: if the sum of two parameters is known well and
    their difference is not, a single column contains nearly all of their variance, with opposite signs.

    Args:
        covariance: Symmetric positive semidefinite matrix of k parameters, SI, shape (k, k).
        scale: Typical sizes of the parameters, in whose units variances are compared, SI, positive,
            shape (k,).

    Returns:
        Factor L, SI, shape (k, k), with columns of 0 where no variance remains. Rows are in the order of the
        parameters, columns in the order of the pivots, so that L is triangular only after a permutation.

    References:
        Higham (2002), "Accuracy and Stability of Numerical Algorithms", section 10.3.
    """
    scaled = covariance / np.outer(scale, scale)
    variance = np.diag(scaled)
    factor, remaining = np.zeros_like(scaled), np.full(len(scaled), True)
    for column in range(len(scaled)):
        unexplained = np.where(remaining, variance - np.sum(factor**2, axis=1), -np.inf)
        pivot = int(np.argmax(unexplained))
        if (
            unexplained[pivot] > _ROUNDING * variance[pivot]
        ):  # otherwise the parameter follows from the earlier pivots
            change = (scaled[:, pivot] - factor @ factor[pivot]) / np.sqrt(unexplained[pivot])
            factor[:, column] = np.where(remaining, change, 0.0)
        remaining[pivot] = False
    return factor * scale[:, None]


class CorrelatedSampler:
    """Sample deviations of k parameters from their nominal values.

    The distribution is normal with a given covariance and truncated. Deviations are L z with the Cholesky
    factor L of the covariance and independent standard normal numbers z, which are truncated: z[j] keeps
    those parameters within their limits that get more than half of their variance from it. Clipping single
    parameters instead would change sums of parameters that are known well.

    Args:
        covariance: Covariance of the parameters, SI, shape (k, k).
        nominal: Nominal values, SI, shape (k,).
        lower: Smallest values, SI, shape (k,).
        upper: Largest values, SI, shape (k,).

    Attributes:
        reach: Largest possible absolute deviation of each parameter, SI, shape (k,).
    """

    def __init__(self, covariance: Array, nominal: Array, lower: Array, upper: Array) -> None:
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        size = np.where(nominal != 0.0, np.abs(nominal), np.where(std > 0.0, std, 1.0))
        self._factor = pivoted_cholesky(covariance, size)
        self._lowest, self._highest = np.zeros(len(nominal)), np.ones(len(nominal))  # probabilities by column
        main = self._factor**2 > 0.5 * np.sum(self._factor**2, axis=1, keepdims=True)
        for row, column in np.argwhere(main):
            slope = self._factor[row, column]
            near, far = sorted([(lower[row] - nominal[row]) / slope, (upper[row] - nominal[row]) / slope])
            self._lowest[column] = max(self._lowest[column], float(ndtr(near)))
            self._highest[column] = min(self._highest[column], float(ndtr(far)))
        self.reach: Array = np.abs(self._factor).sum(axis=1) * _LARGEST_NORMAL

    def deviations(self, uniforms: Array) -> Array:
        """Convert uniform numbers to deviations of k parameters from nominal values, SI, shape (n, k).

        Independent normal numbers are truncated so that each parameter stays within its limits by the one
        number that contributes more than half of its variance. What the others add can still exceed the
        limits.

        Args:
            uniforms: Independent random numbers, uniform in (0, 1), shape (n, k) for n samples.
        """
        probabilities = self._lowest + uniforms * (self._highest - self._lowest)
        normals = np.clip(ndtri(probabilities), -_LARGEST_NORMAL, _LARGEST_NORMAL)
        total = np.zeros_like(normals)
        # Term by term: a matrix product may add in another order for another batch size.
        for column, change in enumerate(self._factor.T):
            total += normals[:, column, None] * change
        return total
