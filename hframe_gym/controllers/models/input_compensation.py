"""Compensation of the drives: their dead time, and their static nonlinearities (dead band, offset, gain)."""

from __future__ import annotations

import dataclasses
import importlib

import numpy as np

from ...arrays import Array, Mask, TravelStates, Volts
from ...dynamics import Equations, rollout
from ...errors import InputError
from ...machine import Machine

TABLE_POINTS = 8001  # points of a drive's characteristic between the rated voltages; 3 mV apart at 12 V
# Slope added to a characteristic so that it can be inverted where it is flat; 0 V then maps to the middle of
# a dead band.
MINIMUM_SLOPE = 1e-9


class DeadTime:
    """Delay line of the commanded voltages, and prediction of the state over the dead time.

    Attributes:
        delay_s: Dead time of the slowest drive, s.
        remainder_s: Dead time beyond complete periods, s.
        machine_without_delay: Copy of the machine without the effects that cause a dead time.
    """

    def __init__(self, machine: Machine, period: float) -> None:
        self.delay_s = max((float(delay) for delay in Equations(machine).voltage_delays()), default=0.0)
        self.period = period
        self.machine_without_delay = dataclasses.replace(
            machine, effects=tuple(e for e in machine.effects if e.definition.delay is None)
        )
        self._complete_periods = int(self.delay_s / period + 1e-9)
        self.remainder_s = max(self.delay_s - self._complete_periods * period, 0.0)
        if self.delay_s > 0.0:
            # For `delayed_goals`: the import takes a tenth of a second, which the first control period does
            # not have.
            importlib.import_module("scipy.interpolate")
        self._sent = np.zeros((0, 0, 0))  # V, (B, periods, drives), latest first

    def reset(self, mask: Mask) -> None:
        """Set the delay lines of machines that start an episode to 0 V; all if their number has changed."""
        if len(self._sent) != len(mask):
            self._sent = np.zeros(
                (len(mask), self._complete_periods + 2, len(self.machine_without_delay.drives))
            )
        self._sent[mask] = 0.0

    def send(self, volts: Volts) -> None:
        """Put the voltages of the period that starts now into the delay line, and drop the oldest ones."""
        self._sent = np.concatenate([volts[:, None], self._sent[:, :-1]], axis=1)

    def replace_last(self, volts: Volts) -> None:
        """Replace the voltages that `send` stored last with the voltages that were actually applied."""
        self._sent[:, 0] = volts

    @property
    def last_sent(self) -> Array:
        """Latest commanded or applied voltages (`send`, `replace_last`), V, shape (B, drives)."""
        return self._sent[:, 0]

    def mean_arrived(self) -> Volts:
        """Return the mean voltages at the drives in the last period, sent a dead time earlier."""
        times, volts = self.arrived_history()
        return np.einsum("k,bkd->bd", np.diff(times) / self.period, volts[:, :-1])

    def arrived_history(self) -> tuple[Array, Array]:
        """Return the voltages over time that reached the drives in the last period, after the dead time.

        Returns:
            times: k times since the start of the period, s, shape (k,): [0, `remainder_s`, `period`] if the
                voltages changed within the period, [0, `period`] if the dead time is a multiple of the
                period.
            volts: Voltages of B simulated machines from each of these times until the next, V, shape (B, k,
                drives); the last entry repeats the one before it.
        """
        # With a delay of k complete periods and a remainder, a period begins with the voltages sent k + 1
        # periods before it; after the remainder, those sent k periods before it arrive.
        k = self._complete_periods
        volts = self._sent[:, [k + 1, k, k]]
        times = np.array([0.0, self.remainder_s, self.period])
        return (times, volts) if self.remainder_s > 0.0 else (times[1:], volts[:, 1:])

    def delayed_goals(self, goals: Array) -> Array:
        """Shift the preview of goals by the dead time, because new voltages act only after it.

        Args:
            goals: Tool goals now and at the ends of the next P - 1 periods, m, shape (B, P, axes).

        Returns:
            Goals at the dead time from now and at the ends of the periods after it within the preview, m,
            interpolated between `goals`, shape (B, at most P, axes).

        Raises:
            InputError: If fewer than two of these times are within the preview.
        """
        if self.delay_s == 0.0:
            return goals
        from scipy.interpolate import PchipInterpolator

        # Times of the shifted goals, in periods from now.
        later = np.arange(self.delay_s / self.period, goals.shape[1] - 1 + 1e-9)
        if len(later) < 2:
            raise InputError(
                f"the preview of {goals.shape[1] - 1} goals ends within the dead time of {self.delay_s:g} s; "
                "increase the task's previews"
            )
        periods = np.arange(goals.shape[1], dtype=np.float64)
        return np.asarray(PchipInterpolator(periods, goals, axis=1)(np.minimum(later, periods[-1])))

    def pending_history(self) -> tuple[Array, Array]:
        """Return the voltages over time that will reach the drives from now to the end of the dead time.

        Returns:
            times: k times from now, s, shape (k,), from 0 to `delay_s`.
            volts: Voltages of B simulated machines from each of these times until the next, V, shape (B, k,
                drives); the last entry repeats the one before it.
        """
        # At first, for the remainder of the delay, the motors still receive the voltages of one period
        # earlier.
        times = np.concatenate(
            [[0.0], self.remainder_s + self.period * np.arange(self._complete_periods + 1)]
        )
        volts = self._sent[:, [*range(self._complete_periods, -1, -1), 0]]
        return (times, volts) if self.remainder_s > 0.0 else (times[1:], volts[:, 1:])

    def predict(self, state: TravelStates) -> TravelStates:
        """Predict the state at the end of the dead time by simulation with the voltages in the delay line."""
        if self.delay_s == 0.0:
            return state
        times, volts = self.pending_history()
        machine, scale = self.machine_without_delay, np.tile(self.machine_without_delay.travel_per_unit, 2)
        end = rollout(machine, times, volts, start=state / scale, velocities=True)[:, -1]
        return np.asarray(end * scale)


