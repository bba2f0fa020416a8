from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification import prepare
from hframe_gym.identification.dataset import quantum_of
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording


def test_a_quantum_is_found_and_noise_has_none() -> None:
    rng = np.random.default_rng(0)
    smooth = np.cumsum(rng.normal(0, 2e-3, 3000))
    assert quantum_of(np.round(smooth / 5e-4) * 5e-4) == pytest.approx(5e-4)
    assert quantum_of(smooth) == 0.0
    assert quantum_of(np.full(100, np.nan)) == 0.0


def test_noise_comes_from_the_resting_rows_else_from_the_declaration(hframe: Machine) -> None:
    rng = np.random.default_rng(1)
    outputs = np.zeros((400, 4))
    outputs[:, 2] = rng.normal(0, 35e-6, 400)
    outputs[:, 3] = rng.normal(0, 12e-6, 400)
    time = np.arange(400) * 1e-3
    resting = Recording("r", time, np.zeros((400, 2)), outputs)
    noise = prepare([resting], hframe).noise
    assert noise[2] == pytest.approx(35e-6, rel=0.1)
    assert noise[3] == pytest.approx(12e-6, rel=0.1)
    driven = Recording("r", time, np.ones((400, 2)), outputs)
    assert prepare([driven], hframe).noise[2] == hframe.sensors[2].noise
