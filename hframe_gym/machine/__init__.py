"""What the stage is: tables, kernels made from them, simulation.  No files, no gymnasium."""

from .effect import AppliedEffect, Effect, EffectParameter
from .kinematics import rest_state
from .linearization import linearize, mode_frequencies
from .machine import Belt, Coordinate, Drive, Machine, Sensor, Uncertainty
from .presets import BUILTIN_MACHINES, with_constant_stiffness

__all__ = [
    "BUILTIN_MACHINES",
    "AppliedEffect",
    "Belt",
    "Coordinate",
    "Drive",
    "Effect",
    "EffectParameter",
    "Machine",
    "Sensor",
    "Uncertainty",
    "linearize",
    "mode_frequencies",
    "rest_state",
    "with_constant_stiffness",
]
