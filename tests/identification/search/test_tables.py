"""Tests of tables: found if the missing force depends on their variable, even where a single run shows it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.effects.smooth_table import KNOTS, definition
from hframe_gym.identification import (
    Dataset,
    Fit,
    SelectionCriteria,
    default_free_parameters,
    fit,
    prepare,
)
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.search.tables import (
    Table,
    add_tables,
    cost_ratio,
    knots_at_bends,
    proposed_tables,
)
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording

NOISE = 20e-6  # m


def runs_with_cable(axis: Machine, stiffness: float, offsets: tuple[float, ...]) -> tuple[Fit, Dataset]:
    """Return a fit of the axis without its cable to runs that oscillate, to one side by an offset, V."""
    rig = axis.with_effects(EFFECTS["cable_spring"].at("x", k=stiffness, q0=0.0))
    time_s = np.arange(2000) * 1e-3
    random = np.random.default_rng(0)
    recordings = []
    for k, offset in enumerate(offsets):
        swing = 1.5 * np.sin((8 + k) * time_s) + 0.7 * np.sin(31 * time_s + k) + offset * np.sin(2.0 * time_s)
        inputs = np.where(time_s > 0.1, swing, 0.0)[:, None]
        measured = rig.simulate(time_s, inputs).outputs + random.normal(0.0, NOISE, (2000, 1))
        recordings.append(Recording(f"run_{k}", time_s, inputs, measured))
    data = prepare(recordings, axis)
    return fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH), data


def test_a_table_may_have_values_that_a_single_run_determines(axis: Machine) -> None:
    """Only the last of five runs reaches large positions, so that no other predicts the cable's force."""
    fitted, data = runs_with_cable(axis, 40.0, (0.0, 0.3, -0.3, 0.2, 3.0))
    with_table, tables = add_tables(
        fitted, (), data, criteria=SelectionCriteria(), max_tables=1, log=lambda line: None
    )
    assert [s.effect.label for s in tables] == ["smooth_force[position of x]@x"]
    assert with_table.chi2 < 0.1 * fitted.chi2


def test_no_table_for_a_force_that_differs_between_runs(axis: Machine) -> None:
    """A constant force that is drawn anew for every run depends on none of the variables of tables."""
    random = np.random.default_rng(1)
    time_s = np.arange(2000) * 1e-3
    recordings = []
    for k in range(6):
        rig = axis.with_effects(EFFECTS["constant_force"].at("x", size=float(random.choice([-1.0, 1.0]))))
        inputs = np.where(time_s > 0.1, 1.5 * np.sin((8 + k) * time_s) + 0.7 * np.sin(31 * time_s + k), 0.0)[
            :, None
        ]
        measured = rig.simulate(time_s, inputs).outputs + random.normal(0.0, NOISE, (2000, 1))
        recordings.append(Recording(f"run_{k}", time_s, inputs, measured))
    data = prepare(recordings, axis)
    fitted = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    assert fitted.chi2 > 5.0
    unchanged, tables = add_tables(
        fitted, (), data, criteria=SelectionCriteria(), max_tables=1, log=lambda line: None
    )
    assert tables == ()
    assert unchanged is fitted


def test_force_and_friction_over_the_position_are_both_proposed() -> None:
    """Fitted friction hides a part of a force over the position, so that friction over it may rank higher."""
    ranks = {
        "smooth_force[velocity of x]": 0.9,
        "smooth_friction[path of x]": 0.8,
        "smooth_force[time]": 0.7,
        "smooth_friction[time]": 0.6,
        "smooth_friction[velocity of x]": 0.5,
        "smooth_friction[position of x]": 0.2,
        "smooth_force[position of x]": 0.1,
        "smooth_force[position of y]": 0.05,
    }
    ranked = [(rank, Table(name, "x", np.linspace(-1.0, 1.0, KNOTS))) for name, rank in ranks.items()]
    random = np.random.default_rng(0)
    shuffled = [ranked[k] for k in random.permutation(len(ranked))]
    names = list(ranks)
    for count, kept in ((2, [0, 1, 2, 5, 6]), (3, [0, 1, 2, 3, 5, 6]), (6, [0, 1, 2, 3, 4, 5, 6])):
        assert [t.effect for t in proposed_tables("x", shuffled, count)] == [names[k] for k in kept]


