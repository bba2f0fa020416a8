"""Fixtures of the controllers' tests."""

from __future__ import annotations

import pytest

from hframe_gym.controllers import ModelBasedController
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.controllers.closed_loop import PERIOD


@pytest.fixture(scope="session")
def hframe() -> Machine:
    """Return the 8th-order H-frame; machines are immutable."""
    return BUILTIN_MACHINES["hframe"]()


@pytest.fixture
def model_based(hframe: Machine) -> ModelBasedController:
    """Return a new model-based controller of the H-frame."""
    return ModelBasedController(hframe, PERIOD)
