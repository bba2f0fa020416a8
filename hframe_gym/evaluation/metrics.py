"""Scores of a batch of episodes: settling or contour error, success, effort, with intervals over the draws."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from .episodes import Episodes

Array = NDArray[np.float64]
BANDS = {"1mm": 1e-3, "0.2mm": 2e-4, "0.05mm": 5e-5}  # m
JUDGED = "0.2mm"  # the band of the time-optimal bound
SATURATED = 1.0 - 1e-6  # of the rated voltage
RESAMPLES = 2000


def settling(error: Array, time_s: Array, band: float) -> tuple[Array, NDArray[np.bool_]]:
    """Settling time (B,), s, and success (B,) from the distance to the goal error (B, n), m, at time_s (n,).

    Settled is from the first sample on after which the error never leaves the band; an episode that is outside at the
    end has failed and counts its whole length.
    """
    outside = error > band
    after_last = np.where(outside.any(axis=1), error.shape[1] - np.argmax(outside[:, ::-1], axis=1), 0)
    success = after_last < error.shape[1]
    return time_s[np.minimum(after_last, error.shape[1] - 1)] - time_s[0], success


def overshoot(position: Array, goal: Array) -> Array:
    """How far (B,) the tool went beyond the goal (B, 2) along the line from its start, m, from positions (B, n, 2).

    Zero where it never did; the largest distance where start and goal are one point.
    """
    way = goal - position[:, 0]
    length = np.linalg.norm(way, axis=1)
    unit = way / np.where(length > 0.0, length, 1.0)[:, None]
    beyond = np.einsum("bni,bi->bn", position - goal[:, None], unit).max(axis=1)
    wandered = np.linalg.norm(position - goal[:, None], axis=2).max(axis=1)
    return np.where(length > 0.0, np.maximum(beyond, 0.0), wandered)


def delay(run: Episodes) -> Array:
    """How late the tool is (B,), s: the time by which its goal, moved back, fits it best (to first order)."""
    speed = np.gradient(run.goal, run.time_s, axis=1)
    late = np.sum((run.goal - run.position) * speed, axis=(1, 2))
    return np.asarray(late / np.maximum(np.sum(speed**2, axis=(1, 2)), 1e-12))


def mean_with_interval(values: Array, seed: int) -> dict[str, Any]:
    """Mean of values (B,) and its 95 % percentile-bootstrap interval over the draws; the mean twice where all agree."""
    mean = float(np.mean(values))
    if len(values) < 2 or np.all(values == values[0]):
        return {"mean": mean, "ci95": [mean, mean]}
    interval = bootstrap(
        (values,), np.mean, n_resamples=RESAMPLES, batch=100, method="percentile", rng=np.random.default_rng(seed)
    ).confidence_interval
    return {"mean": mean, "ci95": [float(interval.low), float(interval.high)]}


def scores(run: Episodes, bound_s: Array | None = None, *, seed: int = 0) -> dict[str, Any]:
    """The scores of one controller, plain data as in scores.json.

    bound_s: least possible time of each episode (B,), s, NaN where it is not known; see `over_bound`.  seed: of the
    bootstrap.

    `voltage_variation` is the sum over drives and control periods of |change of voltage| in V, from 0 V before the
    first; `saturation_share` the share of drives and periods at rated voltage.  See `reaching` and `tracking` for what
    depends on the task.

    Raises ValueError when bound_s has another length or holds a time that is not positive and finite.
    """
    before = np.concatenate([np.zeros_like(run.volts[:, :1]), run.volts[:, :-1]], axis=1)
    variation = np.abs(run.volts - before).sum(axis=(1, 2))
    saturated = (np.abs(run.volts) >= SATURATED * run.rated).mean(axis=(1, 2))
    task = reaching(run, bound_s, seed) if run.contour is None else tracking(run, run.contour, seed)
    return task | {
        "energy_J": mean_with_interval(run.energy_J, seed),
        "voltage_variation": mean_with_interval(variation, seed),
        "saturation_share": mean_with_interval(saturated, seed),
        "peak_belt_force_N": mean_with_interval(run.peak_belt_force_N, seed),
    }


def reaching(run: Episodes, bound_s: Array | None, seed: int) -> dict[str, Any]:
    """Success and settling in each band, overshoot along the line from start to goal, error at the end."""
    error = np.linalg.norm(run.position - run.goal, axis=2)
    settled = {name: settling(error, run.time_s, band) for name, band in BANDS.items()}
    return {
        "success": {name: float(np.mean(success)) for name, (_, success) in settled.items()},
        "settling_s": {
            name: {
                "mean": float(np.mean(times)),
                "median": float(np.median(times)),
                "p95": float(np.quantile(times, 0.95)),
                "ci95": mean_with_interval(times, seed)["ci95"],
            }
            for name, (times, _) in settled.items()
        },
        "over_bound": None if bound_s is None else over_bound(settled[JUDGED][0], bound_s, seed),
        "overshoot_mm": mean_with_interval(1e3 * overshoot(run.position, run.goal[:, -1]), seed),
        "final_error_mm": mean_with_interval(1e3 * error[:, -1], seed),
    }


def over_bound(times: Array, bound_s: Array, seed: int) -> dict[str, Any] | None:
    """How far times (B,) are above bound_s (B,), of the `episodes` whose bound is known (not NaN); None without any.

    `mean` is the mean of the ratios, in which every draw counts alike, short ways too; `ratio_of_means` is mean time
    over mean bound, in which every millisecond does.

    Raises ValueError when bound_s has another length or holds a time that is not positive and finite.
    """
    bound = np.asarray(bound_s, np.float64)
    known = ~np.isnan(bound)
    if bound.shape != times.shape or not np.all(np.isfinite(bound[known]) & (bound[known] > 0.0)):
        raise ValueError(f"bound_s must hold {len(times)} positive times, one an episode, or NaN where none is known")
    if not known.any():
        return None
    times, bound = times[known], bound[known]
    found = mean_with_interval(times / bound, seed)
    return {JUDGED: found | {"ratio_of_means": ratio_of_means(times, bound, seed), "episodes": len(times)}}


def ratio_of_means(times: Array, bound: Array, seed: int) -> dict[str, Any]:
    """Mean of times (B,) over that of bound (B,), and its 95 % percentile-bootstrap interval over the draws."""
    index = np.random.default_rng(seed).integers(len(times), size=(RESAMPLES, len(times)))
    ratios = times[index].mean(axis=1) / bound[index].mean(axis=1)
    return {"mean": float(times.mean() / bound.mean()), "ci95": np.quantile(ratios, [0.025, 0.975]).tolist()}


def tracking(run: Episodes, contour: Array, seed: int) -> dict[str, Any]:
    """Of each episode, from rest to its end: contour error (to the path) and tracking error (to the goal on it), root
    mean square and largest, how late the tool is, and the share that never leaves a band around the path."""
    errors = {"contour_mm": contour, "tracking_mm": np.linalg.norm(run.position - run.goal, axis=2)}
    return {
        "success": {name: float(np.mean(contour.max(axis=1) <= band)) for name, band in BANDS.items()},
        **{
            name: {
                "rms": mean_with_interval(1e3 * np.sqrt(np.mean(error**2, axis=1)), seed),
                "max": mean_with_interval(1e3 * error.max(axis=1), seed),
            }
            for name, error in errors.items()
        },
        "delay_ms": mean_with_interval(1e3 * delay(run), seed),
    }
