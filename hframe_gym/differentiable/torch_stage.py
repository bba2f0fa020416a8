"""Motions of a machine as differentiable functions of torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from ..arrays import Array
from ..errors import InputError, naming_extra
from .stage import Stage

with naming_extra("agents", "differentiable stages need torch"):
    import torch

Tensor = torch.Tensor


class DifferentiableStage(Stage[torch.Tensor]):
    """Stage that torch differentiates with respect to initial state, voltages and machine parameters.

    Tensors must be on the device "cpu". Motions are computed in float64; a gradient has the dtype of the
    tensor that it belongs to. Second derivatives are not available. The arguments are those of `Stage`. In
    shapes, B is the number of machines, n that of times, S that of entries of `state_names`, and P that of
    `parameter_names`.

    Example:
        ::

            stage = DifferentiableStage(load_machine("hframe"))
            voltages = torch.zeros(1, 50, 2, requires_grad=True)
            states = stage.rollout(stage.rest([[0.0, 0.0]]), voltages)
            distance = (stage.tool_positions(states)[:, -1] - torch.tensor([0.05, 0.02])).square().sum()
            distance.backward()  # voltages.grad, shape (1, 50, 2)
    """

    @staticmethod
    @override
    def from_numpy(values: Array) -> Tensor:
        """Convert a NumPy array to a tensor that shares its memory."""
        return torch.from_numpy(values)

    def parameters(self, changes: Mapping[str, Any], *, batch: int = 1) -> Tensor:
        """Return the parameters of B machines, with some values replaced by those in `changes`.

        Args:
            changes: Value of each changed parameter by name, SI: number, or tensor of shape () or (B,).
            batch: Number of machines, B.

        Returns:
            Parameters in the order of `parameter_names`, SI, shape (B, P).

        Raises:
            InputError: If the machine has no such parameter.
        """
        columns = list(torch.from_numpy(self.nominal).expand(batch, -1).unbind(1))
        for name, value in changes.items():
            columns[self.column(name)] = torch.as_tensor(value, dtype=torch.float64).expand(batch)
        return torch.stack(columns, dim=1)

    @override
    def rollout(
        self,
        start: Tensor,
        voltages: Tensor,
        parameters: Tensor | None = None,
        *,
        earlier: Tensor | None = None,
        start_time: float = 0.0,
    ) -> Tensor:
        """Simulate as `Stage.rollout` does, with two further arguments.

        Args:
            earlier: Voltages of periods before the first one, V, shape (B, any number, drives), in the order
                of time; they matter for drives with a delay. Default: the first voltages acted before as
                well.
            start_time: Time since the machines were switched on, s, for effects that depend on it.

        Raises:
            InputError: As in `Stage.rollout`, or if an argument is no tensor or not on the device "cpu".
        """
        given = {"start": start, "voltages": voltages, "parameters": parameters, "earlier": earlier}
        for name, tensor in given.items():
            if tensor is None:
                continue
            if not isinstance(tensor, torch.Tensor):
                raise InputError(
                    f"{name} is of type {type(tensor).__name__}; "
                    f"give a tensor, such as torch.as_tensor({name})"
                )
            if tensor.device.type != "cpu":
                raise InputError(
                    f"{name} is on the device {tensor.device}; machines are simulated on the processor"
                )
        values = self._parameters_or_nominal(parameters, len(start) if start.ndim == 2 else 1)
        self.checked(start.shape, voltages.shape, values.shape, None if earlier is None else earlier.shape)
        before = voltages.new_zeros((len(start), 0, voltages.shape[2])) if earlier is None else earlier
        result: Tensor = _rollout(
            start.double(), voltages.double(), values.double(), before.double(), self, start_time
        )
        return result

    def _parameters_or_nominal(self, parameters: Tensor | None, batch: int) -> Tensor:
        """Return the given parameters, or those of the machine, for each machine of a batch."""
        values = torch.from_numpy(self.nominal) if parameters is None else parameters
        return values.expand(batch, -1) if values.ndim == 1 else values

    def step(
        self,
        state: Tensor,
        voltages: Tensor,
        parameters: Tensor | None = None,
        *,
        earlier: Tensor | None = None,
        start_time: float = 0.0,
    ) -> Tensor:
        """Simulate one period, for a policy or controller whose voltages depend on the state.

        Args:
            state: States, SI, shape (B, S).
            voltages: Voltages, V, shape (B, drives).
            parameters: Parameters, SI, shape (P,) or (B, P). Default: those of the machine.
            earlier: Voltages of the periods before, V, shape (B, any number, drives), for drives with a
                delay. Default: the voltages of this period acted before as well.
            start_time: Time since the machines were switched on, s, for effects that depend on it.

        Returns:
            States at the end of the period, SI, shape (B, S).

        Raises:
            InputError: As in `rollout`.
            NotFiniteError: If a motion diverges.
        """
        states = self.rollout(state, voltages[:, None], parameters, earlier=earlier, start_time=start_time)
        return states[:, 1]

    def readings(self, states: Tensor, parameters: Tensor | None = None) -> Tensor:
        """Compute the sensors' readings without noise and delay, in their units, shape (B, n, sensors).

        Args:
            states: States, SI, shape (B, n, S).
            parameters: Parameters, SI, shape (P,) or (B, P). Default: those of the machine.
        """
        values = self._parameters_or_nominal(parameters, len(states))
        result: Tensor = _readings(states.double(), values.double(), self)
        return result

    def tool_positions(self, states: Tensor) -> Tensor:
        """Return the tool positions, m or rad, shape (..., axes), at `states`, SI, shape (..., S).

        Raises:
            InputError: If the machine has no tool axes.
        """
        if self._tool is None:
            raise InputError(
                f"machine {self.machine.name!r} declares no tool_axes; use the states themselves"
            )
        # With a bridge that yaws, the product of two coordinates is added: the tool is at x + yaw y.
        axes = [
            states[..., i] + (states[..., a] * states[..., b] if a >= 0 else 0.0) for i, a, b in self._tool
        ]
        return torch.stack(axes, dim=-1)


class _Rollout(torch.autograd.Function):
    """States of motions as a differentiable function of start, voltages, parameters and earlier voltages."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        start: Tensor,
        voltages: Tensor,
        parameters: Tensor,
        earlier: Tensor,
        stage: Stage[Tensor],
        start_time: float,
    ) -> Tensor:
        arrays = [tensor.detach().numpy() for tensor in (start, voltages, parameters)]
        before = earlier.detach().numpy()
        ctx.motions = stage.simulate(*arrays, earlier=before, start_time=start_time)
        ctx.stage, ctx.earlier_periods, ctx.declared = stage, earlier.shape[1], parameters.shape[1]
        return torch.from_numpy(ctx.motions.states)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Any:  # type: ignore[override]
        stage: Stage[Tensor] = ctx.stage
        found = stage.motion.gradients(
            ctx.motions, gradient.numpy(), by_parameters=ctx.needs_input_grad[2], parallel=stage.parallel
        )
        start, inputs, parameters = map(torch.from_numpy, (found.start, found.inputs, found.parameters))
        # Parameters of the end stops follow those that are declared; inputs begin with the earlier voltages.
        by_parameters = parameters[:, : ctx.declared] if ctx.needs_input_grad[2] else None
        voltages, earlier = inputs[:, ctx.earlier_periods :], inputs[:, : ctx.earlier_periods]
        return start, voltages, by_parameters, earlier, None, None


class _Readings(torch.autograd.Function):
    """Readings of the sensors as a differentiable function of states and parameters."""

    @staticmethod
    def forward(ctx: Any, states: Tensor, parameters: Tensor, stage: Stage[Tensor]) -> Tensor:  # type: ignore[override]
        ctx.stage, ctx.declared = stage, parameters.shape[1]
        ctx.states = states.detach().numpy()
        ctx.parameters = stage.with_end_stops(parameters.detach().numpy())
        return torch.from_numpy(stage.motion.readings(ctx.states, ctx.parameters, parallel=stage.parallel))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Any:  # type: ignore[override]
        stage: Stage[Tensor] = ctx.stage
        found = stage.motion.readings_gradients(
            ctx.states, ctx.parameters, gradient.numpy(), parallel=stage.parallel
        )
        states, parameters = map(torch.from_numpy, found)
        return states, parameters[:, : ctx.declared], None


_rollout: Any = _Rollout.apply
_readings: Any = _Readings.apply
