"""Equations of motion, their linearization, and simulation: the integrator and its compiled kernel."""

from .codegen.blocks import in_blocks
from .codegen.kernel import Kernel, kernel_for, kernel_source_text
from .codegen.machine_code import LANES
from .derivatives import DifferentiableMotion, Friction, Gradients, Motions
from .motion_forces import (
    belt_forces,
    belt_states,
    effect_forces,
    effect_states,
    net_forces,
    sensor_readings,
)
from .physics.belts import BeltState
from .physics.effect_instances import instances_with_state
from .physics.equations import Equations, ForceBalance
from .physics.linearization import (
    StateSpace,
    belt_modes,
    linearize,
    matrix_exponential,
    mode_frequencies,
    resolved_step,
    stiffness_matrix,
)
from .physics.parameterized_machine import MotionPoint
from .simulation import NotFiniteError, in_parallel, rollout, simulate, simulate_batch

__all__ = [
    "LANES",
    "BeltState",
    "DifferentiableMotion",
    "Equations",
    "ForceBalance",
    "Friction",
    "Gradients",
    "Kernel",
    "MotionPoint",
    "Motions",
    "NotFiniteError",
    "StateSpace",
    "belt_forces",
    "belt_modes",
    "belt_states",
    "effect_forces",
    "effect_states",
    "in_blocks",
    "in_parallel",
    "instances_with_state",
    "kernel_for",
    "kernel_source_text",
    "linearize",
    "matrix_exponential",
    "mode_frequencies",
    "net_forces",
    "resolved_step",
    "rollout",
    "sensor_readings",
    "simulate",
    "simulate_batch",
    "stiffness_matrix",
]
