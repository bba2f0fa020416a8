"""Tasks: `reach` a point, `track` a moving one, or a user's own (the protocol `Task`)."""

from __future__ import annotations

from typing import Literal, TypeAlias

from .base import Task, check_point
from .reach import Reach
from .track import Track

TaskLike: TypeAlias = Literal["reach", "track"] | Task
TASKS: dict[str, type[Reach | Track]] = {"reach": Reach, "track": Track}


def as_task(task: TaskLike) -> Task:
    """The task by its name with its defaults, or the task itself.

    Raises ValueError for an unknown name.
    """
    if not isinstance(task, str):
        return task
    if task not in TASKS:
        raise ValueError(f"task is {task!r}, choose one of {', '.join(TASKS)} or a Task")
    return TASKS[task]()


__all__ = [
    "TASKS",
    "Literal",
    "Reach",
    "Task",
    "TaskLike",
    "Track",
    "TypeAlias",
    "as_task",
    "check_point",
]
