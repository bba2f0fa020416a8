"""A constant force or torque on a coordinate: a tilted bed, a cable's pull, an amplifier's offset behind the gear.

A Coulomb level that differs by direction, F+ and F-, is the same thing: (F+ - F-)/2 is a constant force and
(F+ + F-)/2 the level.  The two cannot be told apart by any motion and are one class.
"""

from ..machine.effect import Effect, EffectParameter


def force(size):  # type: ignore[no-untyped-def]
    return size


EFFECT = Effect(
    name="constant_force",
    family="constant_force",
    site="coordinate",
    formula="f = size",
    source="weight on a slope; Coulomb friction that differs by direction",
    force=force,
    equivalent=("direction-dependent Coulomb friction",),
    parameters=(EffectParameter("size", "force", -1e4, 1e4, scale=0.3, role="amplitude"),),
)
