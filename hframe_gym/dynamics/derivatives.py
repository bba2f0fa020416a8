"""Derivatives of simulated motions with respect to initial states, voltages and parameters, in reverse mode.

The derivatives are those of the computed motion itself, step by step, not differences of two simulations:
they are exact to rounding. At rest and at a stop, friction has a corner; `Friction` names the derivatives
that can be taken there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..machine import Machine
from .codegen.derivative_loops import periods_back, periods_forward, readings_back, readings_forward
from .codegen.derivative_source import DERIVATIVE_FUNCTIONS, derivative_source
from .codegen.kernel import generate_kernel
from .codegen.kernel_source import FUNCTIONS, KernelSource
from .codegen.lane_program import LaneProgram
from .codegen.machine_code import LANES
from .simulation import LONGEST_STEP, in_parallel

# Derivative where static friction holds a coordinate, or where it stops within a step; the motion is always
# the same. "exact": that of the motion, zero for a voltage that does not move the coordinate. "sliding": as
# if friction kept its direction and size, also through a stop. "smoothed": as "exact", but a force f on a
# coordinate that friction holds with up to F has the fraction |f| / F of its influence when sliding, so that
# voltages count before they overcome it.
Friction = Literal["exact", "smoothed", "sliding"]


@dataclass(frozen=True)
class _Program:
    """The kernel of a machine's shape, and the addresses of its functions and its derivatives' by name."""

    source: KernelSource
    kernel: dict[str, int]
    derivatives: dict[str, int]


_PROGRAMS: dict[tuple[object, ...], _Program] = {}  # of this process, by shape and friction


def _program(machine: Machine, friction: Friction) -> _Program:
    """Return the compiled functions of a machine's shape; generate and compile them at the first request."""
    key = (machine.shape, friction)
    if key not in _PROGRAMS:
        text, source = generate_kernel(machine)
        kernel = LaneProgram(text, FUNCTIONS)
        derivatives = LaneProgram(derivative_source(source, friction=friction), DERIVATIVE_FUNCTIONS)
        _PROGRAMS[key] = _Program(source, dict(kernel.addresses), dict(derivatives.addresses))
    return _PROGRAMS[key]


@dataclass(frozen=True)
class Motions:
    """Motions of B machines over T equal periods, with all that their derivatives need.

    Attributes:
        states: States at the beginning and at the end of every period, SI, shape (B, T + 1, S): positions,
            velocities, then the states of the effects, as in `simulate`.
        inputs: Voltages of the earlier periods, then of the simulated ones, V,
            shape (B, earlier + T, drives).
        parameters: Parameters, SI, shape (B, P).
        kernel_states: States as the kernel has them: belt travel, m, its rate, m/s, time, s, and effect
            states.
    """

    states: Array
    inputs: Array
    parameters: Array
    kernel_states: Array


@dataclass(frozen=True)
class Gradients:
    """Derivatives of one number, such as a cost, that depends on the motions of B machines, per SI unit.

    Attributes:
        start: With respect to the first states, shape (B, S).
        inputs: With respect to the voltages, those of earlier periods first, 1/V, shape (B, earlier + T,
            drives).
        parameters: With respect to the parameters, shape (B, P); zero if they were not requested.
    """

    start: Array
    inputs: Array
    parameters: Array


