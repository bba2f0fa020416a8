"""The full state from a rig's sensors: a Kalman filter around the machine's own kernel that learns the stage.

State: travel and speed of all coordinates (z), and the logarithms of how far the stage's masses, frictions, belts and
motors are off the declared ones (unknowns.py).  A belt mode swings through a good part of its turn between readings:
where belts are softer than declared, speeds cannot be told unless that is learnt.

    predict    by the machine's kernel under the held voltages, asked at points all over what z and the stage may be
               (divided_differences.py), so that what sticks at some and slips at others is in the covariance
    correct    by the readings that say something: a laser at an end of its range does not, and then the encoders and
               the belts' stretch under the friction that was learnt place the tool
    doubt      readings farther off than the covariance has them widen it (fading memory, Fagin 1964): a machine file
               is never complete
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dynamics import rollout
from ..machine import Machine
from .augmented_parameters import AugmentedParameters
from .base import Controller
from .dd2_filter import moments, points
from .dead_time import DeadTime
from .motion_model import MotionModel

Array = NDArray[np.float64]
START = 1e-4  # m, by which the belts may be stretched at the start of an episode
# What acts on the stage beside all that: a force on each coordinate, new every period, as a share of its Coulomb level
# (of a tenth of the largest, where it is less); and m/s a square root second, for a stage without friction.
FORCE, PUSH = 0.1, 1e-2
FORGET = 8.0  # s, in which what was learnt of a number fades: motors warm up, and friction changes along the way
SURPRISE = 4.0  # times its expected square: an error of the readings above which the covariance is doubted
DOUBT = 1e4  # most by which variances are widened in a period
WIDEST = (0.1, 1.0)  # m, m/s: standard deviations beyond which nothing is widened; of a number, those at first
FINEST = (1e-8, 1e-6, 1e-5)  # m, m/s, logarithm: least distances of the points, over which doubles still tell a slope
SHARPEST = 1e-7  # m: no reading is better, whatever its channel says
STEP = 0.5e-3  # s, longest of the kernel's, as in the environment: short against the belts' modes


@dataclass(frozen=True)
class Channel:
    """A position that is read.  noise: standard deviation, quantum's share included; low, high: a reading there or
    beyond says nothing.  In the coordinate's own unit."""

    coordinate: str
    noise: float
    low: float = -np.inf
    high: float = np.inf


