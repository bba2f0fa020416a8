"""Tests of the metrics and of the stored time-optimal bounds."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from hframe_gym.controllers import ModelBasedController
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.evaluation import (
    BANDS,
    METRICS,
    Episodes,
    Scenario,
    condition_digests,
    episode_conditions,
    evaluate,
    mean_with_interval,
    rollout,
    score_episodes,
    settling_times,
    stored_bounds,
)
from hframe_gym.evaluation.metrics import overshoot
from hframe_gym.machine import BUILTIN_MACHINES

HFRAME = BUILTIN_MACHINES["hframe"]()
SEED = 1000  # of episodes whose bounds are stored


def episodes(**changes: object) -> Episodes:
    """Return two episodes of four samples and two periods along x to 10 mm: one stops at 9.5 mm."""
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


def test_settling_time_is_that_of_the_last_entry_into_the_band() -> None:
    error = np.array([[5.0, 0.5, 2.0, 0.5, 0.1], [0.5, 0.1, 0.1, 0.1, 0.1], [5.0, 0.5, 0.5, 0.5, 2.0]])
    times, success = settling_times(error, np.arange(5.0), 1.0)
    np.testing.assert_array_equal(times, [3.0, 0.0, 4.0])
    np.testing.assert_array_equal(success, [True, True, False])


def test_the_edge_of_the_band_is_inside() -> None:
    assert settling_times(np.array([[1.0, 1.0]]), np.arange(2.0), 1.0)[1][0]


def test_overshoot_is_along_the_line_to_the_goal() -> None:
    position = np.array([[[0.0, 0.0], [3.5, 4.0], [3.0, 4.0]], [[0.0, 0.0], [1.0, 9.0], [3.0, 3.0]]])
    goal = np.array([[3.0, 4.0], [100.0, 0.0]])
    np.testing.assert_allclose(overshoot(position, goal), [0.3, 0.0])


def test_overshoot_without_a_distance_is_the_largest_error() -> None:
    position = np.array([[[1.0, 1.0], [1.0, 1.25], [1.0, 1.0]]])
    np.testing.assert_allclose(overshoot(position, np.array([[1.0, 1.0]])), [0.25])


def test_reach_scores_by_hand() -> None:
    card = score_episodes(episodes())
    assert card["success"] == {"1mm": 1.0, "0.2mm": 0.5, "0.05mm": 0.5}
    assert card["settling_s"]["1mm"]["mean"] == pytest.approx(0.1)
    # The failed one counts in full.
    assert card["settling_s"]["0.2mm"]["mean"] == pytest.approx((0.2 + 0.3) / 2)
    assert card["over_bound"] is None
    assert card["overshoot_mm"]["mean"] == pytest.approx(0.015)
    assert card["final_error_mm"]["mean"] == pytest.approx(0.25)
    assert card["energy_J"]["mean"] == 2.0
    assert card["voltage_variation"]["mean"] == pytest.approx((12.0 + 15.0) / 2)
    assert card["saturation_share"]["mean"] == pytest.approx(1 / 8)
    assert card["peak_belt_force_N"]["mean"] == 50.0
    json.dumps(card, allow_nan=False)


def test_over_bound_has_the_mean_of_ratios_and_the_ratio_of_means() -> None:
    over = score_episodes(episodes(), np.array([0.1, 0.3]))["over_bound"]["0.2mm"]
    assert over["mean"] == pytest.approx((2.0 + 1.0) / 2)
    assert over["ratio_of_means"]["mean"] == pytest.approx((0.2 + 0.3) / (0.1 + 0.3))
    low, high = over["ratio_of_means"]["ci95"]
    # Both resampled episodes are the second, or both the first.
    assert (low, high) == pytest.approx((1.0, 2.0))
    assert over["episodes"] == 2


def test_over_bound_uses_the_episodes_with_a_bound() -> None:
    card = score_episodes(episodes(), np.array([np.nan, 0.1]))
    once = {"mean": pytest.approx(3.0), "ci95": pytest.approx([3.0, 3.0])}
    assert card["over_bound"]["0.2mm"] == once | {"ratio_of_means": once, "episodes": 1}
    assert score_episodes(episodes(), np.array([np.nan, np.nan]))["over_bound"] is None


def test_track_scores_by_hand() -> None:
    """A goal at 10 mm/s along x; a tool 1 mm behind it, and one 2 mm off to the side."""
    time_s = 0.1 * np.arange(5)
    goal = np.tile(np.stack([0.01 * time_s, np.zeros(5)], axis=1), (2, 1, 1))
    position = goal + np.array([[[-1e-3, 0.0]], [[0.0, 2e-3]]])
    contour = np.array([np.zeros(5), np.full(5, 2e-3)])
    card = score_episodes(
        episodes(time_s=time_s, goal=goal, position=position, contour=contour, volts=np.zeros((2, 4, 2)))
    )
    assert card["success"] == {"1mm": 0.5, "0.2mm": 0.5, "0.05mm": 0.5}
    assert card["contour_mm"]["rms"]["mean"] == pytest.approx(1.0)
    assert card["contour_mm"]["max"]["mean"] == pytest.approx(1.0)
    assert card["tracking_mm"]["rms"]["mean"] == pytest.approx(1.5)
    assert card["delay_ms"]["mean"] == pytest.approx(50.0)
    assert "settling_s" not in card


@pytest.mark.parametrize("bound", [[0.1], [0.1, 0.0], [0.1, np.inf]])
def test_bounds_that_do_not_fit_are_rejected(bound: list[float]) -> None:
    with pytest.raises(ValueError, match="bound_s must hold 2"):
        score_episodes(episodes(), np.array(bound))


def test_interval_contains_the_mean_and_depends_on_the_seed_only() -> None:
    values = np.random.default_rng(0).normal(5.0, 1.0, 400)
    result = mean_with_interval(values, 1)
    low, high = result["ci95"]
    assert low < result["mean"] < high
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert mean_with_interval(values, 1) == result
    assert mean_with_interval(np.full(5, 2.0), 1) == {"mean": 2.0, "ci95": [2.0, 2.0]}


def test_a_task_may_have_other_metrics(monkeypatch: pytest.MonkeyPatch) -> None:
    def largest_error(episodes: Episodes, bound_s: Any, seed: int) -> dict[str, Any]:
        return {"largest_error_mm": mean_with_interval(1e3 * episodes.goal_error.max(axis=1), seed)}

    monkeypatch.setitem(METRICS._parts, "largest-error", largest_error)
    card = score_episodes(episodes(), metrics="largest-error")
    assert card["largest_error_mm"]["mean"] == pytest.approx(10.0)
    assert "settling_s" not in card
    assert "energy_J" in card
    with pytest.raises(InputError, match="metric set 'none' is unknown"):
        score_episodes(episodes(), metrics="none")


@pytest.mark.parametrize("changes", [{"sensors": "rig"}, {"period": 0.002}, {"duration_s": 0.5}])
def test_conditions_do_not_depend_on_the_controller_s_side(changes: dict[str, object]) -> None:
    scenario, other = Scenario(episodes=9, seed=4), Scenario(episodes=9, seed=4, **changes)  # type: ignore[arg-type]
    assert condition_digests(episode_conditions(scenario)) == condition_digests(episode_conditions(other))


def test_conditions_are_those_of_the_episodes() -> None:
    scenario = Scenario(HFRAME, episodes=3, seed=4, duration_s=0.02)
    run, conditions = rollout(ModelBasedController(HFRAME), scenario), episode_conditions(scenario)
    np.testing.assert_array_equal(run.position[:, 0], conditions.start)
    np.testing.assert_array_equal(run.goal[:, 0], conditions.goal)


def test_digests_depend_on_all_conditions() -> None:
    conditions = episode_conditions(Scenario(episodes=2, seed=4))
    changed = [
        conditions._replace(start=conditions.start + 1e-6),
        conditions._replace(goal=conditions.goal + 1e-6),
        conditions._replace(parameters=conditions.parameters * (1.0 + 1e-6)),
        conditions._replace(machine=BUILTIN_MACHINES["hframe-linear"]()),
    ]
    digests = [digest for c in (conditions, *changed) for digest in condition_digests(c)]
    assert len(set(digests)) == len(digests)


def test_bounds_belong_to_the_conditions_and_not_to_their_index() -> None:
    times, reason = stored_bounds(Scenario(episodes=6, seed=SEED))
    later, _ = stored_bounds(Scenario(HFRAME, sensors="rig", period=0.002, episodes=3, seed=SEED + 3))
    assert times is not None
    assert later is not None
    assert reason is None
    np.testing.assert_array_equal(later, times[3:])
    assert np.all((times > 0.02) & (times < 1.0))


def test_no_settling_time_is_below_its_bound() -> None:
    scenario = Scenario(HFRAME, period=0.002, episodes=24, seed=SEED)
    scores, runs = evaluate({"pid": ModelBasedController(HFRAME, 0.002)}, scenario)
    run, bound = runs["pid"], stored_bounds(scenario).times_s
    times, success = settling_times(run.goal_error, run.time_s, BANDS["0.2mm"])
    assert bound is not None
    assert success.all()
    assert np.all(times > bound)
    over = scores["controllers"]["pid"]["over_bound"]["0.2mm"]
    assert over["mean"] == pytest.approx(np.mean(times / bound))
    assert over["episodes"] == 24
    assert over["mean"] < 1.12
    assert scores["controllers"]["pid"]["over_bound_reason"] is None


@pytest.mark.parametrize(
    ("scenario", "reason"),
    [
        (Scenario(randomize="none", episodes=2, seed=SEED), "no bound is stored for 2 of 2 episodes"),
        (Scenario(task="track", episodes=2, seed=SEED), "goals that do not move"),
        (
            Scenario(HFRAME.with_effects(EFFECTS["constant_force"].at("x", size=1.0)), episodes=2, seed=SEED),
            "stored for 'hframe', because it has effects",
        ),
    ],
)
def test_missing_bounds_have_a_reason(scenario: Scenario, reason: str) -> None:
    bounds = stored_bounds(scenario)
    assert bounds.times_s is None
    assert reason in str(bounds.reason)


def test_some_missing_bounds_have_a_reason() -> None:
    bounds = stored_bounds(Scenario(episodes=3, seed=SEED + 510))
    assert bounds.times_s is not None
    np.testing.assert_array_equal(np.isnan(bounds.times_s), [False, False, True])
    assert "1 of 3 episodes" in str(bounds.reason)
