"""Where the environments of a batch should be: the goals of their episodes' plans, now and ahead."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .observations import Observation
from .tasks import Task

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class ReferenceTrajectories:
    """Plans of `count` episodes of a task, each step a period (s).

    elapsed (count,): periods since each episode began.
    """

    def __init__(self, task: Task, count: int, period: float) -> None:
        self._task, self._period = task, period
        self.elapsed = np.zeros(count, np.int64)
        self.moving = bool(task.ahead_s)
        self._plans = np.zeros((count, task.plan_size))
        self._still = np.zeros((count, 2), np.float32)  # goals at reset, all there is to a task whose goals stay
        self._times = np.array([0.0, *task.ahead_s])

    def begin(self, index: Index, plans: Array) -> None:
        """Episodes of environments index (k,) begin with plans (k, plan_size)."""
        self._plans[index] = plans
        self.elapsed[index] = 0
        self._still[index] = self._task.goal(plans, np.zeros(len(index)))

    def now(self, index: Index | slice) -> NDArray[np.float32]:
        """Where environments index (k,) should be now, (k, 2) m, fresh."""
        if not self.moving:
            return np.array(self._still[index])
        return self._task.goal(self._plans[index], self._elapsed_s(index)).astype(np.float32)

    def blank(self) -> Observation:
        """Fresh arrays for the goals of all environments; those of goals that stay are filled in already."""
        if not self.moving:
            return {"desired_goal": self._still.copy()}
        count, size = len(self._still), 2 * len(self._task.ahead_s)
        return {"desired_goal": np.empty((count, 2), np.float32), "preview": np.empty((count, size), np.float32)}

    def show(self, index: Index | slice, observation: Observation) -> None:
        """Write goals and previews, if there are any, into rows index (k,) of an observation.

        A preview is (2 P,) m: x and y of the nearest future goal, of the next, ...
        """
        if not self.moving:
            observation["desired_goal"][index] = self._still[index]
            return
        times = self._elapsed_s(index)[:, None] + self._times
        goals = self._task.goal(self._plans[index], times).reshape(len(times), -1)
        observation["desired_goal"][index] = goals[:, :2]
        observation["preview"][index] = goals[:, 2:]

    def path(self, b: int, elapsed_s: Array) -> NDArray[np.float32]:
        """Where environment b should be elapsed_s (n,) after its reset, (n, 2) m; nothing for a goal that stays."""
        if not self.moving:
            return np.zeros((0, 2), np.float32)
        return self._task.goal(self._plans[b : b + 1], elapsed_s[None])[0].astype(np.float32)

    def contour(self, index: Index | slice, tools: Array) -> Array | None:
        """Distance (k,) of the tools (k, 2) themselves to their paths, m; None for a task without a path."""
        if not self.moving:
            return None
        return self._task.contour(self._plans[index], tools, self._elapsed_s(index))

    def _elapsed_s(self, index: Index | slice) -> Array:
        return np.asarray(self.elapsed[index].astype(np.float64) * self._period)
