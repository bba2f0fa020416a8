"""Time-optimal motions: the shortest time in which a controller can bring the tool close to its goal.

Direct collocation with Radau points: a motion of free duration T from rest into the band, followed by
`HOLD_S` in which the tool stays in the band and at whose end everything is at rest, the belts' forces held by
friction and motors. Voltages are held over each interval within the rated ones, and T is minimized. T ends
when the tool enters the band for the last time, usually at speed, exactly as a settling time does; it does
not include coming to rest. IPOPT finds a local minimum.

The equations of motion are those of `hframe_gym.dynamics.Equations`, evaluated on CasADi expressions. Coulomb
friction is smoothed to F tanh(v / v0), because an optimizer needs derivatives.

References:
    von Stryk (1993), Numerical solution of optimal control problems by direct collocation.
    Biegler (2010), Nonlinear Programming: Concepts, Algorithms, and Applications to Chemical Processes,
    chapter 10.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Array
from ...dynamics import Equations
from ...errors import naming_extra
from ...machine import Machine, rest_positions_per_axis
from ..models.casadi_model import SymbolicModel, check_supported, voltage_limits
from ..models.input_compensation import InputInversion
from ..models.motion_model import axis_travel_per_unit

with naming_extra("bound", "time-optimal motions need CasADi"):
    import casadi as ca

HOLD_S = 0.04  # s, in which the tool comes to rest within the band; twice as long changes T by less than 1 us
DEGREE = 2  # Radau points per interval: third order, and L-stable, which steep friction needs
SMOOTHED_REVERSAL_SPEED = 0.01  # m/s, v0 of the smoothed friction; moves reach 0.5 to 1 m/s
# s, weight of the mean squared voltage: selects one of several motions of nearly equal T.
EFFORT_WEIGHT_S = 1e-6
LONGEST_S, LARGEST_TRAVEL_M, LARGEST_SPEED = 5.0, 5.0, 10.0  # s, m, m/s: bounds of the search, at least
# By default IPOPT starts so far inside the voltage limits that T first grows fourfold; the last barrier of
# 1e-7 s per limit leaves T at most 0.05 ms above its minimum.
IPOPT_OPTIONS: dict[str, Any] = {
    "mu_init": 1e-3,
    "mu_target": 1e-7,
    "tol": 1e-6,
    "max_iter": 600,
    "print_level": 0,
    "sb": "yes",
}
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

    The machine's effects (deviations from its nominal model) are part of the motion, except those at sensors.
    The problem's controls are the voltages at the motors: an effect on a drive's voltage (dead band, offset,
    gain) changes their limits, and a current limit is a constraint. Not supported (see `check_supported`) are
    effects with a memory, because their states are not part of the problem; effects whose formula is not
    differentiable; and a dead time of the drives.

    Args:
        band: Radius of the band around the goal, m or rad.
        intervals: Numbers of collocation intervals of the motion until the tool enters the band for the last
            time (duration T), and of the following HOLD_S within the band.
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
        reversal_speed: float = SMOOTHED_REVERSAL_SPEED,
    ) -> None:
        check_supported(machine)
        self.machine = machine
        self.band, self.intervals, self.reversal_speed = band, intervals, reversal_speed
        self._axes = [machine.coordinate_names.index(axis) for axis in machine.tool_axes]
        # Travel per position of each axis, m/m or m/rad.
        self._rigid = rest_positions_per_axis(machine) * machine.travel_per_unit[:, None]
        self._radii = axis_travel_per_unit(machine)
        self._points = np.array(ca.collocation_points(DEGREE, "radau"))
        self.solution: Array = np.zeros(0)  # unknowns of the last call of `solve`
        self._build()

    @property
    def _duration_limits(self) -> tuple[float, float]:
        """Smallest and largest T, s."""
        return 1e-4, LONGEST_S

    def _largest_motion(self) -> tuple[float, float]:
        """Return the bounds of travel and speed, m and m/s, wide enough for workspace and no-load speed."""
        machine = self.machine
        ends = [max(map(abs, limits)) if limits else 0.0 for limits in machine.axis_ranges]
        no_load = [
            d.rated_voltage / (d.Ke * d.gear_ratio) * machine.coordinate(d.coordinate).travel_per_unit
            for d in machine.drives
            if d.Ke > 0.0
        ]
        reach = float(np.max(np.array(ends) * self._radii, initial=0.0))
        return max(LARGEST_TRAVEL_M, 2.0 * reach), max(LARGEST_SPEED, 2.0 * max(no_load, default=0.0))

    def _grid(self, duration: Any) -> list[tuple[Any, Any]]:
        """Return begin and length of each collocation interval, s, in which the voltages are constant."""
        moving, holding = self.intervals
        motion = [(k * (duration / moving), duration / moving) for k in range(moving)]
        return motion + [(duration + k * (HOLD_S / holding), HOLD_S / holding) for k in range(holding)]

    def _continues_voltage(self, k: int) -> bool:
        """Return whether interval k has the voltages of the one before."""
        return False

    def _build(self) -> None:
        """Set up the nonlinear program."""
        n, drives = len(self.machine.coordinates), len(self.machine.drives)
        slopes = ca.collocation_coeff(self._points.tolist())[0]
        moving, _ = self.intervals
        duration: Any = ca.SX.sym("T")
        start, goal = ca.SX.sym("start", 2 * n), ca.SX.sym("goal", len(self._axes))
        parameters = ca.SX.sym("parameters", len(self.machine.parameters))
        model = SymbolicModel(self.machine, parameters, start, self.reversal_speed)
        unknowns, limits = [duration], [self._duration_limits]
        travel, speed = self._largest_motion()
        state_limits = [(-travel, travel)] * n + [(-speed, speed)] * n
        equalities, inequalities = [], []  # must be zero; must not be positive
        effort, state, action = ca.SX(0.0), start, ca.SX.zeros(drives)
        for k, (begin, length) in enumerate(self._grid(duration)):
            previous = action
            action = ca.SX.sym(f"u{k}", drives)  # from -1, the lowest voltage at the motor, to 1, the highest
            inner = [ca.SX.sym(f"z{k}_{j}", 2 * n) for j in range(DEGREE)]
            unknowns += [action, *inner]
            if self._continues_voltage(k):
                equalities.append(action - previous)
            limits += [(-1.0, 1.0)] * drives + state_limits * DEGREE
            slope = ca.horzcat(state, *inner) @ slopes
            for j, z in enumerate(inner):
                time = begin + float(self._points[j]) * length
                equalities.append(slope[:, j] - length * model.rate(z, action, time))
            inequalities += [excess for z in inner for excess in model.current_excess(z, action)]
            effort += ca.dot(action, action) / (sum(self.intervals) * drives)
            state = inner[-1]
            inside = inner if k >= moving else inner[-1:] if k == moving - 1 else []
            inequalities += [
                ca.sumsqr((z[self._axes] / self._radii - goal) / self.band) - 1.0 for z in inside
            ]
        equalities.append(state[n:])
        inequalities += model.static_excess(state, begin + length)
        problem = {
            "x": ca.vertcat(*unknowns),
            "f": duration + EFFORT_WEIGHT_S * effort,
            "g": ca.vertcat(*equalities, *inequalities),
            "p": ca.vertcat(start, goal, parameters),
        }
        self._solver: Any = ca.nlpsol(
            "time_optimal", "ipopt", problem, {"print_time": False, "ipopt": IPOPT_OPTIONS}
        )
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
        """Compute the fastest motion from rest with unstretched belts to the band around the goal.

        Args:
            start: Tool position at the start, m or rad, shape (axes,).
            goal: Tool position of the goal, m or rad, shape (axes,).
            parameters: All parameters in the order of `Machine.parameters`, SI, shape (P,). Default: the
                machine's.
            guesses: Initial guesses of the duration T of the motion, as multiples of the estimated time with
                rigid belts, tried in this order; at least one.

        Returns:
            Duration, s, and commanded voltages, V, shape (intervals, drives), from the first guess with which
            the solver IPOPT converges. If it converges with none, the attribute `solved` is False.
        """
        begin, end = np.asarray(start, float), np.asarray(goal, float)
        nominal = list(self.machine.parameters.values())
        values = np.asarray(nominal if parameters is None else parameters, np.float64)
        # Constants of the nonlinear program: the state at the start (belt travel, speed), the goal and the
        # parameters.
        fixed = np.concatenate([self._rigid @ begin, np.zeros(len(self._rigid)), end, values])
        for factor in guesses:
            guess = self._guess(begin, end, factor * self._rigid_time(end - begin, values))
            result = self._solver(x0=guess, p=fixed, **self._bounds)
            statistics = self._solver.stats()
            if statistics["success"]:
                break
        # The unknowns are T, then for each interval the actions and the states at its collocation points.
        self.solution = solution = np.array(result["x"]).ravel()
        T, by_interval = float(solution[0]), solution[1:].reshape(sum(self.intervals), -1)
        grid = np.array(self._grid(T), float)
        edges = np.append(grid[:, 0], grid[-1].sum())
        volts = self._commands(by_interval[:, : len(self.machine.drives)], values)
        return TimeOptimalMotion(T, statistics["success"], statistics["return_status"], edges, volts)

    def _commands(self, actions: Array, values: Array) -> Array:
        """Return the commands (k, drives), V, that give the motors the voltages of actions (k, drives)."""
        by_name = dict(zip(self.machine.parameters, values.tolist(), strict=True))
        low, high = (np.array(limit, float) for limit in voltage_limits(Equations(self.machine, by_name)))
        motor_voltage = 0.5 * (low + high) + 0.5 * (high - low) * actions
        return InputInversion(self.machine.replace(by_name)).command(motor_voltage)

    def _rigid_time(self, distance: Array, values: Array) -> float:
        """Return the rigid stage's approximate time, s: its slowest axis, to first order in damping."""
        by_name = dict(zip(self.machine.parameters, values.tolist(), strict=True))
        without_effects = dataclasses.replace(self.machine, effects=())
        equations = Equations(without_effects, self.machine.with_tied(by_name))
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
        begin, length = np.array(self._grid(time_s), float).T[..., None]
        s = np.minimum((begin + self._points * length) / time_s, 1.0)[..., None]
        travel = self._rigid @ start + (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * (
            self._rigid @ (goal - start)
        )
        speed = 30.0 * s**2 * (1.0 - s) ** 2 / time_s * (self._rigid @ (goal - start))
        states = np.concatenate([travel, speed], axis=2).reshape(len(begin), -1)
        actions = np.zeros((len(begin), len(self.machine.drives)))
        return np.concatenate([[time_s], np.concatenate([actions, states], axis=1).ravel()])
