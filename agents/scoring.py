"""Scores of an agent on fixed episodes: one row of its learning curve, and which row is the best."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..controllers import Controller
from ..envs import as_task
from ..evaluation import BANDS, Episodes, Scenario, rollout, settling_times

Array = NDArray[np.float64]

# Seconds of settling time that one millimeter of final error counts. Agents that settle in no band differ only by their
# final error; for agents that settle, 0.01 mm counts as little as 0.1 ms, far below the noise of 256 episodes.
SECONDS_PER_MM = 0.01


def score_agent(controller: Controller, scenario: Scenario) -> dict[str, float]:
    """Simulate a controller in the episodes of a scenario and compute the scores of a learning curve.

    Args:
        controller: Controller to score.
        scenario: Machine, task and episodes in which the controller runs.

    Returns:
        For a task with a fixed goal: `success`, the fraction of episodes that settle in the task's band; for each band
        `success_BAND` and `settling_s_BAND`, the mean settling time, s, where a failed episode counts its full length;
        `final_error_mm`, the median distance at the end, mm. For a task with a moving goal, means over the episodes:
        `contour_rms_mm`, `tracking_rms_mm` and `tracking_max_mm`.
    """
    episodes = rollout(controller, scenario)
    error = episodes.goal_error  # (episodes, samples)
    if episodes.contour is not None:
        return _tracking_scores(error, episodes.contour)
    return _reaching_scores(error, episodes, as_task(scenario.task).band)


def _reaching_scores(error: Array, episodes: Episodes, task_band: float) -> dict[str, float]:
    """Return the scores of a task with a fixed goal from the distance to it, m, shape (episodes, samples)."""
    row = {"success": float(settling_times(error, episodes.time_s, task_band)[1].mean())}
    for name, band in BANDS.items():
        times, success = settling_times(error, episodes.time_s, band)
        row |= {f"success_{name}": float(success.mean()), f"settling_s_{name}": float(times.mean())}
    return {**row, "final_error_mm": float(1e3 * np.median(error[:, -1]))}


def _tracking_scores(error: Array, contour: Array) -> dict[str, float]:
    """Return the scores of a task with a moving goal from tracking and contour errors, m, (episodes, samples)."""
    return {
        "contour_rms_mm": float(1e3 * np.sqrt(np.mean(contour**2, axis=1)).mean()),
        "tracking_rms_mm": float(1e3 * np.sqrt(np.mean(error**2, axis=1)).mean()),
        "tracking_max_mm": float(1e3 * error.max(axis=1).mean()),
    }


def ranking_cost(row: Mapping[str, Any]) -> float:
    """Compute the cost by which rows of a learning curve are ranked; the lowest cost is the best.

    With a fixed goal it is the sum of the mean settling times within 0.2 mm and within 1 mm and of the final error, at
    `SECONDS_PER_MM`. One settling time alone would let a single lucky episode out of 256 decide early in training,
    when almost none settles. Along a path it is the sum of contour and tracking error: a tool that never leaves its
    start has no contour error.

    Args:
        row: Scores as `score_agent` returns them.

    Returns:
        Cost: s for a fixed goal, mm for a moving goal.
    """
    if "contour_rms_mm" in row:
        return float(row["contour_rms_mm"] + row["tracking_rms_mm"])
    settling_s = row["settling_s_0.2mm"] + row["settling_s_1mm"]
    return float(settling_s + SECONDS_PER_MM * row["final_error_mm"])


def progress_line(row: Mapping[str, Any]) -> str:
    """Format one row of a learning curve as a line for the terminal.

    Args:
        row: Scores as `score_agent` returns them, with `steps` (environment steps) and `seconds` (elapsed time).

    Returns:
        One line of text without a line break.
    """
    prefix = f"{row['steps']:>9d} steps  {row['seconds']:6.0f} s"
    if "contour_rms_mm" in row:
        return f"{prefix}  contour {row['contour_rms_mm']:.3f} mm rms  tracking {row['tracking_rms_mm']:.3f} mm rms"
    fractions = ", ".join(f"{100 * row[f'success_{band}']:.1f} % within {band}" for band in BANDS)
    return f"{prefix}  {fractions}; settles to 0.2mm in {row['settling_s_0.2mm']:.3f} s"
