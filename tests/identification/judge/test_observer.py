"""Tests of the choice of an observer by tables of losses and costs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from hframe_gym.identification.judge.observer import best_in_simulation, index_of_best_simulation, likeliest


@pytest.mark.parametrize(
    ("losses", "expected"),
    [
        ({60: 5.0, 30: 4.0, 15: 3.0, 7: 3.5, 3: 1.0, 0: 9.0}, 15),  # it stops at the first increase
        ({60: 5.0, 30: 4.0, 15: 3.0, 7: 2.5, 3: 1.0, 0: 9.0}, 3),
        ({60: 5.0, 30: 6.0, 15: 3.0, 7: 2.5, 3: 1.0, 0: 4.0}, 0),  # the simulation is tried in any case
        ({60: 5.0, 30: 5.0, 15: 3.0, 7: 2.5, 3: 1.0, 0: 5.0}, 60),  # equal is not better
        ({3: 5.0, 0: 4.0}, 0),
    ],
)
def test_the_bandwidth_has_the_largest_likelihood(losses: Mapping[int, float], expected: int) -> None:
    narrowing = [(bandwidth, loss) for bandwidth, loss in losses.items() if bandwidth]
    assert likeliest(narrowing, (0, losses[0])) == expected


def test_no_narrower_observer_is_fitted_than_is_compared() -> None:
    fits = iter([(60, 5.0), (30, 6.0), (15, 1.0)])
    assert likeliest(fits, (0, 9.0)) == 60
    assert next(fits) == (15, 1.0)


@pytest.mark.parametrize(
    ("products", "simulated", "expected"),
    [
        # A machine that contradicts the data may simulate them best by chance: it predicts 200 times worse.
        ({30: 4e6 * 1.0, 15: 3e6 * 1.1, 7: 1e6 * 9.0, 3: 6e5 * 200.0}, 6e5 * 200.0, 15),
        ({30: 4e6, 15: 3.3e6}, 3.2e6, 0),
        ({30: 4e6, 15: 3.3e6}, 3.3e6, 15),
        ({30: 4e6, 15: 4e6}, float("inf"), 30),
    ],
)
def test_the_final_fit_has_the_smallest_product_of_costs(
    products: Mapping[int, float], simulated: float, expected: int
) -> None:
    continued: list[int] = []

    def in_simulation(best: int, least: float) -> tuple[int, float]:
        assert least == products[best]
        continued.append(best)
        return 0, simulated

    assert best_in_simulation(products.items(), in_simulation) == expected
    assert continued == [min(products, key=lambda bandwidth: products[bandwidth])]


@pytest.mark.parametrize(
    ("others", "best"),
    [
        ([[1.0, 9.0], [5.0, 5.0]], 1),
        ([[10.0, 10.0], [5.0, np.inf]], 0),
        ([[2.0, 60.0], [3.0, 30.0]], 2),  # the geometric mean counts
    ],
)
def test_machines_simulate_best_if_all_runs_together_say_so(others: list[list[float]], best: int) -> None:
    assert index_of_best_simulation(np.array([[10.0, 10.0], *others])) == best
