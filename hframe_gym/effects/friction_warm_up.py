"""Dry friction of all coordinates that changes as the machine warms up: Fc times 1 + a exp(-t/tau).

It falls where the lubricant becomes thinner (a > 0), and rises where expanding parts press on bearings (a <
0). The factor applies to the dry friction force with all other effects on it. The time t counts from when the
machine was switched on, so the recordings must share one clock.
"""

from ..dynamics.elementwise import exp
from ..machine import Effect, EffectParameter


def coulomb(level, t, a, tau):  # type: ignore[no-untyped-def]
    """Return the change a exp(-t/tau) level of the dry friction, N or Nm; level: when warm, t, tau: s."""
    return level * (a * exp(-t / tau))


EFFECT = Effect(
    name="friction_warm_up",
    site="machine",
    formula="F(t) = Fc (1 + a exp(-t/tau))",
    source="Bittencourt, Wernholt, Sander-Tavallaey and Brogardh 2010, "
    "friction of robot joints against temperature",
    coulomb=coulomb,
    parameters=(
        EffectParameter("a", "1", -0.99, 100.0, scale=0.3, role="amplitude"),
        EffectParameter("tau", "s", 0.01, 1e6, scale=1.0, grid=(3.0, 10.0, 30.0, 100.0, 300.0), slope_of="a"),
    ),
)
