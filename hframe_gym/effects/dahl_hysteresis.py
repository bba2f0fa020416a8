"""A force with memory beside Coulomb friction, as of a cable or an energy chain that bends (Dahl 1968).

The force -F z of the state z (from -1 to 1, zero when the simulation starts) builds up over a distance of
about L after each reversal: dz/dt = (v - |v| z) / L. At constant direction z approaches the direction
exponentially with the distance.
"""

from ..dynamics.elementwise import absolute, copysign, exp
from ..machine import Effect, EffectParameter


def next_state(z, dq, L):  # type: ignore[no-untyped-def]
    """Return the state, in [-1, 1], after a motion dq in one direction: s + (z - s) exp(-|dq|/L).

    s is the sign of dq, and L the characteristic distance, m or rad, as dq.
    """
    final = copysign(1.0, dq)
    return final + (z - final) * exp(-absolute(dq) / L)


def force(z, F):  # type: ignore[no-untyped-def]
    """Return the force -F z, N or Nm; z: state from -1 to 1, F: largest force, N or Nm."""
    return -F * z


def initial_spread():  # type: ignore[no-untyped-def]
    """Return the standard deviation of the state z after unrecorded motion, 0.58: z is uniform in [-1, 1]."""
    return 0.58


PARAMETERS = (
    EffectParameter("F", "force", 0.0, 1e3, scale=0.3, role="amplitude"),
    # A force that builds up within less than a millimeter is presliding of the dry friction itself.
    # The loop closes over about three times L, which has to fit into the motion; otherwise the force is a
    # spring's.
    EffectParameter("L", "position", 1e-3, 1e3, scale=0.02, grid=(0.01, 0.03, 0.08), largest=0.25),
)

EFFECT = Effect(
    name="dahl_hysteresis",
    family="hysteresis",
    site="coordinate",
    formula="f = -F z, dz/dt = (v - |v| z)/L",
    source="Dahl 1968, A solid friction model; Dahl 1976, AIAA Journal 14(12)",
    force=force,
    next_state=next_state,
    initial_spread=initial_spread,
    parameters=PARAMETERS,
)
