"""A second periodic torque of a cogging motor: an overtone of the detent torque, or commutation ripple."""

from ..machine import Effect
from .cogging import EFFECT as COGGING
from .cogging import force

EFFECT = Effect(
    name="second_cogging",
    family="cogging",
    site="motor",
    formula="f = A sin(n q + p), in addition to cogging",
    source="Hanselman, Brushless Permanent Magnet Motor Design, "
    "chapter 7: the detent torque is a Fourier series",
    force=force,
    parameters=COGGING.parameters,
    requires=COGGING.name,
)
