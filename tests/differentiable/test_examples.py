"""The programs in examples/ that differentiate motions, with few updates."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
import torch

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def load(name):
    specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_optimized_voltages_reach_the_goal():
    voltages, distance, speed = load("trajectory_optimization").optimize(150)
    assert distance < 1e-3
    assert speed < 0.01
    assert voltages.abs().max() > 1.0


@pytest.mark.integration
def test_fitted_parameters_explain_the_recordings():
    parameters, before, after = load("parameter_fit").fit(EXAMPLES / "rig_b", 25)
    assert after < 0.05 * before
    assert parameters["x.mass"] == pytest.approx(4.5, rel=0.15)


@pytest.mark.integration
def test_a_trained_policy_reaches_the_goals():
    _, medians = load("policy_gradient").train(20)
    assert medians[0] > 0.05
    assert medians[-1] < 1e-2
