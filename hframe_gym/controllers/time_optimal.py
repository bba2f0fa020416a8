"""Time-optimal motions: the shortest time in which any controller can bring the tool into a band around its goal.

Direct collocation with Radau points: a motion of free duration T from rest into the band, followed by `HOLD_S` in which
the tool stays in the band and at whose end everything is at rest, the belts' forces held by friction and motors.
Voltages are held over each interval within the rated ones, and T is minimized. T ends when the tool enters the band for
the last time, usually at speed, exactly as a settling time does; it does not include coming to rest. IPOPT finds a
local minimum.

The equations of motion are those of `hframe_gym.dynamics.Equations`, evaluated on CasADi expressions. Coulomb friction
is smoothed to F tanh(v / v0), because an optimizer needs derivatives.

References:
    von Stryk (1993), Numerical solution of optimal control problems by direct collocation.
    Biegler (2010), Nonlinear Programming: Concepts, Algorithms, and Applications to Chemical Processes, chapter 10.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..dynamics import Equations, MotionPoint
from ..dynamics.elementwise import tanh
from ..errors import InputError
from ..machine import AppliedEffect, Hook, Machine, argument_names, rest_state
from .input_compensation import InputInversion

try:
    import casadi as ca
except ImportError as error:
    raise ImportError("time-optimal motions need CasADi: pip install 'hframe_gym[bound]'") from error

Array = NDArray[np.float64]
HOLD_S = 0.04  # s, in which the tool comes to rest within the band; twice as long changes T by less than 1 us
DEGREE = 2  # Radau points per interval: third order, and L-stable, which steep friction needs
REVERSAL_SPEED = 0.01  # m/s, v0 of the smoothed friction; moves reach 0.5 to 1 m/s
EFFORT_WEIGHT_S = 1e-6  # s, weight of the mean squared voltage: selects one of several motions of nearly equal T
LONGEST_S, LARGEST_TRAVEL_M, LARGEST_SPEED = 5.0, 5.0, 10.0  # s, m, m/s: bounds of the search
# By default IPOPT starts so far inside the voltage limits that T first grows fourfold; the last barrier of 1e-7 s per
# limit leaves T at most 0.05 ms above its minimum.
IPOPT_OPTIONS: dict[str, Any] = {
    "mu_init": 1e-3,
    "mu_target": 1e-7,
    "tol": 1e-6,
    "max_iter": 600,
    "print_level": 0,
    "sb": "yes",
}
# Hooks of an effect that enter the collocation equations, and CasADi's operations that switch between branches.
MOTION_HOOKS = ("force", "coulomb", "friction", "viscous", "tension", "energy_slope", "belt_travel", "lever_arm")
SWITCHING_OPERATIONS = (ca.OP_FMIN, ca.OP_FMAX, ca.OP_IF_ELSE_ZERO, ca.OP_SIGN, ca.OP_COPYSIGN, ca.OP_LT, ca.OP_LE)
INITIAL_GUESSES = (1.0, 1.6, 0.8)  # of T, in times of the rigid stage; tried in turn until one converges


@dataclass(frozen=True)
class TimeOptimalMotion:
    """Solution of a time-optimal control problem, with voltages constant over k intervals.

    Attributes:
        time_s: Duration T from the start until the tool enters the band around its goal for the last time, s.
        solved: Whether IPOPT has converged; if not, T has no meaning.
        status: IPOPT's return status.
        edges_s: Edges of the intervals from 0 to T + HOLD_S (the time within the band), s, shape (k + 1,).
        volts: Commanded voltages of the intervals, V, shape (k, drives).
    """

    time_s: float
    solved: bool
    status: str
    edges_s: Array
    volts: Array


class TimeOptimalReach:
    """Solver of the time-optimal control problem of one machine for any start, goal and parameter values.

    The machine's effects (deviations from its nominal model) are part of the motion, except those at sensors. The
    problem's controls are the voltages at the motors: an effect on a drive's voltage (dead band, offset, gain) changes
    their limits, and a current limit is a constraint. Not supported (see `check_supported`) are effects with a memory,
    because their states are not part of the problem; effects whose formula is not differentiable; and a dead time of
    the drives.

    Args:
        machine: Machine whose motion is optimized, with its effects.
        band: Radius of the band around the goal, m.
        intervals: Numbers of collocation intervals of the motion until the tool enters the band for the last time
            (duration T), and of the following HOLD_S within the band.
        reversal_speed: Speed v0 of the smoothed Coulomb friction F tanh(v / v0), m/s.

    Raises:
        InputError: If the machine has an effect that is not supported.
    """

    def __init__(
        self,
        machine: Machine,
        *,
        band: float = 2e-4,
        intervals: tuple[int, int] = (60, 20),
        reversal_speed: float = REVERSAL_SPEED,
    ) -> None:
        check_supported(machine)
        self.machine = machine
        self.band, self.intervals, self.reversal_speed = band, intervals, reversal_speed
        self._axes = [i for i, c in enumerate(machine.coordinates) if c.kind == "linear"]
        positions = [np.split(rest_state(machine, row), 2)[0] for row in np.eye(len(self._axes))]
        self._rigid = np.stack(positions, axis=1) * machine.travel_per_unit[:, None]  # travel per meter of each axis
        self._points = np.array(ca.collocation_points(DEGREE, "radau"))
        self._build()

    def _build(self) -> None:
        """Set up the nonlinear program."""
        n, drives = len(self.machine.coordinates), len(self.machine.drives)
        slopes = ca.collocation_coeff(self._points.tolist())[0]
        moving, holding = self.intervals
        duration: Any = ca.SX.sym("T")
        start, goal = ca.SX.sym("start", 2 * n), ca.SX.sym("goal", len(self._axes))
        parameters = ca.SX.sym("parameters", len(self.machine.parameters))
        model = _SymbolicModel(self.machine, parameters, start, self.reversal_speed)
        unknowns, limits = [duration], [(1e-4, LONGEST_S)]
        state_limits = [(-LARGEST_TRAVEL_M, LARGEST_TRAVEL_M)] * n + [(-LARGEST_SPEED, LARGEST_SPEED)] * n
        equalities, inequalities = [], []  # must be zero; must not be positive
        effort, state = ca.SX(0.0), start
        for k in range(moving + holding):
            length = duration / moving if k < moving else HOLD_S / holding
            begin = k * length if k < moving else duration + (k - moving) * length
            action = ca.SX.sym(f"u{k}", drives)  # from -1, the lowest voltage at the motor, to 1, the highest
            inner = [ca.SX.sym(f"z{k}_{j}", 2 * n) for j in range(DEGREE)]
            unknowns += [action, *inner]
            limits += [(-1.0, 1.0)] * drives + state_limits * DEGREE
            slope = ca.horzcat(state, *inner) @ slopes
            for j, z in enumerate(inner):
                time = begin + float(self._points[j]) * length
                equalities.append(slope[:, j] - length * model.rate(z, action, time))
            inequalities += [excess for z in inner for excess in model.current_excess(z, action)]
            effort += ca.dot(action, action) / ((moving + holding) * drives)
            state = inner[-1]
            inside = inner if k >= moving else inner[-1:] if k == moving - 1 else []
            inequalities += [ca.sumsqr((z[self._axes] - goal) / self.band) - 1.0 for z in inside]
        equalities.append(state[n:])
        inequalities += model.static_excess(state, duration + HOLD_S)
        problem = {
            "x": ca.vertcat(*unknowns),
            "f": duration + EFFORT_WEIGHT_S * effort,
            "g": ca.vertcat(*equalities, *inequalities),
            "p": ca.vertcat(start, goal, parameters),
        }
        self._solver: Any = ca.nlpsol("time_optimal", "ipopt", problem, {"print_time": False, "ipopt": IPOPT_OPTIONS})
        low, high = np.array(limits).T
        lowest = np.repeat([0.0, -np.inf], [ca.vertcat(*equalities).numel(), len(inequalities)])
        self._bounds = {"lbx": low, "ubx": high, "lbg": lowest, "ubg": np.zeros(len(lowest))}

    def solve(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        parameters: ArrayLike | None = None,
        guesses: Sequence[float] = INITIAL_GUESSES,
    ) -> TimeOptimalMotion:
        """Compute the time-optimal motion from rest with unstretched belts into the band around the goal.

        Args:
            start: Positions of the linear coordinates (usually x, y) at the start, m, shape (axes,).
            goal: Positions of the linear coordinates at the goal, m, shape (axes,).
            parameters: All P parameters in the order and units of `Machine.parameters`, shape (P,). Default: the
                machine's.
            guesses: Initial guesses of the duration T of the motion, as multiples of the estimated time with rigid
                belts, tried in this order; at least one.

        Returns:
            `TimeOptimalMotion`: duration, s, and commanded voltages, V, shape (intervals, drives), from the first guess
            with which the solver IPOPT converges; if it converges with none, of the last guess with `solved` False.
        """
        begin, end = np.asarray(start, float), np.asarray(goal, float)
        nominal = list(self.machine.parameters.values())
        values = np.asarray(nominal if parameters is None else parameters, np.float64)
        # Constants of the nonlinear program: the state at the start (belt travel, speed), the goal and the parameters.
        fixed = np.concatenate([self._rigid @ begin, np.zeros(len(self._rigid)), end, values])
        for factor in guesses:
            guess = self._guess(begin, end, factor * self._rigid_time(end - begin, values))
            result = self._solver(x0=guess, p=fixed, **self._bounds)
            statistics = self._solver.stats()
            if statistics["success"]:
                break
        # The unknowns are T, then for each interval the actions and the states at its collocation points.
        solution = np.array(result["x"]).ravel()
        T, by_interval = float(solution[0]), solution[1:].reshape(sum(self.intervals), -1)
        moving, holding = self.intervals
        edges = np.concatenate([np.linspace(0.0, T, moving + 1), T + np.linspace(0.0, HOLD_S, holding + 1)[1:]])
        volts = self._commands(by_interval[:, : len(self.machine.drives)], values)
        return TimeOptimalMotion(T, statistics["success"], statistics["return_status"], edges, volts)

    def _commands(self, actions: Array, values: Array) -> Array:
        """Return the commanded voltages (k, drives), V, that give the motors those of actions (k, drives)."""
        by_name = dict(zip(self.machine.parameters, values.tolist(), strict=True))
        low, high = (np.array(limit, float) for limit in _voltage_limits(Equations(self.machine, by_name)))
        motor_voltage = 0.5 * (low + high) + 0.5 * (high - low) * actions
        return InputInversion(self.machine.replace(by_name)).command(motor_voltage)

    def _rigid_time(self, distance: Array, values: Array) -> float:
        """Return the approximate time of the rigid stage, s: that of its slowest axis, to first order in damping."""
        by_name = dict(zip(self.machine.parameters, values.tolist(), strict=True))
        equations = Equations(dataclasses.replace(self.machine, effects=()), by_name)
        n = len(self.machine.coordinates)
        mass = np.array([equations.mass(i) for i in range(n)]) @ self._rigid**2
        viscous = np.array([equations.viscous(i, 1.0) for i in range(n)]) @ self._rigid**2
        force = np.zeros(len(self._axes))
        for j, (i, d) in enumerate(zip(equations.drive_coordinates, self.machine.drives, strict=True)):
            force += np.abs(self._rigid[i]) * equations.force_per_volt(j) * d.rated_voltage
        times = 2.0 * np.sqrt(np.abs(distance) * mass / force) + np.abs(distance) * viscous / force
        return float(np.max(times)) + 1e-3

    def _guess(self, start: Array, goal: Array, time_s: float) -> Array:
        """Return an initial guess: a smooth motion of the rigid stage, quintic in time, with zero voltage."""
        moving, holding = self.intervals
        s = np.minimum((np.arange(moving + holding)[:, None] + self._points) / moving, 1.0)[..., None]
        travel = self._rigid @ start + (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * (self._rigid @ (goal - start))
        speed = 30.0 * s**2 * (1.0 - s) ** 2 / time_s * (self._rigid @ (goal - start))
        states = np.concatenate([travel, speed], axis=2).reshape(moving + holding, -1)
        actions = np.zeros((moving + holding, len(self.machine.drives)))
        return np.concatenate([[time_s], np.concatenate([actions, states], axis=1).ravel()])


class _SymbolicModel:
    """A machine's equations of motion as CasADi expressions, with its parameters and the start as symbols.

    States are belt travel, m, and its rate, m/s, shape (2 n,). Actions lead from the lowest voltage at the motor, -1,
    to the highest, 1.
    """

    def __init__(self, machine: Machine, parameters: Any, start: Any, reversal_speed: float) -> None:
        values = dict(zip(machine.parameters, ca.vertsplit(parameters), strict=True))
        self._limits = _voltage_limits(Equations(machine, values))
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
        """Return the state's derivative."""
        return self._rate(state, action, time, self._parameters, self._start)

    def current_excess(self, state: Any, action: Any) -> list[Any]:
        """Return expressions that are not positive where the drives' currents are within their limits."""
        voltages, point = self._voltages(action), self._point(state, 0.0)
        current = self._equations.ohmic_current
        return [(current(j, point, voltages[j]) / limit) ** 2 - 1.0 for j, limit in self._current_limits]

    def static_excess(self, state: Any, time: Any) -> list[Any]:
        """Return expressions that are not positive where static friction holds each coordinate that is not driven."""
        equations = self._equations
        at_rest = ca.vertcat(state[: self._count], ca.SX.zeros(self._count))
        balance = equations.balance(self._point(at_rest, time), [0.0] * len(equations.machine.drives))
        excess = []
        for i, coordinate in enumerate(equations.machine.coordinates):
            if coordinate.kind == "linear" and i not in equations.drive_coordinates:
                excess += [balance.forces[i] - balance.coulomb[i], -balance.forces[i] - balance.coulomb[i]]
        return excess

    def _point(self, state: Any, time: Any) -> MotionPoint:
        """Return a point of the motion; effects that integrate displacement have it since the start as their state."""
        equations, n = self._equations, self._count
        travel = ca.vertsplit(state[:n])
        states = {}
        for k in equations.states:
            i = equations.instances[k].coordinate
            states[k] = (travel[i] - self._start[i]) * equations.per_radius(i)
        return MotionPoint(travel, ca.vertsplit(state[n:]), time, states)


