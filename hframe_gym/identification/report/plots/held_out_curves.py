"""Curves of the held-out runs for the page: measurements, simulations and their errors, the worst run first.

The page draws them by a script of its own (`templates/curves.js`), because a reader zooms into them.
Libraries for such plots have a megabyte or more, draw into a bitmap without text, and take no colors from the
style sheet.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....arrays import Array
from ....web_page import extreme_rows, number
from ..content.document import Report, compared_machines
from ..content.result_curves import ResultCurves, RunCurves
from ..units import readable_unit

_COLORS = {"declared": "declared", "plain": "series3", "before": "before", "after": "after"}
_MAX_BYTES = 1_500_000  # of all curves in the page, so that a page of many runs stays below 3 MB
_MAX_ROWS, _MIN_ROWS = 3000, 200  # of one curve; a screen has some 1000 columns
_BYTES_PER_VALUE = 16 / 3  # 4 bytes as base64 text
_FAR = 3.0  # Error relative to that of the refitted machine above which a curve is hidden at first.
_KEPT_PER_BUCKET = 5  # first row, smallest and largest error of two machines


def _drawn_machines(report: Report, curves: ResultCurves) -> dict[str, str]:
    """Return the machines whose simulations are drawn, with their labels: those whose curves are known."""
    known = curves.runs[report.runs.held_out[0]].errors
    return {key: label for key, label in compared_machines(report).items() if key in known}


def run_ratio(report: Report, curves: ResultCurves, run: str, stage: str = "after") -> float | None:
    """Return a machine's simulation error / sensor noise on a held-out run, rms over the channels.

    Args:
        report: Content of report.json.
        curves: Curves of the same result.
        run: Name of a held-out run.
        stage: Machine: "declared", "before" (refitted), "after" (delivered) or "plain", if there is a plain
            fit.

    Returns:
        The ratio, dimensionless; infinite if the simulation diverges on the run, None if nothing was
        measured.
    """
    measured, errors = curves.runs[run].measured, curves.runs[run].errors[stage]
    squares = []
    for j, channel in enumerate(report.channels):
        error = errors[:, j][np.isfinite(errors[:, j])]
        if not len(error):
            if np.isfinite(measured[:, j]).any():
                return math.inf
            continue
        if noise := report.noise_of(channel):
            squares.append(float(np.mean(error**2)) / noise**2)
    return math.sqrt(sum(squares) / len(squares)) if squares else None


def worst_first(report: Report, curves: ResultCurves) -> list[str]:
    """Return the names of the held-out runs, that with the largest error of the delivered machine first.

    The error is `run_ratio`; a run without measurements is last.
    """
    ratios = {run: run_ratio(report, curves, run) for run in report.runs.held_out}
    return sorted(ratios, key=lambda run: -(ratios[run] or 0.0))


def page_curves(report: Report, curves: ResultCurves) -> dict[str, Any]:
    """Return the curves of the held-out runs as content of a JSON document, for the script of the page.

    Every run and channel has one set of rows for all its curves: the first of each interval of time, and
    those with the smallest and the largest error of the refitted and of the corrected machine, so that no
    peak is lost. The number of intervals is such that all curves together have at most 1.5 MB, if each keeps
    200 rows.

    Returns:
        "machines": "key", "label" and "color" of each machine, and whether it is "shown" at first. "runs":
        worst first, each with "name", "label" and "channels". A channel has "name", "quantity", the units and
        factors of values and errors, "noise" (standard deviation, in the unit of the errors) and its curves
        as base64 text of 32-bit floats, little-endian: "time" (s since the start of the run), "measured" and
        "errors" (measured minus simulated) by machine.
    """
    machines = _drawn_machines(report, curves)
    runs = worst_first(report, curves)
    count = max(1, len(runs) * len(report.channels) * (2 + len(machines)))
    rows = int(np.clip(_MAX_BYTES / (_BYTES_PER_VALUE * count), _MIN_ROWS, _MAX_ROWS))
    far = _far(report, curves, runs[0])
    return {
        "machines": [
            {"key": key, "label": label, "color": _COLORS[key], "shown": key not in far}
            for key, label in machines.items()
        ],
        "runs": [
            {
                "name": run,
                "label": _run_label(run_ratio(report, curves, run), run),
                "channels": [
                    _channel_curves(report, curves.runs[run], channel, j, list(machines), far, rows)
                    for j, channel in enumerate(report.channels)
                    if np.isfinite(curves.runs[run].measured[:, j]).any()
                ],
            }
            for run in runs
        ],
    }


def _far(report: Report, curves: ResultCurves, run: str) -> set[str]:
    """Return the machines beside whose errors on the worst run those of the others look like zero."""
    ratios = {key: run_ratio(report, curves, run, key) for key in _drawn_machines(report, curves)}
    limit = _FAR * (ratios["before"] or math.inf)
    return {key for key in ("declared", "plain") if (ratios.get(key) or 0.0) > limit}


def _run_label(ratio: float | None, run: str) -> str:
    """Return the name of a run with its error."""
    if ratio is None:
        return run
    return f"{run}: {number(ratio)} × noise" if math.isfinite(ratio) else f"{run}: diverges"


def _channel_curves(
    report: Report,
    run: RunCurves,
    channel: str,
    j: int,
    machines: Sequence[str],
    far: set[str],
    max_rows: int,
) -> dict[str, Any]:
    """Return the curves of one channel of a run, with the unit of the errors that are shown at first."""
    time_s, measured = run.time_s, run.measured[:, j]
    errors = {key: run.errors[key][:, j] for key in machines}
    rows = _kept_rows([errors[key] for key in ("before", "after") if key in errors], max_rows)
    factor, unit = readable_unit(channel, float(np.nanmax(np.abs(measured), initial=0.0)))
    largest = max(
        float(np.nanmax(np.abs(error), initial=0.0)) for key, error in errors.items() if key not in far
    )
    error_factor, error_unit = readable_unit(channel, largest)
    noise = report.noise_of(channel)
    return {
        "name": channel,
        "quantity": channel.rpartition("_")[0] or channel,
        "unit": unit,
        "factor": factor,
        "error_unit": error_unit,
        "error_factor": error_factor,
        "noise": None if noise is None else error_factor * noise,
        "time": _encoded((time_s - time_s[0])[rows]),
        "measured": _encoded(measured[rows]),
        "errors": {key: _encoded(error[rows]) for key, error in errors.items()},
    }


def _kept_rows(errors: Sequence[Array], max_rows: int) -> NDArray[np.intp]:
    """Return the rows of errors (n,) that remain of a curve, increasing."""
    count = len(errors[0])
    if count <= max_rows:
        return np.arange(count)
    buckets = np.array_split(np.arange(count), max(1, max_rows // _KEPT_PER_BUCKET))
    regular = [*(part[0] for part in buckets), count - 1]
    return np.union1d(regular, extreme_rows(errors, len(buckets)))


def _encoded(values: Array) -> str:
    """Return values as base64 text of 32-bit floats."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")
