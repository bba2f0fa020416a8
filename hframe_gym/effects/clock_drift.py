"""Clock of a log whose rate changes within a run: actual steps are longer by a fraction a t than the log's.

t is the time since the first row. A rate that is wrong all the time looks like other masses and frictions: in
a time that runs c times as fast, a mass is c^2 times as large.
"""

from ..machine import Effect, EffectParameter


def next_state(z, dt):  # type: ignore[no-untyped-def]
    """Return the time since the first row after a step, s; dt: s."""
    return z + dt


def clock(z, a):  # type: ignore[no-untyped-def]
    """Return the fraction a t by which a step lasts longer than the log's clock says; z: t, s, a: 1/s."""
    return a * z


EFFECT = Effect(
    name="clock_drift",
    site="machine",
    formula="dt = (1 + a t) dt of the log",
    source="oscillator whose frequency drifts linearly, Allan 1987, IEEE Trans. UFFC 34(6)",
    clock=clock,
    next_state=next_state,
    parameters=(EffectParameter("a", "1/s", -0.1, 0.1, scale=5e-3, grid=(-5e-3, 5e-3), role="amplitude"),),
)
