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
    assert model_error.controller("pid").machine == model


def test_the_gain_compares_an_exact_model_with_the_worst(monkeypatch):
    times = {"exact": [0.2, 0.4], "parameters": [0.3, 0.5], "effects": [0.4, 0.6]}
    monkeypatch.setattr(
        model_error, "settling_s", lambda name, condition, draws: np.array(times[condition][:draws])
    )
    row = model_error.row("pid", 2)
    np.testing.assert_allclose(row["gain"], [0.4, 0.4, 0.4])
    np.testing.assert_allclose(row["exact"][0], 0.3)
