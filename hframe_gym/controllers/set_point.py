"""Controller of drives that follow a set point: it streams a trajectory to them, like a printer's planner.

The loops are in the drives. What is left is where to be when: the reference of each axis of the tool moves
towards the goal with limited acceleration, brakes in time and follows a moving goal. Its speed v after a
period T from the distance e to the goal is that from which constant deceleration a ends at the goal, a T/2
(sqrt(1 + 8 |e|/(a T^2)) - 1).

Drives that hold their set point do not damp the belts behind them. The set points are therefore means of the
reference over one period of each lightly damped mode of the machine with its loops, which excites the mode as
little as a motion that never changed its acceleration.

References:
    Singer and Seering (1990), Preshaping command inputs to reduce system vibration.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from typing_extensions import override

from ..arrays import Actions, Array, KeyedObservation, Mask
from ..dynamics import linearize
from ..errors import InputError
from ..machine import DRIVE_KINDS, Drive, Machine, motion_limits, rest_positions_per_axis
from .base import CONTROLLERS, Controller, EpisodeStarts, Feedback
from .observation_checks import check_goal_units, check_keys

# Part of the drives' largest force that accelerates along one axis. The rest is left for the other axis, for
# friction and for the loops, which lose the set point while their torque is at its limit.
FORCE_FRACTION = 0.5
# Correction of the position by a drive of speeds, 1/s: of the control rate, and of the bandwidth of its speed
# loop.
RATE_FRACTION, BANDWIDTH_FRACTION = 0.2, 0.25
# Damping ratio below which a vibration lasts longer than the mean over its period, and number of modes that
# count.
LIGHT_DAMPING, MOST_MODES = 0.5, 3
LONGEST_CROSSING_S = 10.0  # s; drives that need longer to cross the workspace have too long a control period


@CONTROLLERS.register("set-point")
class SetPointController(Controller):
    """Stream positions or speeds to drives that follow them.

    A commanded position is ahead of the reference by what a proportional loop lags behind it, speed /
    position_gain. A commanded speed contains a correction in proportion to the error of the tool's position.

    Attributes:
        acceleration: Largest acceleration of the reference along each axis, m/s^2 or rad/s^2, shape (axes,).
        speed: Largest speed of the reference along each axis, m/s or rad/s, shape (axes,); infinite without a
            limit.
        weights: Weights of the last references in the set points, the latest first, dimensionless,
            shape (references,).

    Raises:
        InputError: If a drive does not follow a position or a speed, or the machine has no tool or not one
            drive per axis.
    """

    feedback: ClassVar[Feedback] = "observation"
    knowledge: ClassVar[str] = "reach and limits of its drives"
    set_points: ClassVar[bool] = True

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        others = [d.name for d in machine.drives if not d.law or d.command not in ("position", "speed")]
        if others or not machine.drives:
            raise InputError(
                f"machine {machine.name!r}: set-point streams positions or speeds, but {', '.join(others)} "
                "takes another command; use pid, which computes voltages, currents or torques"
            )
        if not machine.tool_axes or len(machine.tool_axes) != len(machine.drives):
            raise InputError(f"machine {machine.name!r}: set-point needs a tool and one drive per axis of it")
        rows = [machine.coordinate_names.index(d.coordinate) for d in machine.drives]
        self._reach: Array = rest_positions_per_axis(machine)[rows]  # of each drive per meter, (drives, axes)
        self._rated: Array = np.array([d.rated_voltage for d in machine.drives])
        limits = motion_limits(machine)
        absent = [axis for axis in machine.tool_axes if axis not in limits or limits[axis].force == 0.0]
        if absent:
            raise InputError(f"machine {machine.name!r}: its drives cannot move {' and '.join(absent)}")
        of_axes = [limits[axis] for axis in machine.tool_axes]
        share = FORCE_FRACTION / len(of_axes)
        self.acceleration: Array = np.array([share * axis.force / axis.inertia for axis in of_axes])
        largest = [self._largest_speed(drive) for drive in machine.drives]
        with np.errstate(divide="ignore"):
            per_axis = np.array(largest)[:, None] / np.abs(self._reach) / len(of_axes)
        self.speed: Array = per_axis.min(axis=0)
        self._follows_speed = np.array([d.command == "speed" for d in machine.drives])
        gains = [d.law_parameters.get("position_gain", np.inf) for d in machine.drives]
        self._lag = np.where(self._follows_speed, 0.0, 1.0 / np.array(gains))  # s
        self._correction = self._correction_rate()
        self.weights: Array = self._mean_over_modes()
        self._delay = int(np.rint(self.weights @ np.arange(len(self.weights))))  # periods
        self._starts = EpisodeStarts()
        self._reference = np.zeros((0, len(self.weights), len(of_axes)))  # m, the latest first
        self._velocity = np.zeros((0, len(self.weights), len(of_axes)))  # m/s

    def _mean_over_modes(self) -> Array:
        """Return the weights of the mean over one period of each of the slowest lightly damped modes."""
        machine = self.machine
        middle = [np.mean(machine.coordinate(axis).range or (0.0, 0.0)) for axis in machine.tool_axes]
        position = rest_positions_per_axis(machine) @ np.array(middle)
        poles = np.linalg.eigvals(linearize(machine, position).A)
        light = poles[(poles.imag > 0.0) & (-poles.real < LIGHT_DAMPING * np.abs(poles))]
        weights = np.ones(1)
        for pole in sorted(light, key=lambda pole: float(pole.imag))[:MOST_MODES]:
            length = 2.0 * np.pi / (float(pole.imag) * self.period)  # periods of control, not an integer
            if length > 1.0:
                mean = np.append(np.ones(int(length)), length - int(length)) / length
                weights = np.convolve(weights, mean)
        return weights

    def _largest_speed(self, drive: Drive) -> float:
        """Return the largest speed of a drive's coordinate, m/s or rad/s, by set points held for a period."""
        jump = DRIVE_KINDS.get(drive.kind).largest_jump(drive.gear_ratio, drive.law_parameters)
        return min(drive.largest_speed, jump / self.period)

    def _correction_rate(self) -> float:
        """Return the speed that corrects a position error, 1/s, below the bandwidth of the slowest drive."""
        limits = motion_limits(self.machine)
        inertia = np.array([limits[axis].inertia for axis in self.machine.tool_axes])
        slowest = float(
            np.min((self._reach**2).T @ np.array([d.damping for d in self.machine.drives]) / inertia)
        )
        return min(RATE_FRACTION / self.period, BANDWIDTH_FRACTION * slowest)

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self._starts.reset(mask)

    @override
    def concern(self) -> str | None:
        """Return a warning if the set points do not suffice for the workspace, else None.

        That is so if the rated positions of a drive do not reach all of it, or if a stepper motor, which
        follows a limited change per period without losing steps, crosses it in more than
        `LONGEST_CROSSING_S`.
        """
        machine = self.machine
        ranges = [machine.coordinate(axis).range or (0.0, 0.0) for axis in machine.tool_axes]
        corners = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, len(ranges))
        farthest = np.abs(corners @ self._reach.T).max(axis=0)
        beyond = ~self._follows_speed & (farthest > self._rated * (1.0 + 1e-9))
        if beyond.any():
            short = [drive.name for drive, far in zip(machine.drives, beyond, strict=True) if far]
            return f"the rated_position of {' and '.join(short)} does not reach all of the workspace"
        jumps = [DRIVE_KINDS.get(d.kind).largest_jump(d.gear_ratio, d.law_parameters) for d in machine.drives]
        widths = np.array([high - low for low, high in ranges])
        if np.isfinite(min(jumps)) and (widths > LONGEST_CROSSING_S * self.speed).any():
            speed = ", ".join(f"{s:.2g}" for s in self.speed)
            return (
                f"set points that are held for {self.period:g} s move the tool at {speed} "
                "m/s at most without losing steps; a shorter control period permits more (--period 0.001)"
            )
        return None

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        """Move a reference to the goal, with limited speed and acceleration, and return its set points.

        They are fractions of the rated ones in [-1, 1]: positions, or speeds that also correct the difference
        between the reference and the observed position.
        """
        check_keys(observation)
        check_goal_units(observation, self.machine)
        position = np.asarray(observation["achieved_goal"], np.float64)
        goals = [np.asarray(observation["desired_goal"], np.float64)]
        if "preview" in observation:
            preview = np.asarray(observation["preview"], np.float64).reshape(
                len(position), -1, position.shape[1]
            )
            goals += list(np.moveaxis(preview, 1, 0))
        if self._starts.resize(len(position)):
            self._reference, self._velocity = np.zeros(
                (2, len(position), len(self.weights), position.shape[1])
            )
        starts = self._starts.mask[:, None, None]
        self._reference = np.where(starts, position[:, None], self._reference)
        self._velocity = np.where(starts, 0.0, self._velocity)
        self._starts.clear()
        error = self._shaped(self._reference) - position
        # The mean is late by its delay: aim at the goal of that time, if it is previewed.
        ahead = min(self._delay, max(len(goals) - 2, 0))
        goal = goals[ahead]
        self._advance(
            goal, (goals[ahead + 1] - goal) / self.period if len(goals) > 1 else np.zeros_like(goal)
        )
        velocity = self._shaped(self._velocity) @ self._reach.T
        set_points = np.where(
            self._follows_speed,
            velocity + self._correction * error @ self._reach.T,
            self._shaped(self._reference) @ self._reach.T + velocity * self._lag,
        )
        return np.clip(set_points / self._rated, -1.0, 1.0)

    def _shaped(self, references: Array) -> Array:
        """Return the weighted mean of the last references, shape (B, axes)."""
        return np.asarray(np.einsum("k,bka->ba", self.weights, references))

    def _advance(self, goal: Array, goal_velocity: Array) -> None:
        """Move the reference a period to a goal, m, that moves with a velocity, m/s, shape (B, axes) each."""
        position, velocity = self._reference[:, 0], self._velocity[:, 0]
        distance, per_period = goal - position, self.acceleration * self.period
        periods = 0.5 * (np.sqrt(1.0 + 8.0 * np.abs(distance) / (per_period * self.period)) - 1.0)
        braking = goal_velocity + np.sign(distance) * per_period * periods
        wanted = np.clip(braking, -self.speed, self.speed)
        moved = velocity + np.clip(wanted - velocity, -per_period, per_period)
        # The last period ends at the goal; it changes the speed by an eighth more than the others at most.
        last = goal_velocity + distance / self.period
        arrives = (periods <= 1.0) & (np.abs(last - velocity) <= 1.125 * per_period)
        velocity = np.where(arrives, last, moved)
        position = position + velocity * self.period
        self._reference = np.concatenate([position[:, None], self._reference[:, :-1]], axis=1)
        self._velocity = np.concatenate([velocity[:, None], self._velocity[:, :-1]], axis=1)
