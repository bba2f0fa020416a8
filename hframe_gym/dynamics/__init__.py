"""Equations of motion, their linearization, and simulation: the integrator and its compiled kernel (generated code)."""

from ..cache_folder import cache_folder
from .belts import BeltState
from .equations import Equations, ForceBalance
from .kernel import Kernel, in_blocks, kernel_for, kernel_source_text
from .linearization import StateSpace, linearize, matrix_exponential, mode_frequencies, resolved_step, stiffness_matrix
from .motion_forces import (
    belt_forces,
    belt_states,
    delayed_voltages,
    effect_forces,
    effect_states,
    net_forces,
    sensor_readings,
)
from .parameterized_machine import MotionPoint
from .shared_kernels import share_kernel
from .simd import LANES
from .simulation import NotFiniteError, in_parallel, rollout, simulate, simulate_batch

__all__ = [
    "LANES",
    "BeltState",
    "Equations",
    "ForceBalance",
    "Kernel",
    "MotionPoint",
    "NotFiniteError",
    "StateSpace",
    "belt_forces",
    "belt_states",
    "cache_folder",
    "delayed_voltages",
    "effect_forces",
    "effect_states",
    "in_blocks",
    "in_parallel",
    "kernel_for",
    "kernel_source_text",
    "linearize",
    "matrix_exponential",
    "mode_frequencies",
    "net_forces",
    "resolved_step",
    "rollout",
    "sensor_readings",
    "share_kernel",
    "simulate",
    "simulate_batch",
    "stiffness_matrix",
]
