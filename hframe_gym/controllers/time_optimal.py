"""The least time in which any controller could bring a stage's tool into a band around its goal and keep it there.

Direct collocation (Radau, von Stryk 1993; Biegler 2010): a motion of free length T from rest into the band, then
`HOLD_S` in which the tool does not leave it and at whose end all stands still, on belts that friction and motors hold;
|voltage| <= rated, held over each interval; T is least.  So T ends when the tool enters the band for good, mostly at
speed, just as a settling time does; it does not wait for the standstill.  IPOPT finds a local minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..machine import Machine, rest_state

try:
    import casadi as ca

    from .casadi_model import equations
except ImportError as error:
    raise ImportError("time-optimal control needs CasADi: pip install 'hframe_gym[bound]'") from error

Array = NDArray[np.float64]
HOLD_S = 0.04  # s, in which the tool comes to rest within the band; twice as long changes T by less than 1 us
DEGREE = 2  # Radau points an interval: error of third order, and L-stable, which sharp friction asks for
TURNING = 0.01  # m/s, of friction's turning over; moves reach 0.5 to 1 m/s
EFFORT = 1e-6  # s, of mean squared voltage share: picks one of several motions of nearly equal T
LONGEST_S, LONGEST_M, FASTEST = 5.0, 5.0, 10.0  # s, m, m/s: within which motions are looked for
# By default IPOPT begins so far inside the voltage limits that T first grows fourfold; the last barrier, 1e-7 s a
# limit, leaves T 0.05 ms above its least at most.
IPOPT = {"mu_init": 1e-3, "mu_target": 1e-7, "tol": 1e-6, "max_iter": 600, "print_level": 0, "sb": "yes"}
GUESSES = (1.0, 1.6, 0.8)  # of the rigid stage's time, to begin with, in turn until one is solved


@dataclass(frozen=True)
class TimeOptimalMotion:
    """The fastest motion that was found.

    time_s: T, s.  solved: whether IPOPT converged; if not, T means nothing.  status: what it said.  edges_s (k + 1,),
    s, and volts (k, drives): voltages held from edge to edge, the hold in the band included.
    """

    time_s: float
    solved: bool
    status: str
    edges_s: Array
    volts: Array


class TimeOptimalReach:
    """Time-optimal motions of machines of one shape; the problem is set up once and its numbers are parameters.

    band: m, around the goal.  intervals: of the motion and of the hold.

    Raises ValueError for a machine with effects, ImportError naming the extra where CasADi is not installed.
    """

    def __init__(
        self, machine: Machine, *, band: float = 2e-4, intervals: tuple[int, int] = (60, 20), turning: float = TURNING
    ) -> None:
        self.machine = machine
        self.band, self.intervals, self.turning = band, intervals, turning
        self._axes = [i for i, c in enumerate(machine.coordinates) if c.kind == "linear"]
        columns = [rest_state(machine, row)[: len(machine.coordinates)] for row in np.eye(len(self._axes))]
        self._rigid = np.stack(columns, axis=1) * machine.radii[:, None]  # travel per metre of each axis
        self._points = np.array(ca.collocation_points(DEGREE, "radau"))
        self._build()

    def _build(self) -> None:
        n, drives = len(self.machine.coordinates), len(self.machine.drives)
        motion = equations(self.machine)
        slopes = ca.collocation_coeff(self._points.tolist())[0]
        moving, holding = self.intervals
        time: Any = ca.SX.sym("T")
        begin, goal = ca.SX.sym("begin", 2 * n), ca.SX.sym("goal", len(self._axes))
        parameters = ca.SX.sym("parameters", len(self.machine.parameters))
        unknowns, limits = [time], [(1e-4, LONGEST_S)]
        inner_limits = [(-LONGEST_M, LONGEST_M)] * n + [(-FASTEST, FASTEST)] * n
        zeros, negatives = [], []  # what must be zero, and what must not be positive
        effort, state = ca.SX(0.0), begin
        for k in range(moving + holding):
            length = time / moving if k < moving else HOLD_S / holding
            share = ca.SX.sym(f"u{k}", drives)
            inner = [ca.SX.sym(f"z{k}_{j}", 2 * n) for j in range(DEGREE)]
            unknowns += [share, *inner]
            limits += [(-1.0, 1.0)] * drives + inner_limits * DEGREE
            slope = ca.horzcat(state, *inner) @ slopes
            zeros += [
                slope[:, j] - length * motion.rate(z, share, parameters, self.turning) for j, z in enumerate(inner)
            ]
            effort += ca.dot(share, share) / ((moving + holding) * drives)
            state = inner[-1]
            inside = inner if k >= moving else inner[-1:] if k == moving - 1 else []
            negatives += [ca.sumsqr((z[self._axes] - goal) / self.band) - 1.0 for z in inside]
        zeros.append(state[n:])
        negatives += self._holdable(motion.pull(state, parameters), parameters)
        problem = {
            "x": ca.vertcat(*unknowns),
            "f": time + EFFORT * effort,
            "g": ca.vertcat(*zeros, *negatives),
            "p": ca.vertcat(begin, goal, parameters),
        }
        options: Any = {"print_time": False, "ipopt": IPOPT}
        self._solver: Any = ca.nlpsol("fastest", "ipopt", problem, options)
        low, high = np.array(limits).T
        least = np.repeat([0.0, -np.inf], [ca.vertcat(*zeros).numel(), len(negatives)])
        self._bounds = {"lbx": low, "ubx": high, "lbg": least, "ubg": np.zeros(len(least))}

    def _holdable(self, pull: Any, parameters: Any) -> list[Any]:
        """Not positive where friction holds each axis against the pull of the belts; what is driven is held anyway."""
        driven = {d.coordinate for d in self.machine.drives}
        names = list(self.machine.parameters)
        rules = []
        for i in self._axes:
            name = self.machine.coordinate_names[i]
            if name not in driven:
                friction = parameters[names.index(f"{name}.coulomb")]
                rules += [pull[i] - friction, -pull[i] - friction]
        return rules

    def solve(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        parameters: ArrayLike | None = None,
        guesses: Sequence[float] = GUESSES,
    ) -> TimeOptimalMotion:
        """The fastest motion from rest with unstretched belts at start into the band around goal, each (axes,), m.

        parameters (P,): of the stage, in the order of `Machine.parameters` (default: the machine's own).  guesses: of
        T, as shares of about what the rigid stage takes; the first that is solved.
        """
        begin, end = np.asarray(start, float), np.asarray(goal, float)
        own = list(self.machine.parameters.values()) if parameters is None else parameters
        values = np.asarray(own, np.float64)
        given = np.concatenate([self._rigid @ begin, np.zeros(len(self._rigid)), end, values])
        for factor in guesses:
            guess = self._guess(begin, end, factor * self._rigid_time(end - begin, values))
            answer = self._solver(x0=guess, p=given, **self._bounds)
            said = self._solver.stats()
            if said["success"]:
                break
        found = np.array(answer["x"]).ravel()
        T, rest = float(found[0]), found[1:].reshape(sum(self.intervals), -1)
        moving, holding = self.intervals
        edges = np.concatenate([np.linspace(0.0, T, moving + 1), T + np.linspace(0.0, HOLD_S, holding + 1)[1:]])
        rated = np.array([d.rated_voltage for d in self.machine.drives])
        return TimeOptimalMotion(T, said["success"], said["return_status"], edges, rest[:, : len(rated)] * rated)

    def _rigid_time(self, way: Array, values: Array) -> float:
        """About the time of the rigid stage: as long as the slower axis takes, to first order in its damping, s."""
        machine = self.machine.replace(dict(zip(self.machine.parameters, values.tolist(), strict=True)))
        names, radii = machine.coordinate_names, machine.radii
        mass = np.array([c.mass for c in machine.coordinates]) / radii**2
        viscous = np.array([c.viscous for c in machine.coordinates]) / radii**2
        force = np.zeros(len(self._axes))
        for d in machine.drives:
            i = names.index(d.coordinate)
            viscous[i] += d.back_emf / radii[i] ** 2
            force += np.abs(self._rigid[i]) * d.gain / radii[i] * d.rated_voltage
        mass, viscous = mass @ self._rigid**2, viscous @ self._rigid**2
        return float(np.max(2.0 * np.sqrt(np.abs(way) * mass / force) + np.abs(way) * viscous / force)) + 1e-3

    def _guess(self, start: Array, goal: Array, time_s: float) -> Array:
        """A smooth motion of the rigid stage, quintic in time, without voltage."""
        moving, holding = self.intervals
        s = np.minimum((np.arange(moving + holding)[:, None] + self._points) / moving, 1.0)[..., None]
        travel = self._rigid @ start + (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * (self._rigid @ (goal - start))
        speed = 30.0 * s**2 * (1.0 - s) ** 2 / time_s * (self._rigid @ (goal - start))
        states = np.concatenate([travel, speed], axis=2).reshape(moving + holding, -1)
        voltage = np.zeros((moving + holding, len(self.machine.drives)))
        return np.concatenate([[time_s], np.concatenate([voltage, states], axis=1).ravel()])
