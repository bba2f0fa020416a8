"""Fixtures of the controllers' tests."""

from __future__ import annotations

import copy

import pytest

from hframe_gym.controllers import AdaptiveController, ModelBasedController
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.controllers.closed_loop import PERIOD


@pytest.fixture(scope="session")
def hframe() -> Machine:
    """Return the 8th-order H-frame; machines are immutable."""
    return BUILTIN_MACHINES["hframe"]()


@pytest.fixture(scope="session")
def _designed(hframe: Machine) -> tuple[ModelBasedController, AdaptiveController]:
    """Return controllers of the H-frame whose design is copied, because it takes long."""
    return ModelBasedController(hframe, PERIOD), AdaptiveController(hframe, PERIOD)


@pytest.fixture
def model_based(_designed: tuple[ModelBasedController, AdaptiveController]) -> ModelBasedController:
    """Return a new model-based controller of the H-frame."""
    return copy.deepcopy(_designed[0])


@pytest.fixture
def adaptive(_designed: tuple[ModelBasedController, AdaptiveController]) -> AdaptiveController:
    """Return a new adaptive controller of the H-frame."""
    return copy.deepcopy(_designed[1])
