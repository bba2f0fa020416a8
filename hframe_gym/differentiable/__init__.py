"""Differentiable stages: derivatives of simulated motions as functions of torch or JAX.

    DifferentiableStage    torch: motions as functions of initial state, voltages and machine parameters
    JaxStage               the same functions for JAX

Both compute the derivatives from the compiled equations of the simulator, not from differences;
`DifferentiableMotion` of `hframe_gym.dynamics` is the same without either library. docs/differentiable.md has
examples.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .jax_stage import JaxStage
    from .torch_stage import DifferentiableStage

__all__ = ["DifferentiableStage", "JaxStage"]

_MODULES = {"DifferentiableStage": "torch_stage", "JaxStage": "jax_stage"}


def __getattr__(name: str) -> Any:
    """Load a class when it is first used, because torch or JAX may be missing."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_MODULES[name]}", __name__), name)


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})
