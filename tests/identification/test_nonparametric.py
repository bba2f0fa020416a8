"""Tests of tables: found if the missing force depends on their variable, even where a single run shows it."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, Fit, SelectionCriteria, default_free_parameters, fit, prepare
from hframe_gym.identification.nonparametric import add_tables
from hframe_gym.identification.prediction import SEARCH_BANDWIDTH
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording

pytestmark = pytest.mark.unit
NOISE = 20e-6  # m


@pytest.fixture
def axis() -> Machine:
    """Return the built-in axis."""
    return BUILTIN_MACHINES["axis"]()


def runs_with_cable(axis: Machine, stiffness: float, offsets: tuple[float, ...]) -> tuple[Fit, Dataset]:
    """Return a fit of the axis without its cable to runs that oscillate; an offset, V, moves a run to one side."""
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
    """Only the last of five runs reaches large positions, so that no other run predicts the cable's force there."""
    fitted, data = runs_with_cable(axis, 40.0, (0.0, 0.3, -0.3, 0.2, 3.0))
    with_table, tables = add_tables(fitted, (), data, criteria=SelectionCriteria(), max_tables=1, log=lambda line: None)
    assert [s.effect.label for s in tables] == ["smooth_force[position of x]@x"]
    assert with_table.chi2 < 0.1 * fitted.chi2


def test_no_table_for_a_force_that_differs_between_runs(axis: Machine) -> None:
    """A constant force that is drawn anew for every run depends on none of the variables of tables."""
    random = np.random.default_rng(1)
    time_s = np.arange(2000) * 1e-3
    recordings = []
    for k in range(6):
        rig = axis.with_effects(EFFECTS["constant_force"].at("x", size=float(random.choice([-1.0, 1.0]))))
        inputs = np.where(time_s > 0.1, 1.5 * np.sin((8 + k) * time_s) + 0.7 * np.sin(31 * time_s + k), 0.0)[:, None]
        measured = rig.simulate(time_s, inputs).outputs + random.normal(0.0, NOISE, (2000, 1))
        recordings.append(Recording(f"run_{k}", time_s, inputs, measured))
    data = prepare(recordings, axis)
    fitted = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    assert fitted.chi2 > 5.0
    unchanged, tables = add_tables(fitted, (), data, criteria=SelectionCriteria(), max_tables=1, log=lambda line: None)
    assert tables == ()
    assert unchanged is fitted
