"""Tests of the minimum-energy transfers and of the tracking of previewed goals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hframe_gym.controllers import (
    MinimumEnergyTransfers,
    ModelBasedController,
    MotionModel,
    OperatingPointGrid,
    PreviewGains,
    TextbookPID,
    TransferDesign,
    scaled_machine,
)
from hframe_gym.controllers.planning.finite_horizon_control import VOLTAGE_CHANGE_WEIGHT
from hframe_gym.dynamics import rollout, simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.machine import BUILTIN_MACHINES, Drive, Machine
from tests.controllers.closed_loop import PERIOD, PREVIEW, circles, closed_loop, random_stages

RATED = np.array([12.0, 12.0])
LIMITS = (-RATED[None], RATED[None])


@pytest.fixture(scope="module")
def transfers(hframe: Machine) -> MinimumEnergyTransfers:
    """Return the transfers of the H-frame at 10 ms; they have no memory."""
    return MinimumEnergyTransfers(MotionModel(hframe), 0.01)


def test_transfers_stop_the_simulated_stage_with_its_belts_at_rest() -> None:
    """On the linear machine, voltages planned anew in each period end at the goal, open loop."""
    machine = BUILTIN_MACHINES["hframe-linear"]()
    transfers = MinimumEnergyTransfers(MotionModel(machine), 0.01)
    model, goal = transfers.model, np.array([[0.12, -0.08]])
    A, B, _ = model.discretize(goal[0], transfers.period)
    error, periods, planned = -model.goal_state(goal), transfers.longest, []
    while periods > transfers.shortest:
        periods, volts = transfers.select(error, goal, LIMITS, np.array([transfers.shortest]))
        planned.append(volts[0])
        error = error @ A.T + volts @ B.T
    for _ in range(transfers.shortest - 1):  # the gain of the shortest transfer is deadbeat
        planned.append(transfers.select(error, goal, LIMITS, periods).volts[0])
        error = error @ A.T + planned[-1] @ B.T
    assert 0.9 * 12.0 < np.abs(planned).max() <= 12.0
    rest = np.zeros((20, 2))
    motion = simulate(machine, 0.01 * np.arange(len(planned) + len(rest)), np.vstack([planned, rest]))
    np.testing.assert_allclose(motion.positions[len(planned) :, :2], np.tile(goal, (20, 1)), atol=2e-6)


@pytest.mark.parametrize(("name", "period"), [("corexy", 0.01), ("belt-axis", 0.01), ("corexy", 0.012)])
def test_belts_that_vibrate_above_half_the_control_rate_are_rigid_in_the_gains(
    name: str, period: float
) -> None:
    """The gains of an operating point stay stable where the belts are stiffer or softer by a tenth."""
    machine = BUILTIN_MACHINES[name]()
    design = TransferDesign(MotionModel(machine), period)
    middle = int(design.grid.nearest(np.zeros((1, len(machine.tool_axes))))[0])
    gain = design.first_gains([0], [middle])[0, 0]
    for stiffness in (0.9, 0.95, 1.0, 1.05, 1.1):
        A, B, _ = MotionModel(scaled_machine(machine, stiffness, 1.0)).discretize(
            design.grid.points[middle], period
        )
        assert np.abs(np.linalg.eigvals(A + B @ gain)).max() < 1.0


def test_controls_belts_that_vibrate_above_half_the_control_rate() -> None:
    machine = BUILTIN_MACHINES["corexy"]()
    controller = ModelBasedController(machine, 0.01)
    env = HFrameVectorEnv(32, machine=machine)
    observation, info = env.reset(seed=0)
    for _ in range(100):
        observation, *_, info = env.step(controller.act(observation))
    assert np.all(info["distance_m"] < 2e-4)


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


def test_gains_of_some_transfers_are_those_of_the_complete_design(transfers: MinimumEnergyTransfers) -> None:
    """Durations and operating points may be in any order."""
    some = TransferDesign(transfers.model, transfers.period).first_gains([12, 0], [31, 5])
    np.testing.assert_array_equal(some, transfers.gains[[31, 5]][:, [12, 0], 0])


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


def test_a_drive_without_back_emf_is_braked_in_time() -> None:
    """Its top speed is far beyond what it reaches in the workspace: the longest motion accelerates."""
    motor = BUILTIN_MACHINES["motor"]()
    drive = Drive("motor", "torque_Nm", "shaft", 1.0, 0.0, 1.0, 1.0, rated_voltage=0.05, kind="torque")
    machine = motor.with_components(replace(motor.coordinate("shaft"), viscous=1e-7)).replace(drives=(drive,))
    controller = ModelBasedController(machine, 0.005)
    env = HFrameVectorEnv(1, machine=machine, period=0.005)
    observation, _ = env.reset(options={"start": (-5.0,), "target": (5.0,)})
    largest = -5.0
    for _ in range(100):
        observation = env.step(controller.act(observation))[0]
        largest = max(largest, observation["achieved_goal"][0, 0])
    assert largest < 5.3
    assert abs(observation["achieved_goal"][0, 0] - 5.0) < 1e-3


def test_shortest_transfer_depends_on_the_period(hframe: Machine, transfers: MinimumEnergyTransfers) -> None:
    assert transfers.shortest == 4  # eight states, two drives
    assert 0.01 < 0.002 * MinimumEnergyTransfers(MotionModel(hframe), 0.002).shortest < 0.02


@pytest.mark.integration
def test_tracks_a_circle_on_the_nominal_machine(hframe: Machine, model_based: ModelBasedController) -> None:
    goals = circles(16, 1)
    loop = closed_loop(model_based, hframe, goals[:, 0], goals)
    assert np.sqrt(np.mean(loop.error[:, 40:] ** 2)) < 1.5e-5
    assert np.abs(loop.actions).max() <= 1.0


def test_tracks_circles_on_randomized_machines(hframe: Machine, model_based: ModelBasedController) -> None:
    goals, changes = circles(64, 2), random_stages(hframe, 64, 3)
    loop = closed_loop(model_based, hframe, goals[:, 0], goals, changes=changes)
    assert np.sqrt(np.mean(loop.error**2)) < 1e-4
    textbook = closed_loop(TextbookPID(hframe, PERIOD), hframe, goals[:, 0], goals, changes=changes)
    assert np.mean(textbook.error**2) > 100.0 * np.mean(loop.error**2)


def test_known_teeth_that_pass_faster_than_the_periods_make_paths_better(
    hframe: Machine, model_based: ModelBasedController
) -> None:
    """Their force in the middle of each period would double the error: 76 instead of 38 um."""
    toothed = hframe.with_effects(EFFECTS["cogging"].at("motor1", A=0.06, n=61.0, p=0.0))
    goals = circles(8, 0)
    known, unknown = (
        closed_loop(controller, toothed, goals[:, 0], goals).error[:, 40:]
        for controller in (ModelBasedController(toothed, PERIOD), model_based)
    )
    assert np.sqrt(np.mean(known**2)) < 0.7 * np.sqrt(np.mean(unknown**2))


@pytest.mark.oracle
def test_the_plan_is_the_least_squares_solution() -> None:
    """The reference is SciPy's solver, with the tool's responses from simulations of the linear machine."""
    machine = BUILTIN_MACHINES["hframe-linear"]()
    grid = OperatingPointGrid(machine)
    middle = int(grid.nearest(np.zeros((1, 2)))[0])
    horizon = 6
    gains = PreviewGains(MotionModel(machine), grid, PERIOD, horizon, VOLTAGE_CHANGE_WEIGHT)
    time = PERIOD * np.arange(horizon + 1)

    def tool_path(start: np.ndarray, volts: np.ndarray) -> np.ndarray:
        held = np.vstack([volts, np.zeros((1, 2))])
        return rollout(machine, time, held, start=start, longest_step=2e-5)[0, 1:, :2].ravel()

    start = np.array([1e-3, -2e-3, 0.05, -0.1, 0.1, 0.05, -8.0, 3.0])
    free = tool_path(start, np.zeros((horizon, 2)))
    unit_volts = np.eye(2 * horizon).reshape(-1, horizon, 2)
    response = np.array([tool_path(start, volts) - free for volts in unit_volts]).T
    goals = np.random.default_rng(0).normal(0.0, 5e-3, 2 * horizon)
    last = np.array([2.0, -1.0])
    difference = np.eye(2 * horizon) - np.eye(2 * horizon, k=-2)
    before = np.concatenate([last, np.zeros(2 * horizon - 2)])
    A = np.vstack([response, VOLTAGE_CHANGE_WEIGHT * difference])
    b = np.concatenate([goals - free, VOLTAGE_CHANGE_WEIGHT * before])
    expected = lsq_linear(A, b).x[:2]
    state = start * np.tile(machine.travel_per_unit, 2)
    volts = gains.state[middle] @ state + gains.goal[middle] @ goals + gains.last[middle] @ last
    np.testing.assert_allclose(volts, expected, rtol=2e-3)


def test_a_batch_equals_batches_of_one(hframe: Machine, model_based: ModelBasedController) -> None:
    goals, changes = circles(3, 4, periods=40), random_stages(hframe, 3, 5)
    batch = closed_loop(model_based, hframe, goals[:, 0], goals, changes=changes, periods=40)
    for b in range(3):
        parameters = {name: values[b : b + 1] for name, values in changes.items()}
        single = closed_loop(
            model_based, hframe, goals[b : b + 1, 0], goals[b : b + 1], changes=parameters, periods=40
        )
        np.testing.assert_allclose(single.actions[0], batch.actions[b], rtol=0.0, atol=1e-9)


def test_a_previewed_goal_that_does_not_move_is_held(
    hframe: Machine, model_based: ModelBasedController
) -> None:
    goals = np.tile(np.array([[[0.05, -0.02]]]), (2, 41 + PREVIEW, 1))
    loop = closed_loop(model_based, hframe, goals[:, 0], goals, periods=40)
    assert loop.error.max() < 1e-9


@pytest.mark.parametrize("period", [0.002, 0.005])
def test_gains_of_other_periods_bring_the_model_to_the_goal(hframe: Machine, period: float) -> None:
    """The closed loop of the gains and the linear model settles on a goal that is a millimeter away."""
    model, grid = MotionModel(hframe), OperatingPointGrid(hframe)
    middle = int(grid.nearest(np.zeros((1, 2)))[0])
    horizon = round(0.1 / period)
    gains = PreviewGains(model, grid, period, horizon, VOLTAGE_CHANGE_WEIGHT)
    A, B, _ = model.discretize(grid.points[middle], period)
    goal = np.array([1e-3, 0.0])
    state, volts = np.zeros(8), np.zeros(2)
    for _ in range(round(0.5 / period)):
        feedforward = gains.goal[middle] @ np.tile(goal, horizon)
        volts = gains.state[middle] @ state + feedforward + gains.last[middle] @ volts
        state = A @ state + B @ volts
    np.testing.assert_allclose(model.tool_position(state[None])[0], goal, atol=1e-9)
