"""Scores of a protocol's parts: they follow from the draws' values, and are compared with the bounds."""

from __future__ import annotations

import json
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from ...arrays import Array
from ..metrics import ratio_of_means
from ..stored_bounds import stored_bounds
from .protocol import Draws, get_protocol

BOOTSTRAP_SEED = 0
BOUNDS_FOLDER = "bound_times_data"  # in the package `evaluation`
DIGITS = 9  # decimals of scores, s and mm


def part_scores(values: Draws, duration_s: float) -> dict[str, Any]:
    """Compute the scores of one part of a protocol (a task) from the metrics of its single draws (episodes).

    Args:
        values: Values of the B draws by metric, e.g. `final_error_mm`, mm, or `settling_s.1mm`, s, None if
            not settled.
        duration_s: Length of an episode, s, which counts as the settling time of a draw that does not settle.

    Returns:
        By metric `mean`, `ci95` (95 % interval of the mean, bootstrap over the draws) and `median`, in the
        unit of the metric; for a settling time also `success`, the fraction of draws that settle, 0 to 1.
    """
    scores: dict[str, Any] = {}
    for metric, column in values.items():
        numbers = fill_unsettled(column, duration_s)
        mean = ratio_of_means(numbers, np.ones(len(numbers)), BOOTSTRAP_SEED)
        limits = [round(limit, DIGITS) for limit in mean["ci95"]]
        scores[metric] = {"mean": round(mean["mean"], DIGITS), "ci95": limits}
        scores[metric]["median"] = round(float(np.median(numbers)), DIGITS)
        if metric.startswith("settling_s."):
            scores[metric]["success"] = float(np.mean([value is not None for value in column]))
    return scores


def fill_unsettled(column: list[float | None], duration_s: float) -> Array:
    """Return a metric's values, shape (B,), in which draws that do not settle have the episode's length.

    Args:
        column: B settling times, s, None for a draw that does not settle; values of another metric are not
            changed.
        duration_s: Length of an episode, s.
    """
    return np.array([duration_s if value is None else value for value in column], np.float64)


@cache
def protocol_bounds(name: str) -> dict[str, Array]:
    """Load the shortest possible settling times of the moves to a fixed goal in a protocol (part "reach").

    They are times to settle within 0.2 mm; `benchmarks.protocol_bounds` computes them.

    Returns:
        Times of two kinds, s, shape (draws,), NaN where unknown: `free`, for voltages that may change at any
        time, and `held`, for voltages that are constant over each control period. Empty for a protocol
        without such moves.

    Raises:
        InputError: If there is no such protocol.
        ValueError: If the stored times belong to other draws (episodes) than the protocol has.
    """
    protocol = get_protocol(name)
    if "reach" not in protocol.parts:
        return {}
    bounds = {"free": np.full(protocol.draws, np.nan), "held": np.full(protocol.draws, np.nan)}
    known = stored_bounds(protocol.scenario("reach")).times_s
    if known is not None:
        bounds["free"] = known
    file = resources.files("hframe_gym.evaluation") / BOUNDS_FOLDER / f"{name}.json"
    if not file.is_file():
        return bounds
    content = json.loads(file.read_text("utf-8"))
    if content["digest"] != protocol.digest:
        raise ValueError(f"{file}: the bounds belong to other draws of {name}")
    for row in content["draws"]:
        for kind in bounds:
            if row.get(f"{kind}_s") is not None:
                bounds[kind][row["draw"]] = row[f"{kind}_s"]
    return bounds


def paired_ratio(values: Array, others: Array) -> dict[str, Any] | None:
    """Compute the ratio of means of two quantities over the same draws (episodes), for example time / bound.

    Args:
        values: Values of the numerator in B draws, all known, shape (B,); for S agents that differ in the
            seed of their training, shape (S, B).
        others: Values of the denominator in the same draws, for example shortest possible times, in the same
            unit, shape (B,), NaN where unknown.

    Returns:
        `mean`: mean of `values` divided by mean of `others`, over the draws in which `others` is known;
        `ci95`: [lower, upper limit] of its 95 % confidence interval, by a bootstrap over draws and agents;
        `draws`: number of draws in which `others` is known. None if it is known in none.
    """
    both = np.isfinite(others)
    if not both.any():
        return None
    return ratio_of_means(values[..., both], others[both], BOOTSTRAP_SEED) | {"draws": int(both.sum())}
