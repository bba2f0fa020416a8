"""Equations of motion, the integrator, its generated kernel and simulation."""

from .equations import BeltState, Equations, ForceBalance, MotionPoint
from .kernel import Kernel, in_blocks, kernel_for
from .motion_forces import (
    belt_forces,
    belt_states,
    delayed_voltages,
    effect_forces,
    effect_states,
    net_forces,
    sensor_readings,
)
from .simd import LANES
from .simulation import NotFiniteError, Trajectory, in_parallel, rollout, simulate, simulate_batch

__all__ = [
    "LANES",
    "BeltState",
    "Equations",
    "ForceBalance",
    "Kernel",
    "MotionPoint",
    "NotFiniteError",
    "Trajectory",
    "belt_forces",
    "belt_states",
    "delayed_voltages",
    "effect_forces",
    "effect_states",
    "in_blocks",
    "in_parallel",
    "kernel_for",
    "net_forces",
    "rollout",
    "sensor_readings",
    "simulate",
    "simulate_batch",
]
