"""The machine model: components, parameters, rest states, rigid motions, presets, plan views and drawings.

This package holds no integrator and reads no files.
"""

from .axis_unit import ARM, AXIS_UNITS, DEFAULT_TURNS, METERS, RADIANS, AxisUnit
from .components import (
    DRIVE_KINDS,
    FIXED_UNITS,
    SENSOR_KINDS,
    UNITS,
    Belt,
    Coordinate,
    CoordinateKind,
    Drive,
    DriveKind,
    DriveLaw,
    Row,
    Sensor,
    SensorKind,
    SensorQuantity,
    Uncertainty,
)
from .diagram import draw_machine
from .effect import HOOKS, AppliedEffect, Effect, EffectParameter, Hook, argument_names
from .machine import Machine
from .motion import (
    MotionLimits,
    motion_limits,
    observed_coordinates,
    pulley_names,
    rest_positions_per_axis,
    rest_state,
    rigid_motions,
)
from .presets import BUILTIN_MACHINES, with_constant_stiffness
from .stage_geometry import (
    BeltGeometry,
    Box,
    CoreXYGeometry,
    DialGeometry,
    Point,
    StageGeometry,
    drawn_point,
    position_of_point,
    stage_geometry,
)
from .trajectory import SIMULATORS, Simulator, Trajectory

__all__ = [
    "ARM",
    "AXIS_UNITS",
    "BUILTIN_MACHINES",
    "DEFAULT_TURNS",
    "DRIVE_KINDS",
    "FIXED_UNITS",
    "HOOKS",
    "METERS",
    "RADIANS",
    "SENSOR_KINDS",
    "SIMULATORS",
    "UNITS",
    "AppliedEffect",
    "AxisUnit",
    "Belt",
    "BeltGeometry",
    "Box",
    "Coordinate",
    "CoordinateKind",
    "CoreXYGeometry",
    "DialGeometry",
    "Drive",
    "DriveKind",
    "DriveLaw",
    "Effect",
    "EffectParameter",
    "Hook",
    "Machine",
    "MotionLimits",
    "Point",
    "Row",
    "Sensor",
    "SensorKind",
    "SensorQuantity",
    "Simulator",
    "StageGeometry",
    "Trajectory",
    "Uncertainty",
    "argument_names",
    "draw_machine",
    "drawn_point",
    "motion_limits",
    "observed_coordinates",
    "position_of_point",
    "pulley_names",
    "rest_positions_per_axis",
    "rest_state",
    "rigid_motions",
    "stage_geometry",
    "with_constant_stiffness",
]
