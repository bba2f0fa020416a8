"""Simulate the H-frame stage independently of the package: oracle of the tests and plant of the benchmarks.

The simulator shares neither code nor method with `hframe_gym`. Its equations follow directly from the
Lagrangian (`equations`). Dry friction is event-driven (each coordinate sticks or slides in a known direction,
without regularization), and an adaptive Runge-Kutta pair integrates between the events to tight tolerances
(`integrator`). `rig` lists the parameters of a stage, including every effect that a machine file does not
declare; `sensors` models the measurements.

Conventions, everywhere in this package:
    Coordinates: x (bridge), y (cart), m; phi1, phi2 (belt pulleys), rad; in this order.
    Belts: left, right, bottom. Drives: motor 1 acts on phi1, motor 2 on phi2.
"""

from tests.reference_simulator.rig import COORDINATES, Array, Frame, Payload, Rig, Yaw
from tests.reference_simulator.stage import Stage, energy, simulate

__all__ = ["COORDINATES", "Array", "Frame", "Payload", "Rig", "Stage", "Yaw", "energy", "simulate"]
