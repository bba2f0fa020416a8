from __future__ import annotations

import pytest
from closed_loop import PERIOD

from hframe_gym.control import ModelPID
from hframe_gym.machine import BUILTIN, Machine


@pytest.fixture(scope="session")
def hframe() -> Machine:
    return BUILTIN["hframe"]()


@pytest.fixture(scope="session")
def pid(hframe: Machine) -> ModelPID:
    return ModelPID(hframe, PERIOD)
