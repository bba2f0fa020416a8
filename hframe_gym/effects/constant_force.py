"""A constant force or torque on a coordinate: a tilted bed, a cable's pull, an offset behind the gear.

Coulomb friction forces F+ and F- that differ by direction are equivalent: (F+ - F-)/2 is a constant force,
(F+ + F-)/2 the Coulomb friction force. No motion can distinguish the two.
"""

from ..machine import Effect, EffectParameter


def force(size):  # type: ignore[no-untyped-def]
    """Return the constant force `size` on the coordinate, N or Nm."""
    return size


EFFECT = Effect(
    name="constant_force",
    site="coordinate",
    formula="f = size",
    source="weight on a slope; Coulomb friction that differs by direction",
    force=force,
    equivalent=("direction-dependent Coulomb friction",),
    parameters=(EffectParameter("size", "force", -1e4, 1e4, scale=0.3, role="amplitude"),),
)
