"""Equations of motion, the integrator, its generated kernel and simulation."""

from .kernel import Kernel, in_blocks, kernel_for
from .simd import LANES
from .simulation import NotFiniteError, Trajectory, in_parallel, rollout, simulate, simulate_batch

__all__ = [
    "LANES",
    "Kernel",
    "NotFiniteError",
    "Trajectory",
    "in_blocks",
    "in_parallel",
    "kernel_for",
    "rollout",
    "simulate",
    "simulate_batch",
]
