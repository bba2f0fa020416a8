"""What every controller of a comparison faces."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from ..envs.domain_randomization import RandomizationLike
from ..envs.environment_batch import MachineLike
from ..envs.sensors import SensorsLike
from ..envs.tasks import Task, TaskLike, Track, as_task


@dataclass(frozen=True)
class Scenario:
    """Episodes to be judged on; episode b is the environment's of seed + b, whoever controls it.

    machine: the stage as declared, around which `randomize` draws.  task: "reach", "track" or a `Task`.  sensors: what
    controllers see, "state", "rig" or `Sensors`; all are judged by where the tool is.
    period: of control, s.  duration_s: of an episode; 1.5 s is twice the longest move.
    """

    machine: MachineLike = "hframe"
    task: TaskLike = "reach"
    randomize: RandomizationLike = "default"
    sensors: SensorsLike = "state"
    episodes: int = 512
    seed: int = 0
    period: float = 0.01
    duration_s: float = 1.5

    @property
    def periods(self) -> int:
        """Control periods in an episode.

        Raises ValueError for an episode that is shorter than one.
        """
        count = round(self.duration_s / self.period)
        if count < 1:
            raise ValueError(
                f"duration_s is {self.duration_s!r}, it must hold at least one control period of {self.period:g} s"
            )
        return count

    @property
    def own_task(self) -> Task:
        """The task as its controller is to see it: future goals a control period apart, as far ahead as its own."""
        task = as_task(self.task)
        if not isinstance(task, Track):
            return task
        return dataclasses.replace(
            task, preview_s=self.period, previews=max(1, round(task.previews * task.preview_s / self.period))
        )
