"""Distributions by their quantile functions: what one makes of a uniform number in (0, 1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import exp10, ndtri

Array = NDArray[np.float64]


class Distribution(Protocol):
    """A distribution by its quantile function.

    bounded: whether all of it is between `quantile` of 0 and 1; a rule with such a distribution is checked when the
    environment is made, others at each draw.
    """

    @property
    def bounded(self) -> bool: ...

    def quantile(self, u: Array) -> Array:
        """Values (k,) for uniform numbers (k,) in (0, 1).  Each must depend on its own number alone, to the bit."""


@dataclass(frozen=True)
class Uniform:
    """Uniform on [low, high].  Raises ValueError unless both are finite and in order."""

    low: float
    high: float
    bounded = True

    def __post_init__(self) -> None:
        _check(self, math.isfinite(self.low) and math.isfinite(self.high) and self.low <= self.high)

    def quantile(self, u: Array) -> Array:
        return self.low + (self.high - self.low) * u


@dataclass(frozen=True)
class LogUniform:
    """Uniform in the logarithm on [low, high].  Raises ValueError unless both are positive, finite and in order."""

    low: float
    high: float
    bounded = True

    def __post_init__(self) -> None:
        _check(self, 0.0 < self.low <= self.high < math.inf)

    def quantile(self, u: Array) -> Array:
        # SciPy's exponential: NumPy's may round differently with the array's size.
        values: Array = self.low * exp10(math.log10(self.high / self.low) * u)
        return values


@dataclass(frozen=True)
class Normal:
    """Normal with a mean and a standard deviation.  Raises ValueError unless both are finite and std not negative."""

    mean: float
    std: float
    bounded = False

    def __post_init__(self) -> None:
        _check(self, math.isfinite(self.mean) and 0.0 <= self.std < math.inf)

    def quantile(self, u: Array) -> Array:
        return self.mean + self.std * np.asarray(ndtri(u))


def _check(distribution: Distribution, fine: bool) -> None:
    if not fine:
        raise ValueError(f"randomize: the distribution {distribution} is empty or not finite")
