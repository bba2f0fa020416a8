"""Fits in which each run has another observer: which one, what it is worth, and when it is not used."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification.fit.covariance import with_uncertainty
from hframe_gym.identification.fit.estimation import prediction_costs
from hframe_gym.identification.fit.model_error import fit_with_model_error
from hframe_gym.identification.fit.run_observers import fit_run_by_run
from hframe_gym.machine import Machine
from hframe_gym.preparation.dataset import RunObserver
from tests.identification.fit.test_model_error import fitted_axis, recordings


@pytest.mark.parametrize("force", [0.02, 0.3])
def test_runs_without_model_error_determine_the_parameters(axis: Machine, force: float) -> None:
    """Two runs with a random force (N) beside two without it; an observer common to all spoils the latter."""
    data = recordings(axis, residue=(0.0, force, 0.0, force))
    common = fit_with_model_error(fitted_axis(axis, data), data)
    fitted = fit_run_by_run(common, data)
    assert fitted.bandwidth == common.bandwidth == 60.0
    observers = [fitted.observers[f"run_{k}"] for k in range(4)]
    assert [observer.bandwidth for observer in observers] == [0.0, 60.0, 0.0, 60.0]
    assert all(observer.inflation < 1.05 for observer in observers[::2])
    assert (observers[3].inflation > 2.0) == (force > 0.1)
    errors = [f.machine.parameters["x.mass"] / axis.parameters["x.mass"] - 1.0 for f in (fitted, common)]
    assert abs(errors[0]) < 0.1 * abs(errors[1])
    machines = [with_uncertainty(f, data) for f in (fitted, common)]
    stds = [m.uncertainty.std("x.mass") for m in machines if m.uncertainty is not None]
    assert stds[0] < 0.2 * stds[1]


@pytest.mark.parametrize("force", [0.0, 0.1])
def test_the_standard_deviation_holds_with_an_observer_for_each_run(axis: Machine, force: float) -> None:
    data = recordings(axis, residue=(0.0, force, 0.0, force))
    machine = with_uncertainty(
        fit_run_by_run(fit_with_model_error(fitted_axis(axis, data), data), data), data
    )
    assert machine.uncertainty is not None
    for name in ("x.mass", "x.coulomb", "x.viscous"):
        std = machine.uncertainty.std(name)
        assert std is not None
        assert abs(machine.parameters[name] - axis.parameters[name]) < 3.0 * std


def test_runs_without_model_error_are_not_fitted_again(axis: Machine) -> None:
    data = recordings(axis)
    best = fit_with_model_error(fitted_axis(axis, data), data)
    assert best.bandwidth == 0.0
    assert fit_run_by_run(best, data) is best


def test_a_run_with_an_observer_is_predicted_with_it(axis: Machine) -> None:
    data = recordings(axis, residue=0.3)
    observed = data.with_observers({"run_1": RunObserver(30.0, 4.0)})
    costs = prediction_costs(axis, observed, 0.0)
    assert costs[1] == pytest.approx(prediction_costs(axis, data, 30.0)[1] / 4.0)
    np.testing.assert_array_equal(np.delete(costs, 1), np.delete(prediction_costs(axis, data, 0.0), 1))
