"""Check a task by a trial: whether its methods return what the environment needs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Workspace
from ...errors import InputError
from .base import Task, check_point

_EPISODES = 16  # for which the methods are called


def check_task(task: Task, workspace: Workspace) -> None:
    """Check that a task fits into a workspace and that its methods return arrays of the right shapes.

    The methods are called for a few trial episodes with fixed random numbers.

    Raises:
        InputError: If the task does not fit into the workspace, or a method returns another shape, a number
            that is not finite, or a start or goal outside the workspace.
    """
    task.check(workspace)
    axes, count, label = len(workspace), _EPISODES, f"task {task.name}"
    uniforms = np.random.default_rng(0).uniform(size=(count, task.draws))
    nominal = {name: np.full(count, value) for name, value in task.parameters.items()}
    episodes = task.begin(workspace, uniforms, nominal)
    if not (isinstance(episodes, tuple) and len(episodes) == 2):
        raise InputError(
            f"{label}: begin must return two arrays, the starts and the plans of {count} episodes"
        )
    start, plan = map(np.asarray, episodes)
    _check_array(f"{label}: begin must return starts", start, (count, axes))
    check_point(f"{label}: starts that begin returns", start, workspace)
    entries = plan.shape[1] if plan.ndim == 2 else task.plan_size
    _check_array(f"{label}: begin must return plans", plan, (count, entries))
    elapsed_s = np.zeros((count, 2))
    goals = np.asarray(task.goal(plan, elapsed_s[:, 0]))
    _check_array(f"{label}: goal must return, for times of shape ({count},), goals", goals, (count, axes))
    check_point(f"{label}: goals", goals, workspace)
    later = np.asarray(task.goal(plan, elapsed_s))
    _check_array(
        f"{label}: goal must return, for times of shape ({count}, 2), goals", later, (count, 2, axes)
    )
    if task.metrics == "track":
        contour = task.contour(plan, start, elapsed_s[:, 0])
        if contour is None:
            raise InputError(
                f"{label} has metrics 'track', so it must implement contour; the default returns None"
            )
        _check_array(f"{label}: contour must return distances", np.asarray(contour), (count,))


def _check_array(label: str, values: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Raise InputError unless an array has a shape and is finite; the message begins with the label."""
    is_number = values.dtype.kind in "fiu"
    if values.shape != shape or not is_number or not np.all(np.isfinite(values)):
        problem = (
            "not finite"
            if is_number and values.shape == shape
            else f"of shape {values.shape} and {values.dtype}"
        )
        raise InputError(f"{label} of shape {shape}, finite numbers; these are {problem}")