class StateEstimator:
    """Estimates of B stages of one machine from readings of channels.

    period: of control, s.  Attributes: channels, how many; unknowns, what is learnt, in the order of `factors`.

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
        self.unknowns = AugmentedParameters(self._late.prompt)
        self._scale = np.tile(machine.radii, 2)
        self._rows = np.array([names.index(c.coordinate) for c in channels])
        self._low = np.array([c.low for c in channels]) * machine.radii[self._rows]
        self._high = np.array([c.high for c in channels]) * machine.radii[self._rows]
        self._noise = (np.array([c.noise for c in channels]) * machine.radii[self._rows]) ** 2 + SHARPEST**2
        count = len(self.unknowns.names)
        self._least = np.repeat(FINEST, [n, n, count])
        self._P0 = np.zeros((2 * n + count, 2 * n + count))
        self._P0[:n, :n] = START**2 * np.eye(n)
        self._P0[2 * n :, 2 * n :] = self.unknowns.covariance
        self._widest = np.concatenate([np.repeat(WIDEST, n) ** 2, np.diag(self.unknowns.covariance)])
        gained = FORCE * np.maximum(model.coulomb, 0.1 * model.coulomb.max()) / model.mass * period  # m/s in a period
        self._keep = np.exp(-period / FORGET)
        self._Q = (1.0 - self._keep**2) * self._P0
        moved = np.concatenate([0.5 * period * gained, np.hypot(gained, PUSH * np.sqrt(period))])
        self._Q[: 2 * n, : 2 * n] = np.diag(moved**2)
        self._fresh = np.zeros(0, np.bool_)
        self._x, self._P = np.zeros((0, len(self._P0))), np.zeros((0, *self._P0.shape))

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the stages of mask (B,), or all: their next readings begin an episode, at rest."""
        if mask is None:
            self._fresh = np.zeros(0, np.bool_)
        elif len(self._fresh):
            self._fresh = self._fresh | mask

    def update(self, readings: Array) -> Array:
        """Estimates (B, 2 n), travel and speed, m and m/s, at the time of readings (B, channels), in own units.

        Raises ValueError for a reading that is not finite.
        """
        y = np.asarray(readings, np.float64) * self.model.machine.radii[self._rows]
        if not np.all(np.isfinite(y)):
            row, column = map(int, np.argwhere(~np.isfinite(y))[0])
            raise ValueError(f"readings: channel {column} of stage {row} is {y[row, column]}")
        width = len(self._scale)
        if len(self._fresh) != len(y):
            self._fresh = np.ones(len(y), np.bool_)
            self._x, self._P = np.zeros((len(y), len(self._P0))), np.tile(self._P0, (len(y), 1, 1))
        self._late.begin(self._fresh)
        says = (y > self._low) & (y < self._high)
        self._predict()
        if self._fresh.any():
            self._x[self._fresh] = 0.0
            self._x[self._fresh, :width] = self._at_rest(y, says)[self._fresh]
            self._P[self._fresh] = self._P0
            self._fresh = np.zeros(len(y), np.bool_)
        self._correct(y, says)
        return self._x[:, :width].copy()

    @property
    def factors(self) -> Array:
        """Estimates (B, k) of `unknowns.names` over the declared numbers."""
        return self.unknowns.factors(self._x[:, len(self._scale) :])

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
        asked = points(self._x, self._P, self._least)
        batch, each, _ = asked.shape
        width = len(self._scale)
        flat = asked.reshape(batch * each, -1)
        times, volts = self._late.course()
        way = rollout(
            self._late.prompt,
            times,
            np.repeat(volts, each, axis=0),
            parameters=self.unknowns.parameters(flat[:, width:]),
            start=flat[:, :width] / self._scale,
            velocities=True,
            longest_step=STEP,
        )
        asked[:, :, :width] = (way[:, -1] * self._scale).reshape(batch, each, width)
        asked[:, :, width:] *= self._keep
        self._x, P = moments(asked)
        self._P = P + self._Q

    def _correct(self, y: Array, says: NDArray[np.bool_]) -> None:
        error = np.where(says, y - self._x[:, self._rows], 0.0)
        PH, S = self._spread(says)
        size = np.einsum("bi,bi->b", error, np.linalg.solve(S, error[..., None])[..., 0])
        self._doubt(size / np.maximum(says.sum(axis=1), 1))
        PH, S = self._spread(says)
        K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        self._x = self._x + np.einsum("bij,bj->bi", K, error)
        width = len(self._scale)
        self._x[:, width:] = self.unknowns.within(self._x[:, width:])
        # Joseph's form: what is left after a correction by exact readings stays positive.
        left = np.tile(np.eye(K.shape[1]), (len(K), 1, 1))
        left[:, :, self._rows] -= K * says[:, None, :]
        self._P = left @ self._P @ left.transpose(0, 2, 1) + (K * self._noise) @ K.transpose(0, 2, 1)

    def _spread(self, says: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Covariance of state and readings (B, N, channels), and of the readings (B, channels, channels)."""
        # A reading that says nothing has no gain: its covariance with the state is taken as zero.
        PH = self._P[:, :, self._rows] * says[:, None, :]
        return PH, PH[:, self._rows] * says[:, :, None] + np.diag(self._noise)

    def _doubt(self, surprise: Array) -> None:
        """Widen the covariance where the readings' squared error is surprise (B,) times the expected one."""
        wider = np.clip(surprise / SURPRISE, 1.0, DOUBT)[:, None]
        now = np.diagonal(self._P, axis1=1, axis2=2)
        wider = np.minimum(wider, np.maximum(self._widest / np.maximum(now, self._least**2), 1.0))
        share = np.sqrt(wider)
        self._P = share[:, :, None] * self._P * share[:, None, :]


class OutputFeedbackController:
    """A full-state controller behind an observer: `observation` then begins with the readings of its channels."""

    def __init__(self, controller: Controller, observer: StateEstimator) -> None:
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
