"""Formulas of a machine for a motion controller, traced for the languages of controllers, and test vectors.

feedforward             voltages of a motion of the tool
friction_compensation   the part of them against dry friction and forces of effects
motor_reference         motor positions with stretched belts
pid                     one step of the textbook PID
amplifier_J, command_J  characteristic of amplifier J and its inverse, for drives with effects on their
                        voltage
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array
from ...controllers import TextbookPID
from ...dynamics.elementwise import absolute, maximum, minimum, where
from ...dynamics.symbolic.tracing import Expression
from ...errors import InputError
from ...machine import Machine, motion_limits
from ..base import axis_range, plain
from .formula import Formula, Parameter, Signal, parameters_of, trace_formula
from .inverse_dynamics import InverseDynamics

_DEFAULT_SPEED = 1.0  # m/s, where the machine states no highest speed
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}", re.ASCII)


class Vectors(NamedTuple):
    """Inputs of a formula and the outputs that the equations give for them.

    Attributes:
        inputs: Entries of all inputs but states, shape (vectors, entries).
        outputs: Entries of all outputs but states, shape (vectors, entries).
    """

    inputs: Array
    outputs: Array


@dataclass(frozen=True)
class MotionFormulas:
    """Formulas of a machine.

    Attributes:
        dynamics: Inverse dynamics that the formulas evaluate.
        formulas: Traced formulas in the order in which they are written.
        amplifiers: Traced characteristics of amplifiers by index of the drive.
        parameters: Parameters that the formulas may contain.
        pid: Controller of the formula `pid`; None if the machine has none.
        without_pid: Why there is no PID, in words; "" if there is one.
    """

    dynamics: InverseDynamics
    formulas: tuple[Formula, ...]
    amplifiers: dict[int, Formula]
    parameters: tuple[Parameter, ...]
    pid: TextbookPID | None
    without_pid: str

    def statements(self) -> list[str]:
        """Describe what the formulas contain, in lines for a comment."""
        axes = ", ".join(self.dynamics.axes)
        drives = ", ".join(f"{d.name} ({d.channel})" for d in self.dynamics.machine.drives)
        lines = [
            f"Axes, in the order of arrays: {axes}. Drives: {drives}.",
            "Units: m, m/s, m/s^2, V, rad (rotary motors), s; parameters in SI, see their comments.",
            "Belts are rigid in feedforward; no dry friction is compensated at zero speed, where "
            "its direction is unknown.",
            f"Effects that are not contained: {', '.join(self.dynamics.left_out) or 'none'}.",
        ]
        if self.without_pid:
            lines.append(f"No pid: {self.without_pid}")
        return [plain(line) for line in lines]

    def vectors(self, formula: Formula, count: int, seed: int) -> Vectors:
        """Compute test vectors of a formula: random inputs, and the outputs that the equations give for them.

        The vectors of `pid` are successive steps of the controller from an integral of zero, those of other
        formulas belong to random times, s, and motions within the limits of the machine.

        Args:
            formula: One of `formulas`, not an amplifier's.
            count: Number of vectors.
            seed: Seed of the random numbers; equal seeds give equal vectors.

        Returns:
            Entries of all inputs and of all outputs but states, shape (count, entries) each.
        """
        rng = np.random.default_rng(seed)
        time, position, velocity, acceleration = self._random_motion(rng, count)
        if formula.name == "pid":
            return self._pid_vectors(rng, position, velocity)
        inputs, outputs = [], []
        for motion in zip(
            *(values.tolist() for values in (time, position, velocity, acceleration)), strict=True
        ):
            signals = dict(zip(("time", "position", "velocity", "acceleration"), motion, strict=True))
            arguments = [signals[signal.name] for signal in formula.inputs]
            inputs.append(np.hstack(arguments))
            outputs.append(formula.function(None, *arguments))
        return Vectors(np.array(inputs), np.array(outputs, np.float64))

    def _random_motion(self, rng: np.random.Generator, count: int) -> tuple[Array, Array, Array, Array]:
        """Return times and states of the tool within limits of the machine; every fourth speed is zero."""
        machine, axes = self.dynamics.machine, self.dynamics.axes
        limits = motion_limits(machine)
        ranges = np.array([axis_range(machine.coordinate(a)) for a in axes])
        speeds = [limits[a].speed if a in limits else np.inf for a in axes]
        highest = np.array([s if 1e-6 < s < np.inf else _DEFAULT_SPEED for s in speeds])
        hardest = np.array(
            [max(limits[a].force / limits[a].inertia, 1.0) if a in limits else 1.0 for a in axes]
        )
        shape = (count, len(axes))
        position = rng.uniform(ranges[:, 0], ranges[:, 1], shape)
        # Many slow ones, where friction changes.
        velocity = 0.8 * highest * rng.uniform(-1.0, 1.0, shape) ** 3
        velocity[rng.random(shape) < 0.25] = 0.0
        return rng.uniform(0.0, 100.0, count), position, velocity, hardest * rng.uniform(-1.0, 1.0, shape)

    def _pid_vectors(self, rng: np.random.Generator, position: Array, velocity: Array) -> Vectors:
        """Return successive steps of the textbook PID, some of them saturated."""
        assert self.pid is not None
        pid, n = self.pid, len(self.pid.model.mass)
        reach = float(
            np.min(pid.model.rated / np.abs(pid.model.voltage(np.diag(pid.proportional)).T).max(axis=1))
        )
        inputs, outputs = [], []
        pid.reset()
        for p, v in zip(position, velocity, strict=True):
            goal = p + 2.0 * reach * rng.uniform(-1.0, 1.0, len(p)) ** 3
            goal_velocity = 0.1 * v
            state = np.zeros((1, 2 * n))
            state[0, pid.model.tool], state[0, n + np.array(pid.model.tool)] = p, v
            later = goal + pid.period * goal_velocity
            actions = pid.act_on_state(state, np.stack([goal, later])[None])
            inputs.append(np.concatenate([p, v, goal, (later - goal) / pid.period]))
            outputs.append(actions[0] * pid.model.rated)
        return Vectors(np.array(inputs), np.array(outputs))


def motion_formulas(machine: Machine, period: float) -> MotionFormulas:
    """Trace the formulas of a machine: the feedforward, what belongs to it, and if possible a PID.

    Args:
        machine: Machine with one drive per axis of its tool, linear axes and no drive with a law. Effects
            that the formulas cannot contain are left out (`InverseDynamics.left_out`).
        period: Control period of the PID, s.

    Returns:
        The formulas. If the machine has no textbook PID, they lack it, and `without_pid` states the reason.

    Raises:
        InputError: If the machine has no inverse dynamics (`InverseDynamics`), or the period is invalid.
    """
    dynamics = InverseDynamics(machine)
    parameters = parameters_of(dynamics.machine)
    formulas = _formulas_of_motion(dynamics, parameters)
    pid, reason = _pid_or_reason(machine, period)
    gains = _pid_parameters(pid) if pid else {}
    if pid:
        formulas.append(_pid_formula(pid, gains))
    return MotionFormulas(
        dynamics,
        tuple(formulas),
        _amplifier_formulas(dynamics, parameters),
        (*parameters.values(), *gains.values()),
        pid,
        reason,
    )


def _formulas_of_motion(dynamics: InverseDynamics, parameters: Mapping[str, Parameter]) -> list[Formula]:
    """Trace what a motion of the tool needs: voltages, those against friction, and motor positions."""
    axes, drives = len(dynamics.axes), len(dynamics.machine.drives)
    time = Signal("time", 0, "time since the machine was switched on, s")
    position = Signal("position", axes, "tool position, m")
    velocity = Signal("velocity", axes, "tool velocity, m/s")
    acceleration = Signal("acceleration", axes, "tool acceleration, m/s^2")
    voltage = Signal("voltage", drives, "commanded voltage of each drive, V, not limited")
    added = Signal("voltage", drives, "voltage at each motor, V, to be added to a controller's")
    motors = Signal("motor", drives, "position of the coordinate of each drive, rad (m of a linear one)")
    motion = (time, position, velocity, acceleration)

    def invert(j: int, u: Any) -> Any:
        return u.trace.node(f"command_{j}", u) if isinstance(u, Expression) else dynamics.command(j, u)

    def feedforward(values: Any, t: Any, p: Any, v: Any, a: Any) -> list[Any]:
        forces, _ = dynamics.coordinate_forces(values, t, p, v, a)
        return dynamics.commands(dynamics.motor_voltages(values, forces), invert)

    def friction(values: Any, t: Any, p: Any, v: Any) -> list[Any]:
        _, forces = dynamics.coordinate_forces(values, t, p, v, [0.0] * axes)
        return dynamics.motor_voltages(values, forces)

    def reference(values: Any, t: Any, p: Any, v: Any, a: Any) -> list[Any]:
        forces, _ = dynamics.coordinate_forces(values, t, p, v, a)
        return dynamics.motor_reference(values, p, forces)

    formulas = [
        trace_formula("feedforward", "Voltages of a motion.", motion, [voltage], feedforward, parameters),
        trace_formula(
            "friction_compensation",
            "Voltages against dry friction and forces of effects, without viscous friction and back-EMF.",
            (time, position, velocity),
            [added],
            friction,
            parameters,
        ),
    ]
    if dynamics.elastic:
        text = "Motor positions at which the belts transmit the forces of a motion."
        formulas.append(trace_formula("motor_reference", text, motion, [motors], reference, parameters))
    return formulas


def _amplifier_formulas(dynamics: InverseDynamics, parameters: Mapping[str, Parameter]) -> dict[int, Formula]:
    """Trace the characteristics of the amplifiers with effects on their voltage, by index of the drive."""
    return {
        j: trace_formula(
            f"amplifier_{j}",
            f"Voltage at motor {j} that a command gives.",
            [Signal("command", 0, "V")],
            [Signal("result", 0, "V")],
            lambda values, command, j=j: [dynamics.amplifier(values, j, command)],
            parameters,
        )
        for j, has in enumerate(dynamics.has_amplifiers)
        if has
    }


def _pid_or_reason(machine: Machine, period: float) -> tuple[TextbookPID | None, str]:
    """Return the textbook PID of a machine, or None and why it has none; an InputError refuses the period."""
    try:
        return TextbookPID(machine, period), ""
    except InputError as error:
        if "period" in str(error):
            raise
        return None, str(error)


def _pid_parameters(pid: TextbookPID) -> dict[str, Parameter]:
    """Return gains and limits of the PID by the keys that `_pid_formula` uses."""
    found = {"period": Parameter("pid_period", pid.period, "control period, s")}
    volts = pid.model.voltage(np.eye(len(pid.model.axes))).T  # V/N, (drives, axes)
    for k, axis in enumerate(pid.model.axes):
        for key, values, unit in (
            ("p", pid.proportional, "N/m"),
            ("i", pid.integral, "N/(m s)"),
            ("d", pid.derivative, "Ns/m"),
        ):
            found[f"{key}{k}"] = Parameter(
                f"pid_{key}_{k}", float(values[k]), plain(f"{key.upper()} of {axis}, {unit}")
            )
    for j, drive in enumerate(pid.machine.drives):
        found[f"rated{j}"] = Parameter(
            f"pid_limit_{j}", float(pid.model.rated[j]), plain(f"limit of {drive.name}, V")
        )
        for k, axis in enumerate(pid.model.axes):
            comment = plain(f"voltage of {drive.name} per force along {axis}, V/N")
            found[f"volts{j}{k}"] = Parameter(f"pid_volts_{j}_{k}", float(volts[j, k]), comment)
    return found


def _pid_formula(pid: TextbookPID, gains: dict[str, Parameter]) -> Formula:
    """Trace one step of `TextbookPID.act_on_state` for one machine."""
    axes, drives = len(pid.model.axes), len(pid.machine.drives)
    integral = Signal(
        "integral", axes, "force of the integrators, N; 0 at the start, keep it between the steps"
    )
    inputs = (
        Signal("position", axes, "measured tool position, m"),
        Signal("velocity", axes, "measured tool velocity, m/s"),
        Signal("goal", axes, "goal, m"),
        Signal("goal_velocity", axes, "velocity of the goal, m/s; 0 for a fixed one"),
        integral,
    )
    outputs = (integral, Signal("voltage", drives, "commanded voltage of each drive, V, limited"))

    def step(
        values: Any, position: Any, velocity: Any, goal: Any, goal_velocity: Any, stored: Any
    ) -> list[Any]:
        forces, integrals = [], []
        for k in range(axes):
            error = goal[k] - position[k]
            integrals.append(stored[k] + values[f"i{k}"] * values["period"] * error)
            damping = values[f"d{k}"] * (velocity[k] - goal_velocity[k])
            forces.append(values[f"p{k}"] * error - damping + integrals[k])
        volts = [
            sum(
                (values[f"volts{j}{k}"] * forces[k] for k in range(1, axes)),
                start=values[f"volts{j}0"] * forces[0],
            )
            for j in range(drives)
        ]
        saturated = [absolute(volts[j]) > values[f"rated{j}"] for j in range(drives)]
        any_saturated = saturated[0]
        for more in saturated[1:]:
            any_saturated = any_saturated | more
        kept = [where(any_saturated, stored[k], integrals[k]) for k in range(axes)]
        limited = [
            minimum(maximum(volts[j], -values[f"rated{j}"]), values[f"rated{j}"]) for j in range(drives)
        ]
        return [*kept, *limited]

    text = (
        f"One step of the textbook PID at a period of {pid.period!r} s; the integrators hold while a drive "
        "saturates."
    )
    return trace_formula("pid", text, inputs, outputs, step, gains)


def check_prefix(prefix: str) -> str:
    """Return the value of --prefix; InputError if it is no identifier of C and Structured Text."""
    if not _NAME.fullmatch(prefix) or "__" in prefix:
        raise InputError(
            f"--prefix {prefix}: must be a letter followed by at most 30 letters, digits or underscores"
        )
    return prefix
