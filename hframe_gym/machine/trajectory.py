"""The simulated motion of a machine, and the registry of simulators."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..arrays import Array
from ..registry import Registry


@dataclass(frozen=True)
class Trajectory:
    """The simulated motion of a machine at n samples.

    Attributes:
        time_s: Sample times, s, shape (n,).
        positions: Positions of the coordinates, m or rad, shape (n, coordinates).
        velocities: Velocities of the coordinates, m/s or rad/s, shape (n, coordinates).
        outputs: Noise-free sensor readings, in the channels' units, shape (n, sensors).
        channels: Names of the output channels.
    """

    time_s: Array
    positions: Array
    velocities: Array
    outputs: Array
    channels: tuple[str, ...]


# A function that simulates a machine, with the arguments of `Machine.simulate` after the machine itself.
Simulator = Callable[..., Trajectory]
# This package does not depend on the integrator. Whoever provides one registers it under the name "default".
SIMULATORS: Registry[Simulator] = Registry("simulator")
