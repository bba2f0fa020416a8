"""Random forces on the tool while an episode runs, by name: white noise, a correlated process, and pulses.

A process is registered with `@DISTURBANCES.register("name")` and gives the forces of a batch of environments,
one control period after the other. `DisturbanceWrapper` lets them act on the simulated machine.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from typing_extensions import override

from ...arrays import Array
from ...errors import InputError
from ...registry import Registry


class Disturbance(Protocol):
    """Random process of forces.

    Its class is created with the keywords that the user gives.
    """

    def begin(self, shape: tuple[int, int], period: float, generator: np.random.Generator) -> Array:
        """Return the first forces of episodes.

        Args:
            shape: Numbers of environments and of axes.
            period: Control period, s.
            generator: Random numbers.

        Returns:
            Forces along the axes, N, or torques about rotary ones, Nm, shape (environments, axes).
        """

    def follow(self, forces: Array, period: float, generator: np.random.Generator) -> Array:
        """Return the `forces` of the next control period of `period`, s, N, shape (environments, axes).

        The argument `forces` are those of the present period.
        """


DISTURBANCES: Registry[type[Disturbance]] = Registry("disturbance")


def _not_negative(**values: float) -> None:
    """Raise InputError for a negative or infinite value."""
    for name, value in values.items():
        if not 0.0 <= value < np.inf:
            raise InputError(f"disturbance: {name} is {value:g}, it must not be negative or infinite")


@DISTURBANCES.register("white")
class WhiteNoise(Disturbance):
    """Independent normal forces of the standard deviation `std`, N, in every control period."""

    def __init__(self, std: float = 2.0) -> None:
        _not_negative(std=std)
        self.std = std

    @override
    def begin(self, shape: tuple[int, int], period: float, generator: np.random.Generator) -> Array:
        """Return independent normal forces of the standard deviation `std`, N, of this shape."""
        return generator.normal(0.0, self.std, shape)

    @override
    def follow(self, forces: Array, period: float, generator: np.random.Generator) -> Array:
        """Return new normal forces, N, that do not depend on the present ones."""
        return generator.normal(0.0, self.std, forces.shape)


@DISTURBANCES.register("ornstein_uhlenbeck")
class OrnsteinUhlenbeck(Disturbance):
    """Normal forces whose correlation decays exponentially with time, from the stationary distribution.

    Args:
        std: Standard deviation, N.
        time_s: Time after which the correlation is 1/e, s.

    References:
        Uhlenbeck and Ornstein (1930), On the theory of the Brownian motion.
    """

    def __init__(self, std: float = 2.0, time_s: float = 0.1) -> None:
        _not_negative(std=std, time_s=time_s)
        self.std, self.time_s = std, time_s

    @override
    def begin(self, shape: tuple[int, int], period: float, generator: np.random.Generator) -> Array:
        """Return independent normal forces of the standard deviation `std`, N, of this shape."""
        return generator.normal(0.0, self.std, shape)

    @override
    def follow(self, forces: Array, period: float, generator: np.random.Generator) -> Array:
        """Return exp(-period / time_s) times the forces, N, plus noise that keeps their deviation `std`."""
        kept = np.exp(-period / self.time_s) if self.time_s else 0.0
        noise: Array = generator.normal(0.0, self.std * np.sqrt(1.0 - kept * kept), forces.shape)
        return kept * forces + noise


@DISTURBANCES.register("pulses")
class Pulses(Disturbance):
    """Forces of one size and random sign that begin at random times and last a random time.

    Args:
        size: Force, N.
        rate: Pulses per second while there is none, 1/s.
        length_s: Mean length of a pulse, s.
    """

    def __init__(self, size: float = 10.0, rate: float = 2.0, length_s: float = 0.03) -> None:
        _not_negative(size=size, rate=rate, length_s=length_s)
        self.size, self.rate, self.length_s = size, rate, length_s

    @override
    def begin(self, shape: tuple[int, int], period: float, generator: np.random.Generator) -> Array:
        """Return the first forces, N: none."""
        return np.zeros(shape)

    @override
    def follow(self, forces: Array, period: float, generator: np.random.Generator) -> Array:
        """Begin and end pulses at random; a force of 0 N means that there is none.

        A pulse of +-`size` N begins with the probability 1 - exp(-period rate) and ends with 1 - exp(-period
        / length_s).
        """
        chances = generator.random(forces.shape)
        ends = chances < (1.0 - np.exp(-period / self.length_s) if self.length_s else 1.0)
        begins = chances < 1.0 - np.exp(-period * self.rate)
        signs = generator.choice((-1.0, 1.0), forces.shape)
        return np.where(forces == 0.0, np.where(begins, signs * self.size, 0.0), np.where(ends, 0.0, forces))
