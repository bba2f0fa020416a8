"""A force with memory beside Coulomb friction, elastic after a reversal (Bouc 1967; Wen 1976).

The force -F z of the state z (from -1 to 1, zero when the simulation starts) builds up over a distance of
about L: dz/dt = (v - (|v| |z| z + v z^2) / 2) / L. It differs from `dahl_hysteresis` in the shape of its
loops: after a reversal the force falls along a straight line to zero, then it approaches F as tanh of the
distance.
"""

from ..dynamics.elementwise import absolute, copysign, exp, maximum, minimum, where
from ..machine import Effect
from .dahl_hysteresis import PARAMETERS, force, initial_spread


def next_state(z, dq, L):  # type: ignore[no-untyped-def]
    """Return the state, -1 to 1, after a motion dq without reversal, from the exact solution for dz/dt.

    L is the characteristic distance, m or rad, as dq.
    """
    direction = copysign(1.0, dq)
    against, distance = z * direction, absolute(dq) / L  # `against` is negative after a reversal
    straight = minimum(maximum(-against, 0.0), distance)  # part of the distance on the straight line to zero
    after_straight = against + straight
    rising = maximum(after_straight, 0.0)
    # tanh(artanh(rising) + rest of the distance)
    decay = (1.0 - rising) / (1.0 + rising) * exp(-2.0 * (distance - straight))
    return direction * where(after_straight < 0.0, after_straight, (1.0 - decay) / (1.0 + decay))


EFFECT = Effect(
    name="bouc_wen_hysteresis",
    family="hysteresis",
    site="coordinate",
    formula="f = -F z, dz/dt = (v - (|v| |z| z + v z^2)/2)/L",
    source="Wen 1976, J. Eng. Mech. Div. ASCE 102(2), with n = 2 and equal loop parameters",
    force=force,
    next_state=next_state,
    initial_spread=initial_spread,
    parameters=PARAMETERS,
)
