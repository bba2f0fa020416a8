"""Tables of the scores of controllers, of an evaluation or in a protocol."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.markup import escape
from rich.table import Table

from ...machine import METERS, AxisUnit
from ...web_page import number

_SHORT = {"contour": "contour", "tracking": "track"}  # headings of narrow columns
BANDS, BOUND_BAND = tuple(METERS.bands), METERS.bound_band  # of protocols, whose machines have linear axes


def score_table(scores: Mapping[str, Any]) -> Table:
    """Format the scores of controllers as a table.

    Numbers are never truncated; a name that is too long for the terminal continues on the next line.

    Returns:
        Table (rich) with one row per controller. The first columns are the fractions of episodes, %, that end
        within 1, 0.2 and 0.05 mm of the goal. For a fixed goal, the mean settling times to these bands, s,
        follow, and the mean settling time to 0.2 mm divided by the mean of the shortest possible ones
        (time-optimal bound), and the mean distance to the goal at the end, mm; "-" means that the value is
        unknown or nothing settles. For a path, root mean square and largest contour and tracking error, mm,
        follow instead. Rotary axes have bands of 10, 2 and 0.5 mrad, and errors in mrad.
    """
    from ...evaluation import PATH_ERRORS, task_name, unit_of_scores

    title = (
        f"{task_name(scores)}: {scores['episodes']} episodes, {scores['machine']}, "
        f"randomize {scores['randomize']}, sensors {scores['sensors']}, seed {scores['seed']}"
    )
    controllers = scores["controllers"]
    fixed_goal = all("settling_s" in score for score in controllers.values())
    unit = unit_of_scores(next(iter(controllers.values())).get("success", ()))
    bands = [band.replace(unit.small, f"\n{unit.small}") for band in unit.bands]
    columns = [f"in\n{band}\n%" for band in bands]
    if fixed_goal:
        columns += [
            *(f"until\n{band}\ns" for band in bands),
            "over\nthe\nbound",
            f"error\nat end\n{unit.small}",
        ]
    else:
        columns += [
            f"{_SHORT[error]}\nerror\n{kind}\n{unit.small}"
            for error in PATH_ERRORS
            for kind in ("rms", "max")
        ]
    table = Table(
        title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    table.add_column("name", overflow="fold")
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True, min_width=max(map(len, column.split("\n"))))
    for name, score in controllers.items():
        success = (f"{100 * score['success'][band]:.1f}" for band in unit.bands)
        cells = _settling_cells(score, unit) if fixed_goal else _path_cells(score, unit)
        table.add_row(escape(name), *success, *cells)
    return table


def _settling_cells(score: Mapping[str, Any], unit: AxisUnit) -> list[str]:
    """Return the mean settling times, s, their ratio to the mean bound, and the mean error at the end."""
    from ...evaluation import ratio_to_bounds, settling_in

    values = (*(settling_in(score, band) for band in unit.bands), ratio_to_bounds(score))
    left = score[f"final_error_{unit.small}"]["mean"]
    return [*(f"{value['mean']:.3f}" if value else "-" for value in values), number(left)]


def _path_cells(score: Mapping[str, Any], unit: AxisUnit) -> list[str]:
    """Return contour and tracking errors, rms and maximum, means over the episodes, mm or mrad."""
    from ...evaluation import PATH_ERRORS

    keys = [f"{error}_{unit.small}" for error in PATH_ERRORS]
    return [f"{score[key][kind]['mean']:.3f}" for key in keys for kind in ("rms", "max")]


def protocol_tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Format the results of controllers in a protocol, one of the fixed benchmarks of the leaderboard.

    Returns:
        One table (rich) per task of the protocol, with one row per controller. For moves to a goal: the
        fractions of episodes, %, that settle within 1, 0.2 and 0.05 mm, the mean settling time to 0.2 mm, s,
        and its ratio to the mean bound (where bounds are stored), with 95 % intervals, and the median
        distance at the end, mm. For paths: root mean square and largest contour error, mm, with their
        intervals.
    """
    from ...evaluation import get_protocol, protocol_bounds, settling_or_none

    tables = []
    for part, first in results[0]["scores"].items():
        moves = "final_error_mm" in first
        columns = [f"in {band}, %" for band in BANDS] + [f"until {BOUND_BAND}, s"] if moves else list(first)
        protocol = get_protocol(results[0]["protocol"])
        bound = protocol_bounds(protocol.name)["free"] if moves else np.zeros(0)
        known_bounds = int(np.isfinite(bound).sum())
        if known_bounds:
            columns.append(f"over the bound ({known_bounds} draws)")
        if moves:
            columns.append("error at the end, mm")
        table = Table(title=f"{results[0]['protocol']}, {part}", title_justify="left", box=box.SIMPLE_HEAD)
        table.add_column("name", overflow="fold")
        for column in columns:
            table.add_column(column, justify="right")
        for result in results:
            scores = result["scores"][part]
            settling = [scores[f"settling_s.{band}"] for band in BANDS] if moves else []
            means = [scores[f"settling_s.{BOUND_BAND}"]] if moves else scores.values()
            cells = [f"{100 * score['success']:.1f}" for score in settling]
            known = (settling_or_none(score.get("success", 1.0), score) for score in means)
            cells += [
                "{mean:.4f} ({0:.4f} to {1:.4f})".format(*score["ci95"], mean=score["mean"]) if score else "-"
                for score in known
            ]
            if known_bounds:
                cells.append(_over_bound(result, part, bound, protocol.duration_s))
            if moves:
                cells.append(number(scores["final_error_mm"]["median"]))
            table.add_row(escape(result["entry"]["name"]), *cells)
        tables.append(table)
    return tables


def _over_bound(result: Mapping[str, Any], part: str, bound: NDArray[np.float64], duration_s: float) -> str:
    """Return the ratio of settling times to their bounds with its interval; "-" if nothing settles."""
    from ...evaluation import fill_unsettled, paired_ratio

    if not result["scores"][part][f"settling_s.{BOUND_BAND}"]["success"]:
        return "-"
    ratio = paired_ratio(fill_unsettled(result["draws"][part][f"settling_s.{BOUND_BAND}"], duration_s), bound)
    return "{mean:.3f} ({0:.3f} to {1:.3f})".format(*ratio["ci95"], mean=ratio["mean"]) if ratio else "-"
