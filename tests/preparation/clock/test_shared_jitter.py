"""Tests of the jitter that two encoders confirm."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.preparation.clock.jitter import shared_jitter

PERIOD, ROWS, JITTER = 2e-3, 2000, 20e-6
ROUNDING = 2.0 * np.pi / 8000.0  # rad


def angles(time_s: Array, opposed: bool = True) -> list[Array]:
    """Return the angles of two motors that turn alike, or by turns alike and against each other, (n,)."""
    alike = 8.0 * np.sin(7.0 * time_s)
    against = 8.0 * np.sin(5.0 * time_s + 1.0) if opposed else 0.0 * time_s
    return [alike + against, alike - against]


def measured(sampled: Array, *, opposed: bool = True, vibrations: Array | float = 0.0) -> list[list[Array]]:
    """Return one run of each encoder, sampled at these times, shape (n,)."""
    exact = angles(sampled, opposed)
    exact[0] = exact[0] + vibrations
    return [[np.round(values / ROUNDING) * ROUNDING] for values in exact]


def test_jitter_shows_at_both_encoders() -> None:
    rng = np.random.default_rng(1)
    stamps = PERIOD * np.arange(ROWS)
    runs = measured(stamps + rng.normal(0.0, JITTER, ROWS))
    assert shared_jitter([stamps], *runs) == pytest.approx(JITTER, rel=0.15)


@pytest.mark.parametrize("common", [False, True])
def test_an_error_of_the_encoders_is_no_jitter(common: bool) -> None:
    """That of one encoder, or one that both have in the same direction, as large as that of the jitter."""
    rng = np.random.default_rng(2)
    stamps = PERIOD * np.arange(ROWS)
    errors = rng.normal(0.0, 60.0 * JITTER, ROWS)
    runs = measured(stamps, vibrations=errors)
    if common:
        runs[1][0] = runs[1][0] + errors
    assert shared_jitter([stamps], *runs) < 0.25 * JITTER


def test_encoders_that_only_turn_alike_confirm_nothing() -> None:
    rng = np.random.default_rng(3)
    stamps = PERIOD * np.arange(ROWS)
    runs = measured(stamps + rng.normal(0.0, JITTER, ROWS), opposed=False)
    assert shared_jitter([stamps], *runs) == 0.0
    assert shared_jitter([stamps[:20]], *([values[0][:20]] for values in runs)) == 0.0
