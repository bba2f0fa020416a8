"""Metrics of recorded episodes, with confidence intervals over the episodes.

A metric set is a function with the signature `MetricSet` in `METRICS`; a task names its set by an attribute
`metrics`.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Times
from ..machine import METERS
from ..registry import Registry
from .episodes import Episodes

BANDS = METERS.bands  # m, settling bands of linear axes by name, from wide to narrow
BOUND_BAND = METERS.bound_band  # settling band of the stored time-optimal bounds
SATURATED = 1.0 - 1e-6  # fraction of the rated voltage from which a drive counts as saturated
BOOTSTRAP_RESAMPLES = 2000


class MetricSet(Protocol):
    """Signature of a function in `METRICS`, which computes the metrics of a task."""

    def __call__(self, episodes: Episodes, bound_s: Array | None, seed: int) -> dict[str, Any]:
        """Compute the metrics of B recorded episodes, by name, as data that JSON can hold.

        Args:
            bound_s: Shortest possible settling time of each episode, s, shape (B,), NaN where unknown, or
                None for all.
            seed: Seed of the bootstrap resampling.
        """


METRICS: Registry[MetricSet] = Registry("metric set")


def score_episodes(
    episodes: Episodes, bound_s: Array | None = None, *, seed: int = 0, metrics: str | None = None
) -> dict[str, Any]:
    """Compute the scores of one controller from its B recorded episodes.

    Args:
        bound_s: Shortest possible settling times, s, shape (B,), NaN where unknown; None if unknown for all.
        seed: Seed of the bootstrap resampling that gives confidence intervals.
        metrics: "reach" (fixed goal), "track" (path) or another registered set. Default: "track" if there is
            a path.

    Returns:
        The metrics of the set (see `reach_metrics` and `track_metrics`) and four scores, by name. Each score
        has two entries: `mean` over the episodes and `ci95`, [lower, upper limit] of its 95 % confidence
        interval. The scores:

        - `energy_J`: electrical energy drawn minus energy fed back, J; only for drives of voltages.
        - `voltage_variation`: sum over drives and periods of the absolute voltage change, from 0 V at the
          start, V.
        - `saturation_share`: fraction of drives and control periods at rated voltage, 0 to 1.
        - `peak_belt_force_N`: largest absolute difference between the tension of a belt and its pretension,
          N.

    Raises:
        InputError: If no metric set has this name.
        ValueError: If `bound_s` is not valid, or the metric set "track" is used for episodes without a path.
    """
    variation = np.abs(np.diff(episodes.volts, axis=1, prepend=0.0)).sum(axis=(1, 2))
    saturated = (np.abs(episodes.volts) >= SATURATED * episodes.rated).mean(axis=(1, 2))
    name = metrics or ("reach" if episodes.contour is None else "track")
    energy = {} if episodes.energy_J is None else {"energy_J": mean_with_interval(episodes.energy_J, seed)}
    return METRICS.get(name)(episodes, bound_s, seed) | {
        **energy,
        "voltage_variation": mean_with_interval(variation, seed),
        "saturation_share": mean_with_interval(saturated, seed),
        "peak_belt_force_N": mean_with_interval(episodes.peak_belt_force_N, seed),
    }


@METRICS.register("reach")
def reach_metrics(episodes: Episodes, bound_s: Array | None, seed: int) -> dict[str, Any]:
    """Compute the metrics of moves to a fixed goal: success, settling time, overshoot, and error at the end.

    An episode settles within 1, 0.2 or 0.05 mm if the tool stays within this distance of the goal until the
    end. The bands of rotary axes are 10, 2 and 0.5 mrad, and names have mrad for mm.

    Args:
        bound_s: Shortest possible settling times within 0.2 mm, s, shape (B,), NaN where unknown; None for
            all unknown.
        seed: Seed of the bootstrap resampling that gives confidence intervals.

    Returns:
        `success`: fraction of episodes that settle, 0 to 1, by distance ("1mm", "0.2mm", "0.05mm").
        `settling_s`: settling times by distance, s: `mean`, `median`, `p95` (95 % quantile) and `ci95`, the
        95 % confidence interval of the mean. An episode that does not settle counts with its length.
        `over_bound`: ratio of the settling times (within 0.2 mm) to their bounds (`ratio_to_bound`); None
        without them. `overshoot_mm`: distance by which the tool passes the goal on the line from start to
        goal, mm, and `final_error_mm`: distance to the goal at the end, mm; `mean` and `ci95` over the
        episodes each.

    Raises:
        ValueError: If `bound_s` has another length, or holds a time that is neither NaN nor positive and
            finite.
    """
    error = episodes.goal_error
    unit = episodes.unit
    settled = {name: settling_times(error, episodes.time_s, band) for name, band in unit.bands.items()}
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
        "over_bound": None if bound_s is None else ratio_to_bound(settled[BOUND_BAND][0], bound_s, seed),
        f"overshoot_{unit.small}": mean_with_interval(
            1e3 * overshoot(episodes.position, episodes.goal[:, -1]), seed
        ),
        f"final_error_{unit.small}": mean_with_interval(1e3 * error[:, -1], seed),
    }


@METRICS.register("track")
def track_metrics(episodes: Episodes, bound_s: Array | None, seed: int) -> dict[str, Any]:
    """Compute the metrics of motion along a path: contour error, tracking error, delay and success.

    The contour error is the distance of the tool to the path, the tracking error its distance to the moving
    goal.

    Args:
        episodes: Recorded episodes of a task with a path.
        bound_s: Not used, because there are no time-optimal bounds for paths; s, shape (B,).
        seed: Seed of the bootstrap resampling that gives confidence intervals.

    Returns:
        `success`: for each of the limits 1, 0.2 and 0.05 mm the fraction, 0 to 1, of episodes whose contour
        error never exceeds it. `contour_mm`, `tracking_mm`: `rms` and `max` of the error in an episode, mm.
        `delay_ms`: delay of the tool, ms. Each has the `mean` over the episodes and `ci95`, its 95 %
        confidence interval. Rotary axes have mrad for mm.

    Raises:
        ValueError: If the episodes have no path.
    """
    contour = episodes.contour
    if contour is None:
        raise ValueError("the metric set 'track' needs episodes with a path (info['contour_m'])")
    unit = episodes.unit
    errors = {f"contour_{unit.small}": contour, f"tracking_{unit.small}": episodes.goal_error}
    return {
        "success": {name: float(np.mean(contour.max(axis=1) <= band)) for name, band in unit.bands.items()},
        **{
            name: {
                "rms": mean_with_interval(1e3 * np.sqrt(np.mean(error**2, axis=1)), seed),
                "max": mean_with_interval(1e3 * error.max(axis=1), seed),
            }
            for name, error in errors.items()
        },
        "delay_ms": mean_with_interval(1e3 * tracking_delay(episodes), seed),
    }


def settling_times(error: Array, time_s: Times, band: float) -> tuple[Array, NDArray[np.bool_]]:
    """Compute the settling times of B episodes: the times from which on the error never exceeds the band.

    Args:
        error: Distance to the goal at n samples, m or rad, shape (B, n).
        band: Settling band: largest distance to the goal, m or rad.

    Returns:
        times: Settling times from the first sample, s, shape (B,); the episode's duration if it does not
            settle.
        success: True for episodes that end within the band, shape (B,).
    """
    outside = error > band
    # Index of the first sample after the last one outside the band, (B,); n if the episode ends outside.
    after_last = np.where(outside.any(axis=1), error.shape[1] - np.argmax(outside[:, ::-1], axis=1), 0)
    success = after_last < error.shape[1]
    return time_s[np.minimum(after_last, error.shape[1] - 1)] - time_s[0], success


def ranked_episodes(episodes: Episodes) -> NDArray[np.intp]:
    """Return the indices of B episodes from the best to the worst, shape (B,).

    Moves to a goal are ordered by their settling time within 0.2 mm or 2 mrad, and those that do not settle
    follow, by the error at the end; motion along a path by the root mean square of the contour error.
    """
    if episodes.contour is not None:
        return np.argsort(np.mean(episodes.contour**2, axis=1), kind="stable")
    times, success = settling_times(episodes.goal_error, episodes.time_s, episodes.unit.bound_size)
    return np.lexsort((episodes.goal_error[:, -1], np.where(success, times, np.inf)))


def overshoot(position: Array, goal: Array) -> Array:
    """Compute the overshoot: how far the tool passes its goal at most, m or rad, shape (B,).

    It is measured along the line from start to goal, and 0 if the tool does not pass the goal. If start and
    goal coincide, it is the largest distance from them.

    Args:
        position: Tool positions at n samples of B episodes, m or rad, shape (B, n, axes).
        goal: Fixed tool goals, m or rad, shape (B, axes).
    """
    way = goal - position[:, 0]  # from start to goal, m, (B, axes)
    length = np.linalg.norm(way, axis=1)
    direction = way / np.where(length > 0.0, length, 1.0)[:, None]
    beyond = np.einsum("bni,bi->bn", position - goal[:, None], direction).max(axis=1)
    largest = np.linalg.norm(position - goal[:, None], axis=2).max(axis=1)
    return np.where(length > 0.0, np.maximum(beyond, 0.0), largest)


def tracking_delay(episodes: Episodes) -> Array:
    """Compute the mean delay of the tool behind its moving goal, s, shape (B,); 0 for a goal at rest.

    The delay T minimizes the sum over the samples of |g - T g' - p|^2: goal g, its velocity g', tool position
    p.
    """
    velocity = np.gradient(episodes.goal, episodes.time_s, axis=1)
    # The least-squares solution: T = sum (g - p) g' / sum |g'|^2.
    lag = np.sum((episodes.goal - episodes.position) * velocity, axis=(1, 2))
    return np.asarray(lag / np.maximum(np.sum(velocity**2, axis=(1, 2)), 1e-12))


def mean_with_interval(values: Array, seed: int) -> dict[str, Any]:
    """Compute `mean` and `ci95` of the `values`, one per episode, in any unit, shape (B,).

    The interval [lower, upper limit] has 95 % confidence (percentile bootstrap); both are the mean if all
    values are equal.
    """
    from scipy.stats import bootstrap  # SciPy's statistics take long to import

    mean = float(np.mean(values))
    if len(values) < 2 or np.all(values == values[0]):
        return {"mean": mean, "ci95": [mean, mean]}
    rng = np.random.default_rng(seed)
    result = bootstrap(
        (values,), np.mean, n_resamples=BOOTSTRAP_RESAMPLES, batch=100, method="percentile", rng=rng
    )
    interval = result.confidence_interval
    return {"mean": mean, "ci95": [float(interval.low), float(interval.high)]}


def ratio_to_bound(times: Array, bound_s: Array, seed: int) -> dict[str, Any] | None:
    """Compute the ratio of settling times to the time-optimal bounds, over the episodes whose bound is known.

    Args:
        times: Settling times of B episodes, s, shape (B,).
        bound_s: Shortest possible settling times (time-optimal bounds), s, shape (B,), NaN where unknown.
        seed: Seed of the bootstrap resampling.

    Returns:
        None if no bound is known; else a dictionary with the key "0.2mm" (distance within which bounds
        settle) and: `mean`, `ci95`: mean of the ratios time / bound over the episodes, and its 95 %
        confidence interval. `ratio_of_means`: `mean` and `ci95` of mean time / mean bound, which weights
        episodes by their bounds. `episodes`: number of episodes with a bound.

    Raises:
        ValueError: If `bound_s` has another length, or holds a time that is neither NaN nor positive and
            finite.
    """
    bound = np.asarray(bound_s, np.float64)
    with_bound = ~np.isnan(bound)
    if bound.shape != times.shape or not np.all(np.isfinite(bound[with_bound]) & (bound[with_bound] > 0.0)):
        raise ValueError(
            f"bound_s must hold {len(times)} positive times, one per episode, or NaN where none is known"
        )
    if not with_bound.any():
        return None
    times, bound = times[with_bound], bound[with_bound]
    ratio = mean_with_interval(times / bound, seed)
    return {
        BOUND_BAND: ratio | {"ratio_of_means": ratio_of_means(times, bound, seed), "episodes": len(times)}
    }


def ratio_of_means(times: Array, bound: Array, seed: int) -> dict[str, Any]:
    """Compute `mean` and `ci95` of the ratio of mean settling time to mean time-optimal bound, dimensionless.

    Args:
        times: Settling times in B episodes, s, shape (B,), or of S agents, (S, B); the bootstrap resamples
            both.
        bound: Shortest possible settling times of the same B episodes, s, shape (B,), all known.
        seed: Seed of the bootstrap resampling.
    """
    rng = np.random.default_rng(seed)
    index = rng.integers(len(bound), size=(BOOTSTRAP_RESAMPLES, len(bound)))
    means = np.atleast_2d(times)[:, index].mean(axis=2)  # by agent and resampling, s, (S, resamplings)
    agents = rng.integers(len(means), size=means.shape)
    ratios = np.take_along_axis(means, agents, axis=0).mean(axis=0) / bound[index].mean(axis=1)
    return {"mean": float(times.mean() / bound.mean()), "ci95": np.quantile(ratios, [0.025, 0.975]).tolist()}