class DifferentiableMotion:
    """Motions of machines that differ in parameter values only, over equal periods with held voltages.

    `hframe_gym.differentiable` makes these functions differentiable functions of torch and of JAX.

    Args:
        machine: One of the machines; it gives the equations of motion.
        period: Length of a period, s.
        longest_step: Largest step of the integrator, s.
        friction: Derivative where friction holds or stops a coordinate: "exact", "smoothed" or "sliding"
            (see `Friction`).

    Attributes:
        step: Step of the integrator, s.

    Raises:
        InputError: If the period or the step is not positive, the name of the treatment is unknown, or an
            effect changes the clock.
    """

    def __init__(
        self,
        machine: Machine,
        period: float,
        *,
        longest_step: float = LONGEST_STEP,
        friction: Friction = "exact",
    ) -> None:
        if not (0.0 < period < np.inf and 0.0 < longest_step < np.inf):
            raise InputError(f"period ({period:g} s) and longest_step ({longest_step:g} s) must be positive")
        if friction not in get_args(Friction):
            raise InputError(
                f"friction={friction!r} is unknown; choose one of {', '.join(get_args(Friction))}"
            )
        if any(effect.definition.clock for effect in machine.effects):
            raise InputError(
                f"machine {machine.name!r}: derivatives with a drifting clock are not available; "
                "remove the effect, which belongs to the log, from a copy of the machine"
            )
        self.machine, self.period = machine, float(period)
        self._steps = max(1, int(np.ceil(period / longest_step - 1e-6)))
        self.step = self.period / self._steps
        self._program = _program(machine, friction)
        source = self._program.source
        self._count = len(machine.coordinates)
        self._sizes = (self._count, len(source.layout.derived), len(machine.drives))

    @property
    def delayed(self) -> bool:
        """Whether a drive has a delay, so that voltages of earlier periods still act."""
        return self._program.source.drives_delayed

    @property
    def state_size(self) -> int:
        """Number S of entries of a state: positions, velocities, and states of effects."""
        return self._program.source.states - 1

    def simulate(
        self,
        start: Array,
        inputs: Array,
        parameters: Array,
        *,
        earlier: Array | None = None,
        start_time: float = 0.0,
        parallel: bool = True,
    ) -> Motions:
        """Simulate B machines; shapes are not checked.

        Args:
            start: First states, SI, shape (B, S).
            inputs: Voltages of the T periods, V, shape (B, T, drives).
            parameters: Parameters in the order of `Machine.parameters`, SI, shape (B, P).
            earlier: Voltages of the periods before the first one, V, shape (B, any number, drives), for
                drives with a delay. Before all given voltages, the first of them act.
            start_time: Time since the machines were switched on, s, for effects that depend on it.
            parallel: Whether to distribute the machines over threads; likewise in the other methods.

        Returns:
            The motions over T periods, with states of shape (B, T + 1, S); T is the number of voltages.
        """
        periods = inputs.shape[1]
        if earlier is not None:
            inputs = np.concatenate([earlier, inputs], axis=1)
        # Copies, because the caller may change its arrays before it calls `gradients`.
        inputs, parameters = (
            np.array(values, dtype=np.float64, order="C") for values in (inputs, parameters)
        )
        batch, count = len(start), self._count
        states = np.empty((batch, periods + 1, self.state_size + 1))
        units = self._units(parameters)
        states[:, 0, : 2 * count] = start[:, : 2 * count] * units
        states[:, 0, 2 * count] = start_time
        states[:, 0, 2 * count + 1 :] = start[:, 2 * count :]
        kernel = self._program.kernel
        functions = (kernel["prepare"], kernel["voltage_delays"], kernel["advance"])
        arguments = functions, self._sizes, self.delayed, inputs, parameters, self.step, self._steps
        in_parallel(
            lambda first, last: periods_forward(*arguments, first, last, states), -(-batch // LANES), parallel
        )
        public = np.delete(states, 2 * count, axis=2)
        public[:, :, : 2 * count] /= units[:, None]
        return Motions(public, inputs, parameters, states)

    def gradients(
        self, motions: Motions, by_states: Array, *, by_parameters: bool = True, parallel: bool = True
    ) -> Gradients:
        """Compute the gradients of a number, such as a cost, by the chain rule.

        Args:
            motions: Result of `simulate`.
            by_states: Derivatives of the number with respect to the states, per SI unit, shape (B, T + 1, S).
            by_parameters: Whether to compute the derivatives with respect to the parameters; without, they
                are zero.

        Returns:
            Its derivatives with respect to the first states, shape (B, S), the voltages, 1/V, shape (B,
            earlier + T, drives), and the parameters, shape (B, P).
        """
        states, inputs, parameters = motions.kernel_states, motions.inputs, motions.parameters
        batch, count = len(states), self._count
        units = self._units(parameters)
        adjoint = np.insert(by_states, 2 * count, 0.0, axis=2)
        adjoint[:, :, : 2 * count] /= units[:, None]
        start, of_parameters = np.empty((batch, states.shape[2])), np.empty(parameters.shape)
        of_inputs = np.zeros(inputs.shape)
        kernel, derivatives = self._program.kernel, self._program.derivatives
        functions = (
            kernel["prepare"],
            kernel["voltage_delays"],
            kernel["advance"],
            derivatives["step_back" if by_parameters else "step_back_without_parameters"],
            derivatives["prepare_back"],
            derivatives["voltage_delays_back"],
        )

        flags = self.delayed, by_parameters
        arguments = functions, self._sizes, flags, inputs, parameters, self.step, self._steps
        results = states, adjoint, start, of_inputs, of_parameters
        in_parallel(
            lambda first, last: periods_back(*arguments, first, last, *results), -(-batch // LANES), parallel
        )
        by_start = np.delete(start, 2 * count, axis=1)
        if by_parameters:
            first = motions.states[:, 0, : 2 * count]
            change = by_start[:, : 2 * count] * first
            change -= (adjoint[:, :, : 2 * count] * motions.states[:, :, : 2 * count]).sum(1)
            self._add_by_units(change, of_parameters)
        by_start[:, : 2 * count] *= units
        return Gradients(by_start, of_inputs, of_parameters)

    def readings(self, states: Array, parameters: Array, *, parallel: bool = True) -> Array:
        """Compute the readings of the sensors, without noise and delay.

        Args:
            states: States, SI, shape (B, N, S).
            parameters: Parameters, SI, shape (B, P).

        Returns:
            Readings, in the sensors' units, shape (B, N, sensors).
        """
        parameters = np.ascontiguousarray(parameters, dtype=np.float64)
        travel = states[:, :, : self._count] * self._units(parameters)[:, None, : self._count]
        readings = np.empty((*states.shape[:2], len(self.machine.sensors)))
        address = self._program.kernel["read_sensors"]
        in_parallel(
            lambda first, last: readings_forward(address, travel, parameters, first, last, readings),
            -(-len(states) // LANES),
            parallel,
        )
        return readings

    def readings_gradients(
        self, states: Array, parameters: Array, by_readings: Array, *, parallel: bool = True
    ) -> tuple[Array, Array]:
        """Compute the gradients of a number that depends on sensor readings, by the chain rule.

        Args:
            states: States, SI, shape (B, N, S).
            parameters: Parameters, SI, shape (B, P).
            by_readings: Derivatives of the number with respect to the readings, 1 / unit of the sensor,
                shape (B, N, sensors).

        Returns:
            states: Derivatives with respect to the states, shape (B, N, S).
            parameters: Derivatives with respect to the parameters, shape (B, P).
        """
        parameters = np.ascontiguousarray(parameters, dtype=np.float64)
        units = self._units(parameters)[:, None, : self._count]
        travel = states[:, :, : self._count] * units
        of_travel, of_parameters = np.empty(travel.shape), np.empty(parameters.shape)
        address = self._program.derivatives["read_sensors_back"]
        adjoint = np.ascontiguousarray(by_readings, float)
        in_parallel(
            lambda first, last: readings_back(
                address, travel, parameters, adjoint, first, last, of_travel, of_parameters
            ),
            -(-len(states) // LANES),
            parallel,
        )
        by_states = np.zeros(states.shape)
        by_states[:, :, : self._count] = of_travel * units
        change = (of_travel * states[:, :, : self._count]).sum(1)
        self._add_by_units(np.hstack([change, np.zeros_like(change)]), of_parameters)
        return by_states, of_parameters

    def travel_per_unit(self, parameters: Array) -> Array:
        """Compute `Machine.travel_per_unit_of` for `parameters`, shape (B, P): shape (B, coordinates)."""
        return self.machine.travel_per_unit_of(parameters)

    def _units(self, parameters: Array) -> Array:
        """Return the belt travel per position of each coordinate, twice, (B, 2 * coordinates)."""
        return np.tile(self.machine.travel_per_unit_of(parameters), 2)

    def _add_by_units(self, change: Array, by_parameters: Array) -> None:
        """Add derivatives by the belt travel per position, (B, 2 * coordinates), to those by parameters."""
        for i, (column, factor) in self.machine.radius_parameters.items():
            by_parameters[:, column] += factor * (change[:, i] + change[:, self._count + i])
