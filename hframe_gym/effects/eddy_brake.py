"""Eddy-current brake, -c v / (1 + (v/v0)^2): a drag that rises with the speed up to v0 and falls beyond.

Magnets near a moving conductor, or a conductor near fixed magnets, brake in this way. So does the iron of a
motor.
"""

from ..machine import Effect, EffectParameter


def force(v, c, v0):  # type: ignore[no-untyped-def]
    """Return the drag, N or Nm; v: speed, v0: speed of the largest drag, m/s or rad/s, c: Ns/m or Nms."""
    ratio = v / v0
    return -c * v / (1.0 + ratio * ratio)


EFFECT = Effect(
    name="eddy_brake",
    site="coordinate",
    formula="f = -c v / (1 + (v/v0)^2)",
    source="Wouterse 1991, IEE Proceedings B 138(4): torque 2 T / (v/v0 + v0/v) of eddy-current brakes",
    force=force,
    needs_part="magnets",
    parameters=(
        EffectParameter("c", "viscous", 0.0, 1e6, scale=0.3, role="amplitude"),
        EffectParameter("v0", "speed", 1e-4, 1e3, scale=0.3, grid=(0.03, 0.1, 0.3)),
    ),
)