class InputInversion:
    """Tables of the drives' static characteristics (dead band, offset, gain) and of their inverses.

    Attributes:
        rated: Rated voltages, V, shape (drives,).

    Raises:
        InputError: If a higher command gives a lower voltage.
    """

    def __init__(self, machine: Machine) -> None:
        self.rated = np.array([d.rated_voltage for d in machine.drives])
        self._tables: dict[int, tuple[Array, Array]] = {}  # by drive: command and motor voltage, V
        equations = Equations(machine)
        commands = [np.linspace(-rated, rated, TABLE_POINTS) for rated in self.rated]
        for j, motor in enumerate(equations.motor_voltages(commands)):
            drive, command = machine.drives[j], commands[j]
            if any(equations.effects_at("voltage", drive.name)):
                if np.any(np.diff(motor) < 0.0):
                    raise InputError(
                        f"machine {machine.name!r}: drive {drive.name} gives "
                        "a lower voltage for a higher command"
                    )
                self._tables[j] = (command, motor + MINIMUM_SLOPE * command)

    def motor_voltage(self, command: Volts) -> Volts:
        """Compute the motor voltages that result from commands, which are limited to the rated voltages."""
        return self._mapped(command, inverse=False)

    def command(self, motor_voltage: Volts) -> Volts:
        """Compute the commands, limited to the rated voltages, that give the required motor voltages."""
        return np.clip(self._mapped(motor_voltage, inverse=True), -self.rated, self.rated)

    def _mapped(self, volts: Array, *, inverse: bool) -> Array:
        """Return motor voltages for commands, or vice versa, (B, drives), V; unchanged without a table."""
        mapped = volts.copy()
        for j, (command, motor) in self._tables.items():
            x, y = (motor, command) if inverse else (command, motor)
            mapped[:, j] = np.interp(volts[:, j], x, y)
        return mapped
