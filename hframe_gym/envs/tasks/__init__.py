"""Tasks by name: `reach` a point, `track` a path, or others that register themselves in `TASKS`."""

from ...registry import import_modules
from .base import TASKS, Metrics, Task, TaskLike, as_task, check_point
from .reach import Reach
from .track import Track

__all__ = ["TASKS", "Metrics", "Reach", "Task", "TaskLike", "Track", "as_task", "check_point"]

import_modules(__name__, __path__)  # A new task in this folder registers itself.
