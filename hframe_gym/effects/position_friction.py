"""Dry friction that varies periodically with position: F(q) = Fc + A sin(2 pi q/L + p).

Causes are the pitch of a leadscrew or rack, the balls of a recirculating carriage, or a bent rail.
"""

import math

from ..dynamics.elementwise import sin
from ..machine import Effect, EffectParameter


def coulomb(q, A, L, p):  # type: ignore[no-untyped-def]
    """Return the change A sin(2 pi q/L + p) of the Coulomb friction, N or Nm; q, L: m or rad, p: rad."""
    return A * sin(2.0 * math.pi * q / L + p)


EFFECT = Effect(
    name="position_friction",
    site="coordinate",
    formula="F(q) = Fc + A sin(2 pi q/L + p)",
    source="Armstrong-Helouvry et al. 1994, section 2.1.4",
    coulomb=coulomb,
    parameters=(
        EffectParameter("A", "force", -1e3, 1e3, scale=0.3, role="amplitude"),
        EffectParameter("L", "position", 1e-4, 1e3, scale=0.1, role="period"),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
