"""Model the sensors of a rig. Channels, in this order: phi1, phi2, rad; x, y, m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tests.reference_simulator.rig import INF, OFF, Array, PerCoordinate

ENCODER_STEP_RAD = 2.0 * np.pi / (512 * 4 * 5.9)  # at the belt pulley
LASER_NOISE_M, LASER_STEP_M = 20e-6, 1e-6


@dataclass(frozen=True)
class Sensors:
    """Undeclared effects of the sensors. The defaults switch all of them off."""

    skew: tuple[float, float] = (0.0, 0.0)  # a, b: the lasers are not orthogonal and measure x + a y, y + b x
    scale: PerCoordinate = (1.0, 1.0, 1.0, 1.0)
    range_x_m: tuple[float, float] = (-INF, INF)  # the laser of the bridge saturates at these positions
    range_y_m: tuple[float, float] = (-INF, INF)  # and that of the cart
    delay_s: PerCoordinate = OFF
    bend: PerCoordinate = OFF  # c in r + c r^2, a scale that is not linear; 1/rad and 1/m
    # A in r + A sin(2 pi r / L + p): interpolation of a grating, eccentric encoder; rad, m.
    wave: PerCoordinate = OFF
    wave_period: PerCoordinate = (2.0 * np.pi, 2.0 * np.pi, 0.004, 0.004)  # L
    wave_phase: PerCoordinate = OFF  # p, rad

    def graduated(self, measurement: Array) -> Array:
        """Return measurements with the errors of the scales' graduations.

        Args:
            measurement: Exact measurements phi1, phi2, x, y, rad and m, shape (..., 4).
        """
        angle = 2.0 * np.pi * measurement / np.array(self.wave_period) + np.array(self.wave_phase)
        return measurement + np.array(self.bend) * measurement**2 + np.array(self.wave) * np.sin(angle)

    def ideal(self, time_s: Array, positions: Array, velocities: Array) -> Array:
        """Return the measurements without noise and quantization.

        A delayed measurement is interpolated by cubic Hermite splines through the rows; where the
        acceleration jumps the interpolation is exact to 1 um.

        Args:
            time_s: Sample times, s, shape (n,).
            positions: Coordinates x, y, phi1, phi2, m and rad, shape (n, 4).
            velocities: Rates of the coordinates, shape (n, 4).

        Returns:
            Measurements phi1, phi2, x, y, rad and m, shape (n, 4).
        """
        measurement = np.empty_like(positions)
        for channel, coordinate in enumerate((2, 3, 0, 1)):
            path = CubicHermiteSpline(time_s, positions[:, coordinate], velocities[:, coordinate])
            measurement[:, channel] = path(np.maximum(time_s - self.delay_s[channel], time_s[0]))
        measurement = self.graduated(measurement)
        x, y = measurement[:, 2].copy(), measurement[:, 3].copy()
        measurement[:, 2] += self.skew[0] * y
        measurement[:, 3] += self.skew[1] * x
        measurement *= np.array(self.scale)
        measurement[:, 2] = np.clip(measurement[:, 2], *self.range_x_m)
        measurement[:, 3] = np.clip(measurement[:, 3], *self.range_y_m)
        return measurement


def noisy(ideal: Array, rng: np.random.Generator) -> Array:
    """Add noise and quantization: encoder steps, and white noise and a fine step for the lasers.

    Args:
        ideal: Measurements phi1, phi2, x, y, rad and m, shape (n, 4).
        rng: Source of the noise.

    Returns:
        Noisy measurements, shape (n, 4).
    """
    encoders = np.round(ideal[:, :2] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
    lasers = ideal[:, 2:] + rng.normal(0.0, LASER_NOISE_M, (len(ideal), 2))
    return np.hstack([encoders, np.round(lasers / LASER_STEP_M) * LASER_STEP_M])
