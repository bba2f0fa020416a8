"""What differentiable stages of all libraries have in common: machine, parameters, states, and checks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..dynamics import DifferentiableMotion, Friction, Motions, NotFiniteError, instances_with_state
from ..dynamics.simulation import DIVERGED
from ..envs.batched_simulator import steps_of_period
from ..envs.config import LONGEST_STEP
from ..envs.workspace import EndStops, tool_terms
from ..errors import InputError, example_names
from ..machine import Machine, require_machine, rest_state

Tensor = TypeVar("Tensor")  # array of the library that differentiates


class Stage(ABC, Generic[Tensor]):
    """Machine whose motions a library differentiates; a subclass connects it with one library.

    Args:
        machine: Machine to simulate.
        period: Time for which a voltage is held, s; also the time between two states.
        longest_step: Largest step of the integrator, s. The default is that of the environments, which also
            divide a period as the stage does: stiff belts or teeth, strong dampers and drives that follow a
            set point have shorter steps.
        end_stops: Whether the tool hits end stops at the edges of the workspace, as in the environments.
            Their stiffness counts as constant in the derivatives.
        friction: Derivative where friction holds or stops a coordinate: "exact" for the true one, which is 0
            for a voltage that does not overcome friction; "smoothed" or "sliding" for one that is not
            (docs/differentiable.md).
        parallel: Whether to distribute the machines of a batch over the processor's cores.

    Attributes:
        motion: Simulated motions and their derivatives, on NumPy arrays.
        parameter_names: Names of the P parameters, for example "x.mass".
        nominal: Their values in the machine, SI, shape (P,).
        state_names: Names of the S entries of a state: positions, velocities, states of effects.
        rated: Rated voltages of the drives, V, shape (drives,): what the action 1 of an environment applies.

    Raises:
        InputError: If a value of the machine is impossible, the period or step is not positive, `friction` is
            unknown, a sensor measures an acceleration or a current, or end stops need a workspace that the
            machine does not declare.
    """

    def __init__(
        self,
        machine: Machine,
        period: float = 0.01,
        *,
        longest_step: float = LONGEST_STEP,
        end_stops: bool = False,
        friction: Friction = "exact",
        parallel: bool = True,
    ) -> None:
        self.check_library()
        require_machine(machine)
        felt = [s.channel for s in machine.sensors if s.sensed.jumps]
        if felt:
            raise InputError(
                f"machine {machine.name!r}: a differentiable stage has no readings "
                f"of accelerations and currents; leave {', '.join(felt)} out of a copy of the machine"
            )
        self.machine, self.period, self.parallel = machine, float(period), parallel
        step = period / steps_of_period(machine, period, longest_step)
        self._stops = EndStops(machine, step) if end_stops else None
        simulated = self._stops.machine if self._stops else machine
        self.motion = DifferentiableMotion(simulated, period, longest_step=step, friction=friction)
        self.parameter_names = tuple(machine.parameters)
        self.nominal = np.array(list(machine.parameters.values()))
        names = machine.coordinate_names
        effects = [f"{i.effect.label} of {i.component}" for i in instances_with_state(simulated)]
        self.state_names = (*names, *(f"velocity of {name}" for name in names), *effects)
        self.rated = np.array([drive.rated_voltage for drive in machine.drives], float)
        self._tool = tool_terms(machine) if machine.tool_axes else None

    def check_library(self) -> None:
        """Raise an InputError unless the library computes in float64; constructors call it."""

    @staticmethod
    @abstractmethod
    def from_numpy(values: Array) -> Tensor:
        """Convert `values` of NumPy, of any shape, to an array of the library."""

    @abstractmethod
    def rollout(self, start: Tensor, voltages: Tensor, parameters: Tensor | None = None) -> Tensor:
        """Simulate B machines over T periods; the voltages are held over each period.

        Args:
            start: First states, SI, shape (B, S).
            voltages: Voltages, V, shape (B, T, drives).
            parameters: Parameters in the order of `parameter_names`, SI, shape (P,) or (B, P). Default: those
                of the machine.

        Returns:
            States at the beginning and at the end of every period, SI, shape (B, T + 1, S).

        Raises:
            InputError: If a shape does not fit the machine or the other arguments.
            NotFiniteError: If a motion diverges.
        """

    def rest(self, tool: ArrayLike | None = None, *, batch: int = 1) -> Tensor:
        """Return B states at rest with unstretched belts, SI, shape (B, S).

        Args:
            tool: Positions of the linear coordinates, m, shape (B, linear coordinates), or (linear
                coordinates,) for one state. Default: all coordinates at 0.
            batch: Number of states B if `tool` is not given; otherwise ignored.
        """
        if tool is None:
            rows = [rest_state(self.machine)] * batch
        else:
            rows = [rest_state(self.machine, row) for row in np.atleast_2d(np.asarray(tool, float))]
        states = np.zeros((len(rows), len(self.state_names)))  # states of effects begin at zero
        states[:, : rows[0].size] = rows
        return self.from_numpy(states)

    def column(self, name: str) -> int:
        """Return the index of a parameter, such as "x.mass", in `parameter_names`.

        Raise an InputError if it is unknown.
        """
        if name not in self.parameter_names:
            tied = self.machine.ties.get(name)
            reason = f"is none of its parameters; {example_names(name, self.parameter_names)}"
            if tied:
                reason = f"is {tied[1]:g} times {tied[0]}; change that one"
            raise InputError(f"machine {self.machine.name!r}: {name!r} {reason}")
        return self.parameter_names.index(name)

    def with_end_stops(self, parameters: Array) -> Array:
        """Append the parameters of the end stops to those of B machines, for `motion`.

        They depend on the masses of each machine.

        Args:
            parameters: Parameters of the machines, SI, shape (B, P).

        Returns:
            Both, SI, shape (B, P + number of those of end stops); `parameters` where there are no end stops.
        """
        return self._stops.parameters(parameters) if self._stops else parameters

    def checked(
        self,
        start: Sequence[int],
        voltages: Sequence[int],
        parameters: Sequence[int],
        earlier: Sequence[int] | None,
    ) -> None:
        """Raise an InputError if the shapes of the arguments do not fit the machine and each other.

        Args:
            start: Shape of the first states, which must be (B, S).
            voltages: Shape of the voltages, (B, T, drives) with any T.
            parameters: Shape of the parameters, (B, P).
            earlier: Shape of the voltages of earlier periods, (B, any number, drives); None without them.
        """
        batch = start[0] if len(start) == 2 else -1
        drives, size = len(self.machine.drives), len(self.state_names)
        expected = {
            "start": (start, (batch, size)),
            "voltages": (voltages, (batch, voltages[1] if len(voltages) == 3 else -1, drives)),
            "parameters": (parameters, (batch, len(self.nominal))),
        }
        if earlier is not None:
            expected["earlier"] = (earlier, (batch, earlier[1] if len(earlier) == 3 else -1, drives))
        for name, (shape, right) in expected.items():
            if tuple(shape) != right:
                text = {
                    "start": f"(B, {size})",
                    "voltages": f"(B, periods, {drives})",
                    "earlier": f"(B, periods before, {drives})",
                    "parameters": f"({len(self.nominal)},) or (B, {len(self.nominal)})",
                }[name]
                raise InputError(
                    f"{name} has shape {tuple(shape)}, machine {self.machine.name!r} needs {text}, "
                    "with the same B for all arguments"
                )

    def check_finite(self, states: Array) -> None:
        """Raise a NotFiniteError unless all |entries| of `states`, SI, shape (B, T + 1, S), are below 1e6.

        The error names the motion, the entry of the state and the time.
        """
        diverged = ~(np.abs(states) < DIVERGED)
        if diverged.any():
            b, k, entry = map(int, np.argwhere(diverged)[0])
            raise NotFiniteError(
                f"machine {self.machine.name!r}, motion {b}: {self.state_names[entry]} diverges at t = "
                f"{k * self.period:g} s. Check start, voltages and parameters, or use a shorter longest_step"
            )

    def simulate(
        self,
        start: Array,
        voltages: Array,
        parameters: Array,
        *,
        earlier: Array | None = None,
        start_time: float = 0.0,
    ) -> Motions:
        """Simulate a batch of machines, and raise an error if a motion diverges.

        Args:
            start: First states, SI, shape (B, S).
            voltages: Voltages, V, shape (B, T, drives).
            parameters: Parameters, SI, shape (B, P).
            earlier: Voltages of earlier periods, V, shape (B, any number, drives), or None.
            start_time: Time since the machines were switched on, s.

        Returns:
            The motions over T periods, with states of shape (B, T + 1, S).

        Raises:
            NotFiniteError: If a motion diverges.
        """
        motions = self.motion.simulate(
            start,
            voltages,
            self.with_end_stops(parameters),
            earlier=earlier,
            start_time=start_time,
            parallel=self.parallel,
        )
        self.check_finite(motions.states)
        return motions
