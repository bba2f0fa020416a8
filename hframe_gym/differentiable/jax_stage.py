"""Motions of a machine as differentiable functions of JAX.

The compiled functions are the same as for torch; JAX calls them outside its compiled program (`pure_callback`). They
are therefore no faster under `jax.jit`, and `vmap` calls them once for each element: use the batch axis instead.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..dynamics import Friction
from ..errors import InputError
from ..machine import Machine
from .stage import Stage

try:
    import jax
    import jax.numpy as jnp
except ImportError as error:
    raise ImportError("differentiable stages for JAX need jax: pip install 'hframe_gym[jax]'") from error


class JaxStage(Stage):
    """Stage whose motions JAX differentiates in reverse mode (`jax.grad`, `jax.vjp`), also inside `jax.jit`.

    JAX must compute in float64: set `jax.config.update("jax_enable_x64", True)` first. Forward mode, second derivatives
    and drives with a delay before the first period are not available. The arguments are those of `Stage`.

    Raises:
        InputError: If JAX computes in float32.
    """

    def __init__(
        self,
        machine: Machine,
        period: float = 0.01,
        *,
        longest_step: float = 0.5e-3,
        end_stops: bool = False,
        friction: Friction = "exact",
        parallel: bool = True,
    ) -> None:
        if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
            raise InputError('JAX computes in float32; call jax.config.update("jax_enable_x64", True) before')
        super().__init__(
            machine,
            period,
            longest_step=longest_step,
            end_stops=end_stops,
            friction=friction,
            parallel=parallel,
        )
        self._rollout = _rollout_function(self)

    def rest(self, tool: ArrayLike | None = None, *, batch: int = 1) -> Any:
        """Return states at rest with unstretched belts.

        Args:
            tool: Positions of the linear coordinates, m, shape (B, linear coordinates); default: all at 0.
            batch: Number B of states if `tool` is not given.

        Returns:
            States, SI, shape (B, S).
        """
        return jnp.asarray(self.rest_states(tool, batch=batch))

    def rollout(self, start: Any, voltages: Any, parameters: Any = None) -> Any:
        """Simulate B machines over T periods; the voltages are held over each period.

        Args:
            start: First states, SI, shape (B, S).
            voltages: Voltages, V, shape (B, T, drives).
            parameters: Parameters in the order of `parameter_names`, SI, shape (P,) or (B, P). Default: those of the
                machine.

        Returns:
            States at the beginning and at the end of every period, SI, shape (B, T + 1, S).

        Raises:
            InputError: If a shape does not fit the machine or the other arguments.
        """
        values = jnp.asarray(self.nominal if parameters is None else parameters)
        if values.ndim == 1:
            values = jnp.broadcast_to(values, (len(start), len(values)))
        self.checked(start.shape, voltages.shape, values.shape, None)
        return self._rollout(start, voltages, values)


def _rollout_function(stage: Stage) -> Any:
    """Return the simulation as a function of JAX with a rule for its derivatives."""

    def states_of(start: Array, voltages: Array, parameters: Array) -> Array:
        arrays = [np.asarray(values, dtype=np.float64) for values in (start, voltages, parameters)]
        return stage.simulate(arrays[0], arrays[1], arrays[2], None, 0.0).states

    def gradients_of(
        start: Array, voltages: Array, parameters: Array, change: Array
    ) -> tuple[Array, Array, Array]:
        arrays = [np.asarray(values, dtype=np.float64) for values in (start, voltages, parameters)]
        motions = stage.simulate(arrays[0], arrays[1], arrays[2], None, 0.0)
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
