"""An amplifier that limits the current of the motor: |i| <= I, i = (V - Ke N w)/R."""

from ..dynamics.elementwise import maximum, minimum
from ..machine import Effect, EffectParameter


def current(i, I):  # type: ignore[no-untyped-def]  # noqa: E741
    """Return the limited motor current clip(i, -I, I), A; i: current without limit, A, I: limit, A."""
    return minimum(maximum(i, -I), I)


EFFECT = Effect(
    name="current_limit",
    site="drive",
    shared=True,
    formula="|i| <= I",
    source="protection of amplifiers and motors",
    current=current,
    signal_order=1,  # after the lag of the winding
    parameters=(
        EffectParameter("I", "A", 1e-3, 1e4, scale=0.1, grid=(0.3, 0.45, 0.6, 0.7, 0.8, 0.88, 0.95)),
    ),
)
