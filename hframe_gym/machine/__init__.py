"""The machine model: components, parameters, rest states, rigid motions and presets.

This package holds no integrator and reads no files.
"""

from .components import (
    FIXED_UNITS,
    SENSOR_KINDS,
    UNITS,
    Belt,
    Coordinate,
    CoordinateKind,
    Drive,
    Row,
    Sensor,
    SensorKind,
    Uncertainty,
)
from .effect import HOOKS, AppliedEffect, Effect, EffectParameter, Hook, argument_names
from .machine import Machine
from .motion import SIMULATORS, Simulator, Trajectory, rest_state, rigid_motions
from .presets import BUILTIN_MACHINES, with_constant_stiffness

__all__ = [
    "BUILTIN_MACHINES",
    "FIXED_UNITS",
    "HOOKS",
    "SENSOR_KINDS",
    "SIMULATORS",
    "UNITS",
    "AppliedEffect",
    "Belt",
    "Coordinate",
    "CoordinateKind",
    "Drive",
    "Effect",
    "EffectParameter",
    "Hook",
    "Machine",
    "Row",
    "Sensor",
    "SensorKind",
    "Simulator",
    "Trajectory",
    "Uncertainty",
    "argument_names",
    "rest_state",
    "rigid_motions",
    "with_constant_stiffness",
]
