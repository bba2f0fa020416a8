"""What a rig's sensors read of a run, and what they lose. Channels, in this order: phi1, phi2 [rad], x, y [m]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tests.reference_simulator.rig import INF, NONE, Array, Four, Two

ENCODER_STEP_RAD = 2.0 * np.pi / (512 * 4 * 5.9)  # at the belt pulley
LASER_NOISE_M, LASER_STEP_M = 20e-6, 1e-6


@dataclass(frozen=True)
class Sensors:
    """Undeclared effects of the sensors, all off."""

    skew: Two = (0.0, 0.0)  # the lasers are not square: x + a y, y + b x
    scale: Four = (1.0, 1.0, 1.0, 1.0)
    range_x_m: Two = (-INF, INF)  # the bridge's laser sticks at the ends of its range
    delay_s: Four = NONE

    def ideal(self, time_s: Array, positions: Array, velocities: Array) -> Array:
        """Readings without noise and quantisation, (n, 4), from positions and velocities (n, 4) of x, y, phi1, phi2.

        A late reading interpolates by cubics through the rows (which a jump in acceleration leaves exact to 1 um).
        """
        reading = np.empty_like(positions)
        for channel, coordinate in enumerate((2, 3, 0, 1)):
            path = CubicHermiteSpline(time_s, positions[:, coordinate], velocities[:, coordinate])
            reading[:, channel] = path(np.maximum(time_s - self.delay_s[channel], time_s[0]))
        x, y = reading[:, 2].copy(), reading[:, 3].copy()
        reading[:, 2] += self.skew[0] * y
        reading[:, 3] += self.skew[1] * x
        reading *= np.array(self.scale)
        reading[:, 2] = np.clip(reading[:, 2], *self.range_x_m)
        return reading


def noisy(ideal: Array, rng: np.random.Generator) -> Array:
    """Encoders by whole steps, lasers with white noise and a fine step, (n, 4)."""
    encoders = np.round(ideal[:, :2] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
    lasers = ideal[:, 2:] + rng.normal(0.0, LASER_NOISE_M, (len(ideal), 2))
    return np.hstack([encoders, np.round(lasers / LASER_STEP_M) * LASER_STEP_M])
