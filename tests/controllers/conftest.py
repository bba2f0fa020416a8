from __future__ import annotations

import pytest
from closed_loop import PERIOD

from hframe_gym.controllers import ModelBasedController
from hframe_gym.machine import BUILTIN_MACHINES, Machine


@pytest.fixture(scope="session")
def hframe() -> Machine:
    return BUILTIN_MACHINES["hframe"]()


@pytest.fixture(scope="session")
def pid(hframe: Machine) -> ModelBasedController:
    return ModelBasedController(hframe, PERIOD)
