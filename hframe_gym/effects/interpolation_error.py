"""Interpolation error of an encoder or scale: it measures r + A sin(n r + p), n / (2 pi) periods per unit.

The error repeats with each line of a scale or disk, each pole of a magnet or each turn of the motor behind a
gear. One period per turn of the measured coordinate is `eccentric_encoder`.
"""

from ..dynamics.elementwise import sin
from ..machine import Effect, EffectParameter, Machine


def measurement(r, A, n, p):  # type: ignore[no-untyped-def]
    """Return the measurement r + A sin(n r + p), m or rad.

    r: true value, m or rad, A: largest error, same unit, n: rad per unit of r, p: phase, rad.
    """
    return r + A * sin(n * r + p)


EFFECT = Effect(
    name="interpolation_error",
    site="sensor",
    formula="measurement = r + A sin(n r + p)",
    source="Heydemann 1981, Applied Optics 20(19), subdivision error of interferometers; its first harmonic",
    measurement=measurement,
    fits_site=Machine.measures_position,
    parameters=(
        EffectParameter("A", "position", -1.0, 1.0, scale=1e-4, role="amplitude"),
        EffectParameter(
            "n", "rad/position", 1e-3, 1e6, scale=0.1, role="rate", simpler={1.0: "eccentric_encoder"}
        ),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
