"""The full state from a rig's sensors: a Kalman filter around the machine's own kernel.

State: travel and speed of all coordinates (z), and a force on each that the model does not know (f), for friction and
belts are never quite as declared.

    predict    z by the machine's kernel under the held voltages and f, so a stage that sticks sticks in the estimate;
               the covariance by the belts' linear model, z+ = A z + B u + E f, f fading
    correct    by the readings that say something: a laser at an end of its range does not, and then the encoders,
               the belts' stretch under f, and what is known of f place the tool
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, rollout
from ..machine.linear import stiffness_matrix
from .controller import Controller
from .delay import DeadTime
from .model import MotionModel
from .places import Places

Array = NDArray[np.float64]
FRICTION = 0.5  # share of a coordinate's Coulomb level by which it may be off
BELTS = 0.2  # share of the belts' pull on a coordinate by which it may be off
# s, in which an unknown force is forgotten.  Short: the belts' pull that it mostly makes up for follows the motion, and
# what is kept from a stretch of it that the lasers saw would bend the estimate where they do not.
FADE = 0.005
START = 1e-4  # m, by which the belts may be stretched at the start of an episode
PUSH = 1e-2  # m/s a square root second: what is left to the speeds beside f


@dataclass(frozen=True)
class Channel:
    """A position that is read.  noise: standard deviation, quantum's share included; low, high: a reading there or
    beyond says nothing.  In the coordinate's own unit."""

    coordinate: str
    noise: float
    low: float = -np.inf
    high: float = np.inf


