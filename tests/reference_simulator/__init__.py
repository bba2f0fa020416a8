"""An independent simulator of the H-frame stage: the oracle and the rig of the benchmarks.

It shares neither code nor method with ``hframe_gym``. The equations come straight from the Lagrangian (`equations`),
friction is event-driven (every coordinate sticks or slides in a known direction, and nothing is regularised), and
between events an adaptive Runge-Kutta pair integrates to tight tolerances (`integrate`). `rig` lists what a stage can
be made of, declared or not; `sensors` what its readings lose.

Coordinates, always in this order: x (bridge) [m], y (cart) [m], phi1, phi2 (belt pulleys) [rad].
Belts, in this order: left, right, bottom. Drives: motor 1 on phi1, motor 2 on phi2.
"""

from tests.reference_simulator.rig import COORDINATES, Array, Frame, Payload, Rig, Yaw
from tests.reference_simulator.stage import Stage, energy, simulate

__all__ = [
    "COORDINATES",
    "Array",
    "Frame",
    "Payload",
    "Rig",
    "Stage",
    "Yaw",
    "energy",
    "simulate",
]
