"""Tables of what held-out runs say about effects."""

from __future__ import annotations

import math

import pytest

from hframe_gym.identification.judge import held_out as judge
from hframe_gym.identification.judge.held_out import HeldOutEffect


@pytest.mark.parametrize(
    ("gain", "simulated", "counts"),
    [(-0.01, 0.9, 0.9), (-0.01, 0.4, -0.01), (0.01, 0.9, 0.01), (-0.01, -0.2, -0.01), (-0.01, None, -0.01)],
)
def test_a_clear_gain_in_simulation_counts_where_an_observer_shows_none(
    gain: float, simulated: float | None, counts: float
) -> None:
    """An observer hides the slow error that a small constant force explains."""
    assert judge.gain_of_effect(gain, None if simulated is None else lambda: simulated) == counts


@pytest.mark.parametrize(("change", "excited"), [(0.51, True), (0.49, False), (math.nan, True)])
def test_an_effect_that_hardly_changes_a_prediction_is_not_excited(change: float, excited: bool) -> None:
    """The change is compared with a twentieth of the error, 10; a diverging machine changes as well."""
    assert judge.is_excited(change**2, 10.0**2) == excited


@pytest.mark.parametrize(("ratios", "worse"), [([0.2, -0.1], True), ([0.2, -0.3], False), ([0.0], False)])
def test_simulations_are_compared_in_the_geometric_mean(ratios: list[float], worse: bool) -> None:
    assert judge.worsens_simulation(ratios) == worse


@pytest.mark.parametrize(
    ("effects", "worsens", "refuted", "reason"),
    [
        ({"a": (0.5, True), "b": (-0.1, True)}, True, ("b",), "does not reduce"),
        (
            {"a": (-0.2, True), "b": (-0.1, True), "c": (-0.3, True)},
            False,
            ("c", "a", "b"),
            "does not reduce",
        ),
        ({"a": (-0.5, False)}, False, (), ""),  # not excited: the fitted runs have confirmed it
        ({"a": (0.5, True), "b": (0.2, True)}, True, ("b", "a"), "worse with all effects together than"),
        ({"a": (0.5, True)}, True, ("a",), "worse with it than"),
        ({"a": (0.5, True), "b": (0.2, True)}, False, (), ""),
        ({"a": (0.5, False)}, True, (), ""),
    ],
)
def test_which_effects_held_out_runs_refute(
    effects: dict[str, tuple[float, bool]], worsens: bool, refuted: tuple[str, ...], reason: str
) -> None:
    shown = {label: HeldOutEffect(*values) for label, values in effects.items()}
    labels, text = judge.refuted_effects(shown, lambda: worsens)
    assert labels == refuted
    assert reason in text
