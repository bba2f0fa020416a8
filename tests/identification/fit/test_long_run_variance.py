"""Tests of the variance of residuals that are correlated in time."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification.fit.long_run_variance import variance_along
from hframe_gym.identification.predict.linearization import RunLinearization

OF_EFFECT, PRECISION = np.array([False, True]), np.diag([1.0 / 0.3**2, 1e-12])


def correlated(seed: int, rows: int) -> RunLinearization:
    """Return a residual of 4 s at 1 kHz that is constant over rows, and two parameters' influence.

    The first parameter, of the machine, has the influence of a sine; the second one, of the effect, is
    constant.
    """
    residual = np.repeat(np.random.default_rng(seed).normal(size=4000 // rows), rows)
    sine = np.sin(np.arange(4000) * 2e-3 * np.pi)
    return RunLinearization(np.array([sine, np.ones(4000)]), None, residual, None)


@pytest.mark.parametrize("rows", [1, 20, 200, 4000])
def test_a_residual_that_is_constant_over_some_rows_has_that_many_times_the_variance(rows: int) -> None:
    """800 blocks of 0.5 s; the largest of three estimates, the last one of 100 runs."""
    runs = [correlated(seed, rows) for seed in range(100)]
    assert variance_along(runs, OF_EFFECT, PRECISION, 50, 500).ratio == pytest.approx(rows, rel=0.35)


def test_the_parameters_of_the_effect_and_the_long_blocks_are_counted() -> None:
    found = variance_along([correlated(0, 200)] * 3, OF_EFFECT, PRECISION, 50, 500)
    assert (found.parameters, found.blocks) == (1, 24)


def test_a_machine_that_diverges_reaches_any_gain_by_chance() -> None:
    run = correlated(0, 200)
    run.residual[-1] = np.inf
    assert variance_along([run], OF_EFFECT, PRECISION, 50, 500).ratio == np.inf
