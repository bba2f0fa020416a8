from __future__ import annotations

import json

import numpy as np
import pytest

from hframe_gym.evaluation import Episodes, scores
from hframe_gym.evaluation.metrics import mean_with_interval, overshoot, settling


def episodes(**changes: object) -> Episodes:
    """Two episodes of four samples and two control periods along x to 10 mm: one arrives, one stops 0.5 mm short."""
    x = 1e-3 * np.array([[0.0, 9.7, 10.03, 10.0], [0.0, 9.0, 9.5, 9.5]])
    fields: dict[str, object] = {
        "time_s": 0.1 * np.arange(4),
        "position": np.stack([x, np.zeros_like(x)], axis=2),
        "goal": np.tile([0.01, 0.0], (2, 4, 1)),
        "contour": None,
        "volts": np.array([[[12.0, 0.0], [-3.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]]),
        "rated": np.array([12.0, 12.0]),
        "energy_J": np.array([1.0, 3.0]),
        "peak_belt_force_N": np.array([40.0, 60.0]),
    }
    return Episodes(**(fields | changes))  # type: ignore[arg-type]


def test_settling_counts_from_the_last_entry_into_the_band() -> None:
    error = np.array([[5.0, 0.5, 2.0, 0.5, 0.1], [0.5, 0.1, 0.1, 0.1, 0.1], [5.0, 0.5, 0.5, 0.5, 2.0]])
    times, success = settling(error, np.arange(5.0), 1.0)
    np.testing.assert_array_equal(times, [3.0, 0.0, 4.0])
    np.testing.assert_array_equal(success, [True, True, False])


def test_settling_on_the_edge_of_the_band_is_inside() -> None:
    assert settling(np.array([[1.0, 1.0]]), np.arange(2.0), 1.0)[1][0]


def test_overshoot_is_along_the_way() -> None:
    position = np.array([[[0.0, 0.0], [3.5, 4.0 + 0.5 / 4 * 3 * 0], [3.0, 4.0]], [[0.0, 0.0], [1.0, 9.0], [3.0, 3.0]]])
    goal = np.array([[3.0, 4.0], [100.0, 0.0]])
    np.testing.assert_allclose(overshoot(position, goal), [0.3, 0.0])


def test_overshoot_of_no_way_is_the_distance_wandered() -> None:
    position = np.array([[[1.0, 1.0], [1.0, 1.25], [1.0, 1.0]]])
    np.testing.assert_allclose(overshoot(position, np.array([[1.0, 1.0]])), [0.25])


def test_scores_by_hand() -> None:
    card = scores(episodes())
    assert card["success"] == {"1mm": 1.0, "0.2mm": 0.5, "0.05mm": 0.5}
    assert card["settling_s"]["1mm"]["mean"] == pytest.approx(0.1)
    assert card["settling_s"]["0.2mm"]["mean"] == pytest.approx((0.2 + 0.3) / 2)  # the failed one counts its length
    assert card["over_bound"] is None
    assert card["overshoot_mm"]["mean"] == pytest.approx(0.015)
    assert card["final_error_mm"]["mean"] == pytest.approx(0.25)
    assert card["energy_J"]["mean"] == 2.0
    assert card["voltage_variation"]["mean"] == pytest.approx((12.0 + 15.0) / 2)
    assert card["saturation_share"]["mean"] == pytest.approx(1 / 8)
    assert card["peak_belt_force_N"]["mean"] == 50.0
    json.dumps(card, allow_nan=False)


def test_over_bound_is_the_mean_of_ratios_and_the_ratio_of_means_stands_beside_it() -> None:
    over = scores(episodes(), np.array([0.1, 0.3]))["over_bound"]["0.2mm"]
    assert over["mean"] == pytest.approx((2.0 + 1.0) / 2)
    assert over["ratio_of_means"]["mean"] == pytest.approx((0.2 + 0.3) / (0.1 + 0.3))
    low, high = over["ratio_of_means"]["ci95"]
    assert (low, high) == pytest.approx((1.0, 2.0))  # both draws the second, or both the first
    assert over["episodes"] == 2


def test_over_bound_is_of_the_draws_that_have_one() -> None:
    card = scores(episodes(), np.array([np.nan, 0.1]))
    once = {"mean": pytest.approx(3.0), "ci95": pytest.approx([3.0, 3.0])}
    assert card["over_bound"]["0.2mm"] == once | {"ratio_of_means": once, "episodes": 1}
    assert scores(episodes(), np.array([np.nan, np.nan]))["over_bound"] is None


def test_tracking_by_hand() -> None:
    """A goal at 10 mm/s along x; a tool 1 mm behind it, and one 2 mm off to the side."""
    time_s = 0.1 * np.arange(5)
    goal = np.tile(np.stack([0.01 * time_s, np.zeros(5)], axis=1), (2, 1, 1))
    position = goal + np.array([[[-1e-3, 0.0]], [[0.0, 2e-3]]])
    contour = np.array([np.zeros(5), np.full(5, 2e-3)])
    card = scores(
        episodes(time_s=time_s, goal=goal, position=position, contour=contour, volts=np.zeros((2, 4, 2))),
    )
    assert card["success"] == {"1mm": 0.5, "0.2mm": 0.5, "0.05mm": 0.5}
    assert card["contour_mm"]["rms"]["mean"] == pytest.approx(1.0)
    assert card["contour_mm"]["max"]["mean"] == pytest.approx(1.0)
    assert card["tracking_mm"]["rms"]["mean"] == pytest.approx(1.5)
    assert card["delay_ms"]["mean"] == pytest.approx(50.0)
    assert "settling_s" not in card


@pytest.mark.parametrize("bound", [[0.1], [0.1, 0.0], [0.1, np.inf]])
def test_refuses_bounds_that_do_not_fit(bound: list[float]) -> None:
    with pytest.raises(ValueError, match="bound_s must hold 2"):
        scores(episodes(), np.array(bound))


def test_interval_covers_the_mean_and_repeats_with_the_seed() -> None:
    values = np.random.default_rng(0).normal(5.0, 1.0, 400)
    found = mean_with_interval(values, 1)
    low, high = found["ci95"]
    assert low < found["mean"] < high
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert mean_with_interval(values, 1) == found
    assert mean_with_interval(np.full(5, 2.0), 1) == {"mean": 2.0, "ci95": [2.0, 2.0]}
