"""Simulate the H-frame stage by semi-implicit Euler steps of 4 us: a second, independent simulator.

It shares neither code nor method with `hframe_gym` or with `tests.reference_simulator`; its equations are
those of docs/errata.md and of the library's table of effects. Dry friction is a set: in every step each
coordinate receives the impulse, at most h F, that brings its velocity closest to zero. That impulse is the
implicit solution of the inclusion m dv/dt in f - F Sign(v), so a coordinate sticks and slides without events
and without regularization.

The error is of first order: about v h / 2, a micrometer at 0.5 m/s. A longer step gives the data of an
inaccurate simulator, which no effect of the library explains.
"""

from tests.euler_simulator.stage import DEFAULT_STEP_S, EulerStage, parameter_table

__all__ = ["DEFAULT_STEP_S", "EulerStage", "parameter_table"]
