"""Models that differ from the simulated machine: what differs in each condition, and the comparison."""

import numpy as np

from benchmarks import model_error
from benchmarks.gap.plants import declared_machine
from hframe_gym.evaluation import episode_conditions


def test_only_the_simulated_machine_differs_from_the_model():
    model = declared_machine()
    exact, parameters, effects = (
        episode_conditions(model_error.scenario(condition, 3)) for condition in model_error.CONDITIONS
    )
    np.testing.assert_array_equal(exact.parameters, np.tile(list(model.parameters.values()), (3, 1)))
    assert not np.array_equal(parameters.parameters[0], parameters.parameters[1])
    assert len(effects.machine.effects) > len(model.effects)
    assert model_error.controller("pid", model).machine == model


def test_the_gain_compares_an_exact_model_with_the_worst(monkeypatch):
    times = {"exact": [0.2, 0.4], "parameters": [0.3, 0.5], "effects": [0.4, 0.6]}
    monkeypatch.setattr(model_error, "scenario", lambda condition, draws: times[condition][:draws])
    monkeypatch.setattr(model_error, "settling_s", lambda name, model, settings: np.array(settings))
    row = model_error.row("pid", 2)
    np.testing.assert_allclose(row["gain"], [0.4, 0.4, 0.4])
    np.testing.assert_allclose(row["exact"][0], 0.3)


def test_on_other_machines_the_exact_model_is_the_simulated_machine(monkeypatch):
    def times(name, model, settings):
        exact = model == settings.machine
        assert exact or model == declared_machine()
        return np.array([0.1, 0.2, 0.3]) if exact else np.array([0.2, 0.4, 1.5])

    monkeypatch.setattr(model_error, "settling_s", times)
    row = model_error.row_of_machines("pid", 3)
    np.testing.assert_allclose(row["gain"], np.full(3, 1.0 - 0.2 / 0.7))
    np.testing.assert_allclose(row["median_gain"], np.full(3, 0.5))
    assert row["failed"] == [len(model_error.MACHINES), 0]
