"""A position loop with a dead band: errors of the position within about +-d command less motion, or none.

Hobby servos have one, of 1 to 10 us of the pulse width, so that they do not tremble at rest. In the middle of
the band the loop is weaker by the fraction s: slack with s = 1, compliant with less. Beyond it, the loop sees
the error reduced by s d. The transition is smooth, as noise and the resolution of the servo's own measurement
make it.
"""

from ..dynamics.elementwise import maximum, tanh
from ..machine import Effect, EffectParameter, Machine

_NARROWEST = 1e-9  # m or rad; avoids a division by zero for d = 0


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether a drive controls its position, as a servo does."""
    return machine.drive(site).kind == "position"


def set_point(V, q, s, d):  # type: ignore[no-untyped-def]
    """Return the set point for the loop's error e - s d tanh(e/d), m or rad; e = V - q: actual error.

    V is the commanded position, q the position of the coordinate, d half the width of the dead band, m or rad
    each, and s the fraction by which the loop is weaker in its middle, from 0 to 1.
    """
    return V - s * d * tanh((V - q) / maximum(d, _NARROWEST))


EFFECT = Effect(
    name="servo_dead_band",
    site="drive",
    formula="w = position_gain (e - s d tanh(e/d)), e = r - q",
    source="dead band width in the data sheets of hobby servos, with a smooth transition",
    set_point=set_point,
    fits_site=fits_site,
    parameters=(
        EffectParameter("s", "1", 0.0, 1.0, scale=1.0, role="amplitude", grid=(1.0,)),
        EffectParameter("d", "position", 0.0, 1.0, scale=5e-3, grid=(1e-3, 2e-3, 4e-3, 8e-3, 16e-3)),
    ),
)
