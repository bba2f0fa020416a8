"""A spring between a coordinate and the frame, -k (q - q0): an energy chain, a hose or a cable loop."""

from ..machine import Effect, EffectParameter


def force(q, k, q0):  # type: ignore[no-untyped-def]
    """Return the force -k (q - q0), N or Nm; q: position, q0: free position, m or rad, k: N/m or Nm/rad."""
    return -k * (q - q0)


EFFECT = Effect(
    name="cable_spring",
    site="coordinate",
    formula="f = -k (q - q0)",
    source="Hooke",
    force=force,
    parameters=(
        EffectParameter("k", "stiffness", -1e6, 1e6, scale=0.3, role="amplitude", named_from=0.0),
        EffectParameter("q0", "position", -1e3, 1e3, scale=0.5, grid=(-0.5, 0.0, 0.5)),
    ),
)
