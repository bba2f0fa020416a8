"""The machine's equations of motion as CasADi expressions, for time-optimal motions.

The equations are those of `hframe_gym.dynamics.Equations`. Coulomb friction is smoothed to F tanh(v / v0),
because an optimizer needs derivatives. `check_supported` refuses machines for which the expressions would be
wrong.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from ...dynamics import Equations, MotionPoint
from ...dynamics.elementwise import tanh
from ...errors import InputError, naming_extra
from ...machine import AppliedEffect, Hook, Machine, argument_names

with naming_extra("bound", "time-optimal motions need CasADi"):
    import casadi as ca

# Hooks of an effect that enter the collocation equations, and CasADi's operations that switch between
# branches.
MOTION_HOOKS = (
    "force",
    "coulomb",
    "friction",
    "viscous",
    "tension",
    "energy_slope",
    "belt_travel",
    "lever_arm",
)
SWITCHING_OPERATIONS = (
    ca.OP_FMIN,
    ca.OP_FMAX,
    ca.OP_IF_ELSE_ZERO,
    ca.OP_SIGN,
    ca.OP_COPYSIGN,
    ca.OP_LT,
    ca.OP_LE,
)


class SymbolicModel:
    """A machine's equations of motion as CasADi expressions, with its parameters and the start as symbols.

    States are the belt travel of n coordinates, m, and its rate, m/s, shape (2 n,). An action is the motor
    voltage of each drive on a scale on which -1 is the lowest and 1 the highest possible voltage,
    shape (drives,).

    Args:
        parameters: CasADi symbols of all P parameters in the order of `Machine.parameters`, shape (P,).
        start: CasADi symbols of the state at the start, m and m/s, shape (2 n,).
        reversal_speed: Speed v0 of the smoothed Coulomb friction F tanh(v / v0), m/s.
    """

    def __init__(self, machine: Machine, parameters: Any, start: Any, reversal_speed: float) -> None:
        values = dict(zip(machine.parameters, ca.vertsplit(parameters), strict=True))
        self._limits = voltage_limits(Equations(machine, values))
        motion = tuple(e for e in machine.effects if e.definition.site not in ("drive", "drives", "sensor"))
        self._equations = Equations(dataclasses.replace(machine, effects=motion), values)
        self._current_limits = [
            (j, values[f"{e.label}.I"])
            for j, d in enumerate(machine.drives)
            for e in machine.effects
            if e.definition.current and d.name in e.components(machine)
        ]
        self._start, self._count = start, len(machine.coordinates)
        arguments = [ca.SX.sym("z", 2 * self._count), ca.SX.sym("u", len(machine.drives)), ca.SX.sym("t")]
        state, action, time = arguments
        accelerations = self._equations.accelerations(
            self._point(state, time), self._voltages(action), lambda v: tanh(v / reversal_speed)
        )
        change = ca.vertcat(state[self._count :], *accelerations)
        self._parameters = parameters
        self._rate = ca.Function("rate", [*arguments, parameters, start], [change])

    def _voltages(self, action: Any) -> list[Any]:
        """Return the voltages at the motors, V."""
        parts = zip(*self._limits, ca.vertsplit(action), strict=True)
        return [0.5 * (low + high) + 0.5 * (high - low) * u for low, high, u in parts]

    def rate(self, state: Any, action: Any, time: Any) -> Any:
        """Return the equations of motion as a CasADi expression: the state's time derivative, shape (2 n,).

        Args:
            state: Belt travel of the n coordinates, m, then its rate, m/s, shape (2 n,).
            action: Voltage of each motor, where -1 stands for the lowest possible one and 1 for the highest,
                dimensionless, shape (drives,).
            time: Time since the start, s.
        """
        return self._rate(state, action, time, self._parameters, self._start)

    def current_excess(self, state: Any, action: Any) -> list[Any]:
        """Return (current / limit)^2 - 1, which must be <= 0, dimensionless, of each drive with a limit.

        Args:
            state: State as in `rate`, m and m/s, shape (2 n,).
            action: Action as in `rate`, dimensionless, shape (drives,).
        """
        voltages, point = self._voltages(action), self._point(state, 0.0)
        current = self._equations.ohmic_current
        return [(current(j, point, voltages[j]) / limit) ** 2 - 1.0 for j, limit in self._current_limits]

    def static_excess(self, state: Any, time: Any) -> list[Any]:
        """Return constraints (expressions that must be <= 0) for the machine to stay at rest in a position.

        A linear coordinate on which no drive acts, such as a carriage between stretched belts, is at rest
        only if its static friction is not less than the other forces on it. The rates in the state are taken
        as zero.

        Args:
            state: State as in `rate`, m and m/s, shape (2 n,).
            time: Time since the start, s.

        Returns:
            Two expressions, N, for each such coordinate: f - F and -f - F, with the force f on it and its
            friction F.
        """
        equations = self._equations
        at_rest = ca.vertcat(state[: self._count], ca.SX.zeros(self._count))
        balance = equations.balance(self._point(at_rest, time), [0.0] * len(equations.machine.drives))
        excess = []
        for i, coordinate in enumerate(equations.machine.coordinates):
            if coordinate.kind == "linear" and i not in equations.drive_coordinates:
                excess += [balance.forces[i] - balance.coulomb[i], -balance.forces[i] - balance.coulomb[i]]
        return excess

    def _point(self, state: Any, time: Any) -> MotionPoint:
        """Return a point of the motion, at which integrated displacements are those since the start."""
        equations, n = self._equations, self._count
        travel = ca.vertsplit(state[:n])
        states = {}
        for k in equations.states:
            i = equations.instances[k].coordinate
            states[k] = (travel[i] - self._start[i]) * equations.per_radius(i)
        return MotionPoint(travel, ca.vertsplit(state[n:]), time, states)


def voltage_limits(equations: Equations) -> tuple[list[Any], list[Any]]:
    """Compute the motor voltages at the rated commands, which the effects on the voltages change.

    Returns:
        Voltage of each drive at its negative rated command, then at its positive one, V: the lowest and the
        highest. They are symbolic expressions if the parameters of the equations are.
    """
    rated = [d.rated_voltage for d in equations.machine.drives]
    return equations.motor_voltages([-volts for volts in rated]), equations.motor_voltages(rated)


def check_supported(machine: Machine) -> None:
    """Check that time-optimal motions of a machine can be computed.

    Raises:
        InputError: If the bridge yaws (the tool position then contains a product of coordinates), or if an
            effect is not supported: a dead time of the drives, an internal state other than the displacement
            since the start, a motion of a sensor's support instead of the tool, a change of the motor current
            by another effect than `current_limit`, or a formula that is not differentiable.
    """
    for effect in machine.effects:
        reason = _unsupported_because(effect)
        if reason:
            raise InputError(
                f"machine {machine.name!r}: time-optimal motions do not support {effect.label}: "
                f"{reason}; leave the effect out"
            )
    if any("*" in key for sensor in machine.sensors for key in sensor.row):
        raise InputError(f"machine {machine.name!r}: time-optimal motions do not support a bridge that yaws")


def _unsupported_because(effect: AppliedEffect) -> str:
    """Return why an effect is not supported, empty if it is."""
    definition = effect.definition
    if definition.delay:
        return "it is a dead time of the drives (the time is longer by about this delay)"
    if definition.next_state and not _integrates_displacement(effect):
        return "it has a memory"
    if definition.force and "net" in argument_names(definition.force):
        return "it moves a sensor, not the tool"
    if definition.force and "load" in argument_names(definition.force):
        return "it depends on the force of the belts, which count as rigid"
    if (definition.current or definition.torque) and effect.name != "current_limit":
        return "effects on current and torque are not supported, except for current_limit"
    hooks = [getattr(definition, name) for name in MOTION_HOOKS]
    if any(_has_kink(hook) for hook in hooks if hook):
        return "its formula is not differentiable"
    return ""


def _integrates_displacement(effect: AppliedEffect) -> bool:
    """Return whether an effect's state is the displacement of its coordinate, as of an eccentric pulley."""
    next_state = effect.definition.next_state
    if next_state is None or set(argument_names(next_state)) != {"z", "dq"}:
        return False
    return bool(effect("next_state", z=0.3, dq=-0.2) == 0.3 - 0.2)


def _has_kink(hook: Hook) -> bool:
    """Return whether a hook's formula switches between branches; |x| is none, as it occurs in x |x|."""
    symbols = [ca.SX.sym(name) for name in argument_names(hook)]
    formula = ca.Function("hook", symbols, [ca.SX(hook(*symbols))])
    return any(formula.instruction_id(k) in SWITCHING_OPERATIONS for k in range(formula.n_instructions()))
