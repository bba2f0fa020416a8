"""The machine model: components, parameters, rest states, rigid motions, presets, plan views and drawings.

This package holds no integrator and reads no files.
"""

from .axis_unit import ARM, AXIS_UNITS, METERS, RADIANS, AxisUnit
from .components import Belt, Coordinate, Drive, Row, Sensor
from .declaration import (
    UNITS,
    Attribute,
    Component,
    CoordinateKind,
    Number,
    Plain,
    Variant,
    descriptions,
    summary,
    written_unit,
)
from .diagram import draw_machine
from .drive_kinds import DRIVE_KINDS, DriveKind, DriveLaw
from .effect import HOOKS, AppliedEffect, Effect, EffectParameter, Hook, argument_names
from .error_propagation import standard_deviations
from .machine import Contact, Machine, require_machine
from .motion import (
    MotionLimits,
    carried_through_contacts,
    commanded_state,
    effects_left_out,
    motion_limits,
    observed_coordinates,
    pulley_names,
    rest_positions_per_axis,
    rest_state,
    rigid_basis,
    rigid_counterpart,
    rigid_motions,
    slow_loads,
)
from .presets import BUILTIN_MACHINES, with_constant_stiffness
from .sensed_quantities import SENSED_QUANTITIES, SensedQuantity, SensorQuantity
from .sensor_kinds import SENSOR_KINDS, SensorKind
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
from .uncertainty import Uncertainty

__all__ = [
    "ARM",
    "AXIS_UNITS",
    "BUILTIN_MACHINES",
    "DRIVE_KINDS",
    "HOOKS",
    "METERS",
    "RADIANS",
    "SENSED_QUANTITIES",
    "SENSOR_KINDS",
    "SIMULATORS",
    "UNITS",
    "AppliedEffect",
    "Attribute",
    "AxisUnit",
    "Belt",
    "BeltGeometry",
    "Box",
    "Component",
    "Contact",
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
    "Number",
    "Plain",
    "Point",
    "Row",
    "SensedQuantity",
    "Sensor",
    "SensorKind",
    "SensorQuantity",
    "Simulator",
    "StageGeometry",
    "Trajectory",
    "Uncertainty",
    "Variant",
    "argument_names",
    "carried_through_contacts",
    "commanded_state",
    "descriptions",
    "draw_machine",
    "drawn_point",
    "effects_left_out",
    "motion_limits",
    "observed_coordinates",
    "position_of_point",
    "pulley_names",
    "require_machine",
    "rest_positions_per_axis",
    "rest_state",
    "rigid_basis",
    "rigid_counterpart",
    "rigid_motions",
    "slow_loads",
    "stage_geometry",
    "standard_deviations",
    "summary",
    "with_constant_stiffness",
    "written_unit",
]