class Observer:
    """Estimates of B stages of one machine from readings of channels.

    period: of control, s.

    Raises ValueError as `MotionModel` does, or for channels of which the motors' or the tool's way does not follow.
    """

    def __init__(self, machine: Machine, period: float, channels: Sequence[Channel]) -> None:
        self.model = model = MotionModel(machine)
        self.period = period
        self._late = DeadTime(machine, period)
        names = machine.coordinate_names
        unknown = [c.coordinate for c in channels if c.coordinate not in names]
        if unknown or len({c.coordinate for c in channels}) < len(model.rated):
            raise ValueError(
                f"machine {machine.name!r}: the channels {', '.join(c.coordinate for c in channels) or 'none'} "
                f"do not tell where its tool is; its coordinates are {', '.join(names)}"
            )
        n = len(names)
        self.channels = len(channels)
        self._scale = np.tile(machine.radii, 2)
        self._rows = np.array([names.index(c.coordinate) for c in channels])
        self._low = np.array([c.low for c in channels]) * machine.radii[self._rows]
        self._high = np.array([c.high for c in channels]) * machine.radii[self._rows]
        self._noise = (np.array([c.noise for c in channels]) * machine.radii[self._rows]) ** 2
        self._places = Places(machine)
        self._keep = np.exp(-period / FADE)
        self._F = np.stack([self._transition(place) for place in self._places.points])
        self._K = np.stack([self._stiffness(place) for place in self._places.points])
        self._friction = FRICTION * np.maximum(model.coulomb, 0.1 * model.coulomb.max())
        self._Q = np.diag(np.concatenate([np.zeros(n), np.full(n, PUSH), np.zeros(n)]) ** 2) * period
        self._P0 = np.diag(np.concatenate([np.full(n, START), np.zeros(n), self._friction]) ** 2)
        self._fresh = np.zeros(0, np.bool_)
        self._z, self._f, self._P = np.zeros((0, 2 * n)), np.zeros((0, n)), np.zeros((0, 3 * n, 3 * n))

    def _transition(self, place: Array) -> Array:
        """F (3 n, 3 n) of z and f over a period."""
        A, _, E = self.model.discretise(place, self.period)
        n = E.shape[1]
        return np.block([[A, E], [np.zeros((n, 2 * n)), self._keep * np.eye(n)]])

    def _stiffness(self, place: Array) -> Array:
        """K (n, n), N per m of travel."""
        radii = self.model.machine.radii
        K = stiffness_matrix(self.model.machine, self.model.rigid @ place / radii)
        return K / radii[:, None] / radii

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the stages of mask (B,), or all: their next readings begin an episode, at rest."""
        if mask is None:
            self._fresh = np.zeros(0, np.bool_)
        elif len(self._fresh):
            self._fresh = self._fresh | mask

    def update(self, readings: Array) -> Array:
        """Estimates (B, 2 n), travel and speed, m and m/s, at the time of readings (B, channels), in own units."""
        y = np.asarray(readings, np.float64) * self.model.machine.radii[self._rows]
        if len(self._fresh) != len(y):
            n = len(self.model.mass)
            self._fresh = np.ones(len(y), np.bool_)
            self._z, self._f = np.zeros((len(y), 2 * n)), np.zeros((len(y), n))
            self._P = np.tile(self._P0, (len(y), 1, 1))
        self._late.begin(self._fresh)
        says = (y > self._low) & (y < self._high)
        self._predict()
        if self._fresh.any():
            self._z[self._fresh] = self._at_rest(y, says)[self._fresh]
            self._f[self._fresh] = 0.0
            self._P[self._fresh] = self._P0
            self._fresh = np.zeros(len(y), np.bool_)
        self._correct(y, says)
        return self._z.copy()

    def sent(self, volts: Array) -> None:
        """Voltages (B, 2), V, that are held from now on."""
        self._late.send(volts)

    def corrected(self, volts: Array) -> None:
        """Voltages (B, 2), V, that are held from now on in place of those sent last."""
        self._late.correct(volts)

    def _at_rest(self, y: Array, says: NDArray[np.bool_]) -> Array:
        """States (B, 2 n) at rest on unstretched belts, by weighted least squares from what is read."""
        rigid = self.model.rigid[self._rows]
        weight = says / self._noise
        normal = np.einsum("ki,bk,kj->bij", rigid, weight, rigid)
        tool = np.linalg.solve(normal, ((weight * y) @ rigid)[..., None])[..., 0]
        return self.model.goal_state(tool)

    def _predict(self) -> None:
        volts = self._late.arrived()
        held = np.repeat(volts[:, None], 2, axis=1)
        force = np.repeat((self._f * self.model.machine.radii)[:, None], 2, axis=1)
        way = rollout(
            self._late.prompt,
            np.array([0.0, self.period]),
            held,
            start=self._z / self._scale,
            extra_force=force,
            velocities=True,
        )
        cells = self._places.nearest(self.model.tool(self._z))
        F, n = self._F[cells], self._f.shape[1]
        pull = np.einsum("bij,bj->bi", self._K[cells], self._z[:, :n])
        self._z = way[:, -1] * self._scale
        self._f = self._keep * self._f
        self._P = F @ self._P @ F.transpose(0, 2, 1) + self._Q
        forces = np.arange(2 * n, 3 * n)
        self._P[:, forces, forces] += (1.0 - self._keep**2) * (self._friction**2 + (BELTS * pull) ** 2)

    def _correct(self, y: Array, says: NDArray[np.bool_]) -> None:
        # A reading that says nothing has no gain: its covariance with the state is taken as zero.
        PH = self._P[:, :, self._rows] * says[:, None, :]
        S = PH[:, self._rows] * says[:, :, None] + np.eye(len(self._rows)) * self._noise
        K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        change = np.einsum("bij,bj->bi", K, np.where(says, y - self._z[:, self._rows], 0.0))
        width = self._z.shape[1]
        self._z = self._z + change[:, :width]
        self._f = self._f + change[:, width:]
        self._P = self._P - K @ PH.transpose(0, 2, 1)
        self._P = 0.5 * (self._P + self._P.transpose(0, 2, 1))


class Observed:
    """A full-state controller behind an observer: `observation` then begins with the readings of its channels."""

    def __init__(self, controller: Controller, observer: Observer) -> None:
        self.controller, self.observer = controller, observer

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the stages of mask (B,), or all."""
        self.controller.reset(mask)
        self.observer.reset(mask)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Actions (B, 2) in [-1, 1] from readings (B, channels or more) in the channels' own units."""
        model = self.observer.model
        state = self.observer.update(observation["observation"][:, : self.observer.channels])
        actions = self.controller.act({**observation, "observation": model.observation(state)})
        self.observer.sent(np.clip(actions, -1.0, 1.0) * model.rated)
        return actions

    def applied(self, actions: Array) -> None:
        """The stages were given actions (B, 2) in [-1, 1], and not what `act` answered last."""
        self.controller.applied(actions)
        self.observer.corrected(actions * self.observer.model.rated)
