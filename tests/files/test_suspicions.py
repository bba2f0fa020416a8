from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.files import Recording, read_recordings, suspicions
from hframe_gym.machine import BUILTIN, Machine


@pytest.fixture
def run() -> Recording:
    return read_recordings("examples/rig_b", BUILTIN["hframe"]())[0]


def test_a_good_recording_raises_none(run: Recording, hframe: Machine) -> None:
    assert suspicions(run, hframe) == []


def test_each_suspicion(run: Recording, hframe: Machine) -> None:
    keep = np.ones(len(run.time_s), bool)
    keep[[500, 900]] = False
    dropped = Recording("r", run.time_s[keep], run.inputs[keep], run.outputs[keep])
    assert suspicions(dropped, hframe) == ["r: 2 gaps in time_s: samples were dropped"]
    jitter = np.random.default_rng(0).uniform(-1e-4, 1e-4, len(run.time_s))
    assert "sampling is irregular" in suspicions(dataclasses.replace(run, time_s=run.time_s + jitter), hframe)[0]
    still = run.inputs.copy()
    still[:, 1] = 0.0
    assert "v2_V never moves" in suspicions(dataclasses.replace(run, inputs=still), hframe)[0]
    clipped = run.outputs.copy()
    clipped[:, 2] = np.minimum(clipped[:, 2], np.quantile(clipped[:, 2], 0.7))
    [line] = suspicions(dataclasses.replace(run, outputs=clipped), hframe)
    assert "x_m stays at the end of its range" in line