def _voltage_limits(equations: Equations) -> tuple[list[Any], list[Any]]:
    """Return the lowest and highest voltages at the motors, V, within the rated commands."""
    rated = [d.rated_voltage for d in equations.machine.drives]
    return equations.motor_voltages([-volts for volts in rated]), equations.motor_voltages(rated)


def check_supported(machine: Machine) -> None:
    """Check that time-optimal motions of a machine can be computed.

    Args:
        machine: Machine with its effects (deviations from the nominal model).

    Raises:
        InputError: If an effect delays the drives, has a memory or is not differentiable, or the machine's bridge yaws
            (the tool position is then not given by the linear coordinates alone).
    """
    for effect in machine.effects:
        reason = _unsupported_because(effect)
        if reason:
            raise InputError(
                f"machine {machine.name!r}: time-optimal motions do not support {effect.label}: {reason}; leave the "
                "effect out"
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
    if definition.current and effect.name != "current_limit":
        return "effects on the current are not supported, except for current_limit"
    hooks = [getattr(definition, name) for name in MOTION_HOOKS]
    if any(_has_kink(hook) for hook in hooks if hook):
        return "its formula is not differentiable"
    return ""


def _integrates_displacement(effect: AppliedEffect) -> bool:
    """Whether an effect's state is the displacement of its coordinate since the start, as of an eccentric pulley."""
    next_state = effect.definition.next_state
    if next_state is None or set(argument_names(next_state)) != {"z", "dq"}:
        return False
    return bool(effect("next_state", z=0.3, dq=-0.2) == 0.3 - 0.2)


def _has_kink(hook: Hook) -> bool:
    """Whether a hook's formula switches between branches; |x| is not counted, because it occurs as x |x|."""
    symbols = [ca.SX.sym(name) for name in argument_names(hook)]
    formula = ca.Function("hook", symbols, [ca.SX(hook(*symbols))])
    return any(formula.instruction_id(k) in SWITCHING_OPERATIONS for k in range(formula.n_instructions()))
