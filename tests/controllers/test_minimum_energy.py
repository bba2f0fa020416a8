"""Tests of the minimum-energy transfers."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import MinimumEnergyTransfers, MotionModel
from hframe_gym.dynamics import simulate
from hframe_gym.machine import BUILTIN_MACHINES, Machine

RATED = np.array([12.0, 12.0])
LIMITS = (-RATED[None], RATED[None])


@pytest.fixture(scope="module")
def transfers(hframe: Machine) -> MinimumEnergyTransfers:
    """Return the transfers of the H-frame at 10 ms; they have no memory."""
    return MinimumEnergyTransfers(MotionModel(hframe), 0.01)


def test_reference_ends_at_the_goal_within_the_voltage(transfers: MinimumEnergyTransfers) -> None:
    path, volts = transfers.reference(np.array([-0.2, 0.1]), np.array([0.15, -0.05]), RATED)
    np.testing.assert_allclose(path[0], [-0.2, 0.1])
    np.testing.assert_allclose(path[-1], [0.15, -0.05], atol=1e-8)
    assert 0.9 * 12.0 < np.abs(volts).max() <= 12.0


def test_reference_stops_the_simulated_stage_with_its_belts_at_rest() -> None:
    """On the linear machine the voltages, applied open loop, stop the stage at its goal."""
    machine = BUILTIN_MACHINES["hframe-linear"]()
    transfers = MinimumEnergyTransfers(MotionModel(machine), 0.01)
    start, goal = np.array([0.0, 0.0]), np.array([0.12, -0.08])
    path, volts = transfers.reference(start, goal, RATED)
    rest = np.zeros((20, 2))
    time = 0.01 * np.arange(len(volts) + len(rest))
    motion = simulate(machine, time, np.vstack([volts, rest]))
    np.testing.assert_allclose(motion.positions[: len(volts), :2], path[:-1], atol=2e-6)
    np.testing.assert_allclose(motion.positions[len(volts) :, :2], np.tile(goal, (20, 1)), atol=2e-6)


def test_replanning_continues_the_transfer(transfers: MinimumEnergyTransfers) -> None:
    """From a state on a transfer, the shortest transfer is the rest of it."""
    model = transfers.model
    goal = np.array([[0.0, 0.0]])
    error = model.goal_state(np.array([[-0.2, 0.1]]))
    at_least = np.array([transfers.shortest])
    A, B, _ = model.discretize(goal[0], transfers.period)
    first = transfers.select(error, goal, LIMITS, at_least)
    second = transfers.select(error @ A.T + first.volts @ B.T, goal, LIMITS, at_least)
    assert second.periods[0] == first.periods[0] - 1


def test_longer_distances_take_longer(transfers: MinimumEnergyTransfers) -> None:
    distances = np.linspace(0.001, 0.25, 20)
    goal = np.zeros((20, 2))
    error = transfers.model.goal_state(np.stack([distances, np.zeros(20)], axis=1))
    periods = transfers.select(error, goal, LIMITS, np.full(20, transfers.shortest)).periods
    assert np.all(np.diff(periods) >= 0)
    assert periods[0] == transfers.shortest


def test_more_voltage_is_faster(transfers: MinimumEnergyTransfers) -> None:
    goal = np.zeros((1, 2))
    error = transfers.model.goal_state(np.array([[0.2, 0.1]]))
    at_least = np.array([transfers.shortest])
    slow, fast = (
        transfers.select(error, goal, (np.full((1, 2), -v), np.full((1, 2), v)), at_least).periods[0]
        for v in (6.0, 12.0)
    )
    assert fast < slow


def test_shortest_transfer_depends_on_the_period(hframe: Machine, transfers: MinimumEnergyTransfers) -> None:
    assert transfers.shortest == 4  # eight states, two drives
    assert 0.01 < 0.002 * MinimumEnergyTransfers(MotionModel(hframe), 0.002).shortest < 0.02
