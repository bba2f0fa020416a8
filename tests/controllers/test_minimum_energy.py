from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import MinimumEnergyTransfers, ModelBasedController, MotionModel
from hframe_gym.dynamics import simulate
from hframe_gym.machine import BUILTIN_MACHINES, Machine

RATED = np.array([12.0, 12.0])
LIMITS = (-RATED[None], RATED[None])


def test_reference_ends_at_rest_at_the_goal_within_the_voltage(pid: ModelBasedController) -> None:
    path, volts = pid.transfers.reference(np.array([-0.2, 0.1]), np.array([0.15, -0.05]), RATED)
    np.testing.assert_allclose(path[0], [-0.2, 0.1])
    np.testing.assert_allclose(path[-1], [0.15, -0.05], atol=1e-8)
    assert np.abs(volts).max() <= 12.0
    assert np.abs(volts).max() > 0.9 * 12.0


def test_reference_is_what_the_kernel_does_and_leaves_the_belts_at_rest() -> None:
    """On the linear machine the voltages of a transfer, played open loop, stop it at its goal."""
    machine = BUILTIN_MACHINES["hframe-linear"]()
    transfers = MinimumEnergyTransfers(MotionModel(machine), 0.01)
    start, goal = np.array([0.0, 0.0]), np.array([0.12, -0.08])
    path, volts = transfers.reference(start, goal, RATED)
    rest = np.zeros((20, 2))
    time = 0.01 * np.arange(len(volts) + len(rest))
    run = simulate(machine, time, np.vstack([volts, rest]))
    np.testing.assert_allclose(run.positions[: len(volts), :2], path[:-1], atol=2e-6)
    np.testing.assert_allclose(run.positions[len(volts) :, :2], np.tile(goal, (20, 1)), atol=2e-6)


def test_replanning_follows_the_reference(pid: ModelBasedController) -> None:
    """From a state on a transfer, the fastest transfer is the rest of it."""
    model = pid.model
    goal = np.array([[0.0, 0.0]])
    error = model.goal_state(np.array([[-0.2, 0.1]]))
    least = np.array([pid.transfers.shortest])
    A, B, _ = model.discretize(goal[0], pid.period)
    first = pid.transfers.choose(error, goal, LIMITS, least)
    second = pid.transfers.choose(error @ A.T + first.volts @ B.T, goal, LIMITS, least)
    assert second.periods[0] == first.periods[0] - 1


def test_longer_ways_take_longer(pid: ModelBasedController) -> None:
    ways = np.linspace(0.001, 0.25, 20)
    goal = np.zeros((20, 2))
    error = pid.model.goal_state(np.stack([ways, np.zeros(20)], axis=1))
    least = np.full(20, pid.transfers.shortest)
    periods = pid.transfers.choose(error, goal, LIMITS, least).periods
    assert np.all(np.diff(periods) >= 0)
    assert periods[0] == pid.transfers.shortest


def test_more_voltage_is_faster(pid: ModelBasedController) -> None:
    goal = np.zeros((1, 2))
    error = pid.model.goal_state(np.array([[0.2, 0.1]]))
    least = np.array([pid.transfers.shortest])
    slow, fast = (
        pid.transfers.choose(error, goal, (np.full((1, 2), -v), np.full((1, 2), v)), least).periods[0]
        for v in (6.0, 12.0)
    )
    assert fast < slow


def test_shortest_transfer_follows_the_sampling(hframe: Machine, pid: ModelBasedController) -> None:
    assert pid.transfers.shortest == 4  # eight states, two drives
    assert 0.01 < 0.002 * MinimumEnergyTransfers(MotionModel(hframe), 0.002).shortest < 0.02


def test_refuses_a_workspace_without_range(hframe: Machine) -> None:
    from dataclasses import replace

    coordinates = tuple(replace(c, range=None) for c in hframe.coordinates)
    with pytest.raises(ValueError, match="need a range"):
        MinimumEnergyTransfers(MotionModel(hframe.replace(coordinates=coordinates)), 0.01)
