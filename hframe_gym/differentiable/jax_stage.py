"""Motions of a machine as differentiable functions of JAX.

The compiled functions are the same as for torch; JAX calls them outside its compiled program
(`pure_callback`). They are therefore no faster under `jax.jit`, and `vmap` calls them once for each element:
use the batch axis instead.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from typing_extensions import override

from ..arrays import Array
from ..dynamics import Motions
from ..errors import InputError, naming_extra
from .stage import Stage

with naming_extra("jax", "differentiable stages for JAX need jax"):
    import jax
    import jax.numpy as jnp


class JaxStage(Stage[Any]):
    """Stage whose motions JAX differentiates in reverse mode (`jax.grad`, `jax.vjp`), also inside `jax.jit`.

    JAX must compute in float64: set `jax.config.update("jax_enable_x64", True)` first. Forward mode, second
    derivatives and drives with a delay before the first period are not available. The arguments are those of
    `Stage`.

    Raises:
        InputError: If JAX computes in float32.
    """

    @override
    def check_library(self) -> None:
        """Raise an InputError unless JAX computes in float64 (`jax_enable_x64`)."""
        if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
            raise InputError('JAX computes in float32; call jax.config.update("jax_enable_x64", True) before')

    @staticmethod
    @override
    def from_numpy(values: Array) -> Any:
        """Convert `values`, of any shape, to an array of JAX."""
        return jnp.asarray(values)

    @override
    def rollout(self, start: Any, voltages: Any, parameters: Any = None) -> Any:
        """Simulate as `Stage.rollout` does; JAX wraps the `NotFiniteError` in a `JaxRuntimeError`."""
        values = jnp.asarray(self.nominal if parameters is None else parameters)
        if values.ndim == 1:
            values = jnp.broadcast_to(values, (len(start), len(values)))
        self.checked(start.shape, voltages.shape, values.shape, None)
        return self._rollout(start, voltages, values)

    @cached_property
    def _rollout(self) -> Any:
        """The simulation as a function of JAX with a rule for its derivatives."""
        return _rollout_function(self)


def _rollout_function(stage: Stage[Any]) -> Any:
    """Return the simulation as a function of JAX with a rule for its derivatives."""

    def motions_of(*arguments: Array) -> Motions:
        start, voltages, parameters = (np.asarray(values, dtype=np.float64) for values in arguments)
        return stage.simulate(start, voltages, parameters)

    def states_of(start: Array, voltages: Array, parameters: Array) -> Array:
        return motions_of(start, voltages, parameters).states

    def gradients_of(
        start: Array, voltages: Array, parameters: Array, change: Array
    ) -> tuple[Array, Array, Array]:
        motions = motions_of(start, voltages, parameters)
        found = stage.motion.gradients(motions, np.asarray(change), parallel=stage.parallel)
        return found.start, found.inputs, np.ascontiguousarray(found.parameters[:, : parameters.shape[1]])

    def shape(*sizes: int) -> Any:
        struct: Any = jax.ShapeDtypeStruct
        return struct(sizes, jnp.float64)

    @jax.custom_vjp
    def rollout(start: Any, voltages: Any, parameters: Any) -> Any:
        result = shape(len(start), voltages.shape[1] + 1, start.shape[1])
        return jax.pure_callback(states_of, result, start, voltages, parameters, vmap_method="sequential")

    def forward(start: Any, voltages: Any, parameters: Any) -> Any:
        return rollout(start, voltages, parameters), (start, voltages, parameters)

    def backward(arguments: Any, change: Any) -> Any:
        results = tuple(shape(*values.shape) for values in arguments)
        return jax.pure_callback(gradients_of, results, *arguments, change, vmap_method="sequential")

    rollout.defvjp(forward, backward)
    return rollout
