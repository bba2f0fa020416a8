"""Test the time-optimal motions with voltages that are held over control periods."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.machine import BUILTIN_MACHINES

pytestmark = pytest.mark.integration

pytest.importorskip("casadi")

from benchmarks.held_voltages import HeldVoltageReach  # noqa: E402
from hframe_gym.controllers.planning.time_optimal import TimeOptimalReach  # noqa: E402

BAND = 2e-4
HFRAME = BUILTIN_MACHINES["hframe"]()
START, GOAL = (-0.1, 0.05), (-0.06, 0.02)


@pytest.fixture(scope="module")
def free_s() -> float:
    """Return the duration of the motion whose voltages may change at any time, s."""
    return TimeOptimalReach(HFRAME, band=BAND).solve(START, GOAL).time_s


def test_held_voltages_cost_little_and_change_once_per_period(free_s: float) -> None:
    motion = HeldVoltageReach(HFRAME, 0.01, band=BAND).solve(START, GOAL, None, free_s)
    assert motion.solved
    assert free_s < motion.time_s < free_s + 0.01
    period = np.floor(0.5 * (motion.edges_s[:-1] + motion.edges_s[1:]) / 0.01)
    for k in np.unique(period):
        volts = motion.volts[period == k]
        np.testing.assert_allclose(volts, np.broadcast_to(volts[0], volts.shape), atol=1e-4)
    assert len(np.unique(np.round(motion.volts[:, 0], 3))) > 3


def test_held_voltages_approach_free_ones_as_the_period_shrinks(free_s: float) -> None:
    coarse, fine = (
        HeldVoltageReach(HFRAME, period, band=BAND).solve(START, GOAL, None, free_s)
        for period in (0.02, 0.005)
    )
    assert fine.solved
    assert coarse.solved
    assert free_s - 1e-4 < fine.time_s < coarse.time_s
