"""What the stage is: tables, kernels made from them, simulation.  No files, no gymnasium."""

from .builtin import BUILTIN, with_constant_stiffness
from .effect import AppliedEffect, Effect, EffectParameter
from .linear import linearise, mode_frequencies
from .simulate import NotFiniteError, Trajectory, rest_state, rollout, simulate
from .tables import Belt, Coordinate, Drive, Machine, Sensor, Uncertainty

__all__ = [
    "BUILTIN",
    "AppliedEffect",
    "Belt",
    "Coordinate",
    "Drive",
    "Effect",
    "EffectParameter",
    "Machine",
    "NotFiniteError",
    "Sensor",
    "Trajectory",
    "Uncertainty",
    "linearise",
    "mode_frequencies",
    "rest_state",
    "rollout",
    "simulate",
    "with_constant_stiffness",
]
