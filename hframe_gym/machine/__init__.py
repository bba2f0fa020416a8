"""What the stage is: tables, kernels made from them, simulation.  No files, no gymnasium."""

from .effect import AppliedEffect, Effect, EffectParameter
from .kinematics import rest_state
from .linearization import linearize, mode_frequencies
from .machine import SENSOR_KINDS, Belt, Coordinate, Drive, Machine, Sensor, SensorKind, Uncertainty
from .presets import BUILTIN_MACHINES, with_constant_stiffness

__all__ = [
    "BUILTIN_MACHINES",
    "SENSOR_KINDS",
    "AppliedEffect",
    "Belt",
    "Coordinate",
    "Drive",
    "Effect",
    "EffectParameter",
    "Machine",
    "Sensor",
    "SensorKind",
    "Uncertainty",
    "linearize",
    "mode_frequencies",
    "rest_state",
    "with_constant_stiffness",
]
