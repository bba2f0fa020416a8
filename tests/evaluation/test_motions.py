"""Tests of the motions that `hframe evaluate --motions` writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hframe_gym.evaluation import Episodes, write_motions
from hframe_gym.machine import BUILTIN_MACHINES


def test_a_motion_has_each_sample_with_the_voltages_of_its_period(tmp_path: Path) -> None:
    rng, samples, periods = np.random.default_rng(1), 21, 2
    position, goal = rng.normal(size=(2, 3, samples, 2))
    volts = rng.normal(size=(3, periods, 2))
    time_s = np.arange(samples) * 1e-3
    episodes = Episodes(time_s, position, goal, None, volts, np.ones(2), np.zeros(3), np.zeros(3))
    path = tmp_path / "pid.csv"
    write_motions(path, episodes, BUILTIN_MACHINES["hframe"](), count=2)
    assert path.read_text().splitlines()[0] == "episode,time_s,x_m,y_m,x_goal_m,y_goal_m,v1_V,v2_V"
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    assert table.shape == (2 * samples, 8)
    second = table[samples:]
    assert (second[:, 0] == 1).all()
    assert np.allclose(second[:, 1], time_s)
    assert np.allclose(second[:, 2:4], position[1])
    assert np.allclose(second[:, 4:6], goal[1])
    assert np.allclose(second[9, 6:], volts[1, 0])
    assert np.allclose(second[10, 6:], volts[1, 1])
    assert np.allclose(second[20, 6:], volts[1, 1])
