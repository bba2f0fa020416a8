"""How good an agent is at a glance: a few numbers on fixed draws, for its curve and the terminal."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..envs.tasks import as_task
from ..evaluation import BANDS, Episodes, Scenario, rollout
from ..evaluation.metrics import settling


def judge(controller: Any, trial: Scenario) -> dict[str, float]:
    """Flat scores of a controller on a trial's episodes.

    For a goal that stands: `success`, the share that is in the task's band at the end and stays there, and for each
    band `success_BAND` and `settling_s_BAND`, the mean, where a failure counts its whole length; `final_error_mm`, the
    median.  For one that moves:
    `contour_rms_mm`, `tracking_rms_mm` and `tracking_max_mm`, means over episodes.
    """
    run = rollout(controller, trial)
    error = np.linalg.norm(run.position - run.goal, axis=2)
    return _reaching(error, run, as_task(trial.task).band) if run.contour is None else _tracking(error, run.contour)


def _reaching(error: Any, run: Episodes, own_band: float) -> dict[str, float]:
    row = {"success": float(settling(error, run.time_s, own_band)[1].mean())}
    for name, band in BANDS.items():
        times, success = settling(error, run.time_s, band)
        row |= {f"success_{name}": float(success.mean()), f"settling_s_{name}": float(times.mean())}
    return {**row, "final_error_mm": float(1e3 * np.median(error[:, -1]))}


def _tracking(error: Any, contour: Any) -> dict[str, float]:
    return {
        "contour_rms_mm": float(1e3 * np.sqrt(np.mean(contour**2, axis=1)).mean()),
        "tracking_rms_mm": float(1e3 * np.sqrt(np.mean(error**2, axis=1)).mean()),
        "tracking_max_mm": float(1e3 * error.max(axis=1).mean()),
    }


def deciding(row: dict[str, Any]) -> float:
    """What makes one row of a curve better than another: less of this.

    Along a path the distance to the goal counts too, for a tool that never leaves is never off the path.
    """
    return float(row.get("settling_s_0.2mm") or row["contour_rms_mm"] + row["tracking_rms_mm"])


def line(row: dict[str, Any]) -> str:
    """A row of a curve as a line for the terminal."""
    begin = f"{row['steps']:>9d} steps  {row['seconds']:6.0f} s"
    if "contour_rms_mm" in row:
        return f"{begin}  contour {row['contour_rms_mm']:.3f} mm rms  tracking {row['tracking_rms_mm']:.3f} mm rms"
    shares = ", ".join(f"{100 * row[f'success_{band}']:.1f} % in {band}" for band in BANDS)
    return f"{begin}  {shares}; {row['settling_s_0.2mm']:.3f} s to 0.2mm"
