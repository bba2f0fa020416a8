"""A known dead time of the drives: what is under way, and the state when a new voltage takes hold."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from ..dynamics import rollout
from ..machine import Machine

Array = NDArray[np.float64]


class DeadTime:
    """The voltages under way to B stages of a machine whose effects make its drives late.

    period: of control, s.  Attributes: seconds, of the drive that is latest; prompt, the machine without it.
    """

    def __init__(self, machine: Machine, period: float) -> None:
        late = [e for e in machine.effects if e.definition.delay is not None]
        by_drive = [sum(float(e("delay")) for e in late if e.site in (d.name, "drives")) for d in machine.drives]
        self.seconds = max(by_drive, default=0.0)
        self.period = period
        self.prompt = dataclasses.replace(machine, effects=tuple(e for e in machine.effects if e not in late))
        self._whole = int(self.seconds / period + 1e-9)
        self._part = max(self.seconds - self._whole * period, 0.0)
        self._sent = np.zeros((0, 0, 0))  # V, (B, periods, drives), the last first

    def begin(self, fresh: NDArray[np.bool_]) -> None:
        """Nothing is under way to stages of fresh (B,)."""
        if len(self._sent) != len(fresh):
            self._sent = np.zeros((len(fresh), self._whole + 2, len(self.prompt.drives)))
        self._sent[fresh] = 0.0

    def send(self, volts: Array) -> None:
        """Voltages (B, drives) given for the period that begins."""
        self._sent = np.concatenate([volts[:, None], self._sent[:, :-1]], axis=1)

    def correct(self, volts: Array) -> None:
        """Voltages (B, drives) that were given in place of those sent last."""
        self._sent[:, 0] = volts

    def arrived(self) -> Array:
        """Mean voltage (B, drives) at the motors over the last period."""
        share = self._part / self.period
        return (1.0 - share) * self._sent[:, self._whole] + share * self._sent[:, self._whole + 1]

    def course(self) -> tuple[Array, Array]:
        """Times (k,), s, of the last period, from 0 to its end, and the voltages (B, k, drives) at the motors from each
        on."""
        volts = self._sent[:, [self._whole + 1, self._whole, self._whole]]
        times = np.array([0.0, self._part, self.period])
        return (times, volts) if self._part > 0.0 else (times[1:], volts[:, 1:])

    @property
    def last(self) -> Array:
        """Voltages (B, drives) given for the period that ends."""
        return self._sent[:, 0]

    def skip(self, goals: Array) -> Array:
        """Goals (B, P, 2), a period apart, by the dead time later, as far as they go.

        Raises ValueError where none is left to move to.
        """
        if self.seconds == 0.0:
            return goals
        steps = self.seconds / self.period
        later = np.arange(steps, goals.shape[1] - 1 + 1e-9)
        if len(later) < 2:
            raise ValueError(f"the preview of {goals.shape[1] - 1} goals ends within the dead time, {self.seconds:g} s")
        shown = np.arange(goals.shape[1], dtype=np.float64)
        return np.asarray(PchipInterpolator(shown, goals, axis=1)(np.minimum(later, shown[-1])))

    def ahead(self, state: Array) -> Array:
        """Where the model's friction and what is under way bring states (B, 2 n), m and m/s of travel, meanwhile."""
        if self.seconds == 0.0:
            return state
        # For the part of a period the voltages still arrive that were given before those of the last whole ones.
        times = np.concatenate([[0.0], self._part + self.period * np.arange(self._whole + 1)])
        volts = self._sent[:, [*range(self._whole, -1, -1), 0]]
        if self._part == 0.0:
            times, volts = times[1:], volts[:, 1:]
        scale = np.tile(self.prompt.radii, 2)
        end = rollout(self.prompt, times, volts, start=state / scale, velocities=True)[:, -1]
        return np.asarray(end * scale)
