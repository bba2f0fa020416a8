"""A sensor with another gain than declared: it shows (1 + g) r.

Of an encoder it is the same as a pulley of another radius.
"""

from ..machine.effect import Effect, EffectParameter


def measurement(r, g):  # type: ignore[no-untyped-def]
    return r + g * r


EFFECT = Effect(
    name="sensor_scale",
    family="sensor_scale",
    site="sensor",
    formula="shown = (1 + g) r",
    source="calibration",
    measurement=measurement,
    equivalent=("a pulley's radius",),
    # A rig whose only sensor has another gain is a rig of other masses and forces.
    fits=lambda machine: len(machine.sensors) > sum(c.kind == "linear" for c in machine.coordinates),
    parameters=(EffectParameter("g", "1", -0.9, 9.0, scale=0.01, role="amplitude"),),
)
