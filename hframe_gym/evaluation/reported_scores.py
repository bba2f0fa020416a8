"""Access to the scores in scores.json, for tables, pages and advice."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ..machine import AXIS_UNITS, METERS, AxisUnit

PATH_ERRORS = ("contour", "tracking")  # of motion along a path, in scores with the unit, such as contour_mm


def task_name(scores: Mapping[str, Any]) -> str:
    """Return the name of the task in lower case, such as "track".

    Args:
        scores: Content of scores.json. Its entry "task" may be the text of a task object, such as
            "Track(speed=0.1)", of which this is the name without the arguments.
    """
    return str(scores["task"]).partition("(")[0].lower()


def unit_of_scores(names: Iterable[str]) -> AxisUnit:
    """Determine the unit of the tool position from names that end in a band, such as "2mrad"; else m."""
    endings = tuple(names)
    found = [u for u in AXIS_UNITS.values() if any(name.endswith(u.bound_band) for name in endings)]
    return found[0] if found else METERS


def settling_or_none(success: float, settling: Any) -> Any:
    """Return scores of settling times unchanged, in their unit, or None if no episode settles.

    An episode that does not settle counts with its length. If none settles, the scores contain nothing but
    this length.

    Args:
        success: Fraction of the episodes that settle, 0 to 1.
        settling: Mean settling time, s, or an object with several scores of the settling times.
    """
    return settling if success else None


def settling_in(score: Mapping[str, Any], band: str) -> Mapping[str, Any] | None:
    """Return a controller's scores of settling times within a band, s; None if no episode settles.

    Args:
        score: Scores of a controller, as `score_episodes` returns them for moves to a goal.
        band: Name of the band, such as "0.2mm".

    Returns:
        `mean`, `median`, `p95` and `ci95`, see `reach_metrics`.
    """
    times: Mapping[str, Any] | None = settling_or_none(score["success"][band], score["settling_s"][band])
    return times


def ratio_to_bounds(score: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the ratio of mean settling time to mean shortest possible time, within 0.2 mm, dimensionless.

    Args:
        score: Scores of a controller, as `score_episodes` returns them.

    Returns:
        `mean` and `ci95`, see `ratio_of_means`. None if no shortest time is known, no episode settles, or the
        task has a path.
    """
    band = METERS.bound_band
    by_band = score.get("over_bound") or {}
    if band not in by_band or not score["success"][band]:
        return None
    ratio: Mapping[str, Any] | None = by_band[band].get("ratio_of_means")
    return ratio


def unknown_bound_reasons(scores: Mapping[str, Any]) -> list[str]:
    """List the different reasons, sentences, for which controllers have no time-optimal bounds.

    Args:
        scores: Content of scores.json (`Evaluation.scores`).
    """
    reasons = (score.get("over_bound_reason") for score in scores["controllers"].values())
    return list(dict.fromkeys(reason for reason in reasons if reason))