CENTER, WIDTH = 0.03, 0.006  # m


def catch(q: np.ndarray) -> np.ndarray:
    """Return the force of a magnetic catch much narrower than the travel, N."""
    z = (q - CENTER) / WIDTH
    return -3.0 * z * np.exp(0.5 - 0.5 * z * z)


def test_the_knots_of_a_table_move_to_a_narrow_bend(axis: Machine) -> None:
    """Evenly spaced knots are further apart than the catch is wide; moved ones reach a few percent."""
    dense = CENTER + WIDTH * np.linspace(-4.0, 4.0, KNOTS)
    truth = {f"k{i:02d}": k for i, k in enumerate(dense)} | {
        f"f{i:02d}": f for i, f in enumerate(catch(dense))
    }
    rig = axis.with_effects(definition("smooth_force[position of x]").at("x", **truth))
    time_s = np.arange(2000) * 1e-3
    random = np.random.default_rng(0)
    recordings = []
    for k in range(5):
        swing = 3.0 * np.sin((6 + k) * time_s) + 1.5 * np.sin(2.0 * time_s + k)
        inputs = np.where(time_s > 0.1, swing, 0.0)[:, None]
        measured = rig.simulate(time_s, inputs).outputs + random.normal(0.0, NOISE, (2000, 1))
        recordings.append(Recording(f"run_{k}", time_s, inputs, measured))
    data = prepare(recordings, axis)
    fitted = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    with_table, tables = add_tables(
        fitted, (), data, criteria=SelectionCriteria(), max_tables=1, log=lambda line: None
    )
    assert [s.effect.label for s in tables] == ["smooth_force[position of x]@x"]
    assert with_table.chi2 < 1.3
    p = tables[0].effect.parameters
    knots, values = (np.array([p[f"{key}{i:02d}"] for i in range(KNOTS)]) for key in "kf")
    q = np.linspace(CENTER - 0.05, CENTER + 0.05, 500)
    assert np.std(np.interp(q, knots, values) - catch(q)) < 0.1 * np.std(catch(q))


@pytest.mark.parametrize("bend", [0.0, 1.0])
def test_knots_are_dense_only_at_a_bend_that_noise_does_not_explain(bend: float) -> None:
    """A curve that is straight within its standard deviations keeps its knots."""
    knots = np.linspace(-1.0, 1.0, KNOTS)
    noise = 0.01 * np.cos(3.0 * np.arange(KNOTS))
    moved = knots_at_bends(knots, 2.0 + knots + noise + bend * np.abs(knots - 0.3), 0.02**2 * np.eye(KNOTS))
    assert (moved[0], moved[-1]) == pytest.approx((-1.0, 1.0))
    assert np.all(np.diff(moved) > 0.0)
    if bend:
        assert np.sum(np.abs(moved - 0.3) < 0.1) > KNOTS / 2
    else:
        np.testing.assert_array_equal(moved, knots)


def test_cross_validation_is_not_dominated_by_one_half_of_a_run() -> None:
    """A table that explains all halves but one is accepted, one that explains what needed none is not."""
    before = np.array([80.0, 90.0, 10.0, 0.0])  # a piece may have no valid measurement
    with_table, trivial = np.array([2.0, 2.0, 570.0, 0.0]), np.array([79.0, 89.0, 0.1, 0.0])
    expected = (2 / 80) ** (80 / 180) * (2 / 90) ** (90 / 180) * 57 ** (10 / 180)
    assert cost_ratio(with_table, before) == pytest.approx(expected)
    assert 0.7 < cost_ratio(trivial, before) < 1.0
    assert cost_ratio(np.array([1.0, math.inf, 1.0, 0.0]), before) == math.inf
