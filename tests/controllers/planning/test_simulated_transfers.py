"""Tests of transfers that are planned for machines with different parameters and corrected by simulations."""

import numpy as np
import pytest

from hframe_gym.controllers import MinimumEnergyTransfers, MotionModel, SimulatedTransfers
from hframe_gym.controllers.planning import simulated_transfers
from hframe_gym.dynamics import rollout
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from tests.controllers.different_machines import COUNT, different_machines

MACHINE = BUILTIN_MACHINES["hframe"]()
MODEL = MotionModel(MACHINE)
PERIOD = 0.01
UNITS = np.tile(MACHINE.travel_per_unit, 2)


def test_gains_for_the_declared_machine_are_those_of_the_minimum_energy_transfers():
    designed = MinimumEnergyTransfers(MODEL, PERIOD)
    longer = [0, 1, 4, 16, 40]
    goal = designed.grid.points[::10]
    parameters = np.tile(list(MACHINE.parameters.values()), (len(goal), 1))
    transfers = SimulatedTransfers(MODEL, PERIOD, [designed.shortest + extra for extra in longer])
    gains = transfers.plan(MODEL.goal_state(goal), goal, parameters, np.zeros((len(goal), 2))).gains
    for k, extra in enumerate(longer):
        expected = designed.gains[::10, extra, 0]
        # The shortest ones differ by the final error that is as costly as a volt.
        assert np.abs(gains[:, k] - expected).max() < 0.02 * np.abs(expected).max()


def test_the_gains_are_the_derivatives_of_the_voltages_by_the_state():
    generator = np.random.default_rng(0)
    parameters, goal = different_machines(MACHINE), generator.uniform(-0.05, 0.05, (COUNT, 2))
    state = MODEL.goal_state(goal)
    # Friction does not reverse.
    state[:, 4:] = generator.uniform(0.4, 0.6, (COUNT, 2)) * [1.0, 0.5] @ MODEL.rigid.T
    transfers, last = SimulatedTransfers(MODEL, PERIOD, [8, 20]), np.zeros((COUNT, 2))
    planned = transfers.plan(state, goal, parameters, last)
    change = generator.normal(size=(COUNT, 8)) * np.repeat([1e-5, 1e-4], 4)
    changed = transfers.plan(state + change, goal, parameters, last)
    expected = np.einsum("bkij,bj->bki", planned.gains, change)
    assert np.abs(changed.volts - planned.volts - expected).max() < 1e-3 * np.abs(expected).max()


def final_distances(machine, parameters):
    """Return the distances to the goal after six periods, from 2 mm, m, (COUNT,); each plans what remains."""
    model = MotionModel(machine)
    goal, last = np.zeros((COUNT, 2)), np.zeros((COUNT, 2))
    directions = np.linspace(0.0, 2.0 * np.pi, COUNT, endpoint=False)
    state = model.goal_state(2e-3 * np.stack([np.cos(directions), np.sin(directions)], axis=1))
    for periods in (6, 5, 4, 3, 3, 3):
        planned = SimulatedTransfers(model, PERIOD, [periods]).plan(state, goal, parameters, last)
        volts = planned.volts[:, 0].clip(-model.rated, model.rated)
        states = rollout(
            machine,
            np.array([0.0, 1e-9, PERIOD]),
            np.stack([last, volts, volts], axis=1),
            velocities=True,
            parameters=parameters,
            start=state / UNITS,
            longest_step=5e-4,
        )
        state, last = states[:, -1] * UNITS, volts
    return np.linalg.norm(model.tool_position(state), axis=1)


@pytest.mark.parametrize("delay_s", [0.0, 4e-3], ids=["no dead time", "dead time"])
def test_simulations_bring_the_tool_to_its_goal_despite_friction(delay_s, monkeypatch):
    machine = MACHINE.with_effects(EFFECTS["input_delay"].at("drives", d=delay_s)) if delay_s else MACHINE
    parameters = different_machines(machine)
    corrected = final_distances(machine, parameters)
    assert np.median(corrected) < 5e-5
    monkeypatch.setattr(simulated_transfers, "CORRECTIONS", 0)
    assert np.median(final_distances(machine, parameters)) > 1.5 * np.median(corrected)


def test_of_the_simulated_plans_the_one_that_ends_nearest_is_used(monkeypatch):
    """The first voltages come from a simulated plan, and no other such plan ends nearer to the goal."""
    generator, periods = np.random.default_rng(0), 4
    goal, last = np.zeros((COUNT, 2)), np.zeros((COUNT, 2))
    state = MODEL.goal_state(generator.uniform(-2e-3, 2e-3, (COUNT, 2)))
    transfers = SimulatedTransfers(MODEL, PERIOD, [periods])
    simulate, simulated = transfers._final_states, []

    def final_states(pulse, costates, *others):
        final = simulate(pulse, costates, *others)
        first = np.einsum("bis,bki->bks", pulse[:, periods - 1], costates)  # voltages of the first period
        distance = np.linalg.norm((final - MODEL.goal_state(goal)[:, None]) / transfers._scale, axis=2)
        simulated.append((first[:, 0], distance[:, 0]))
        return final

    monkeypatch.setattr(transfers, "_final_states", final_states)
    planned = transfers.plan(state, goal, different_machines(MACHINE), last)
    volts, distances = (np.stack(values) for values in zip(*simulated, strict=True))  # (simulations, B, ...)
    nearest = volts[np.argmin(distances, axis=0), np.arange(COUNT)]
    np.testing.assert_allclose(planned.volts[:, 0], nearest, rtol=1e-9)


@pytest.mark.parametrize("durations", [[], [0, 4], [5, 4], [4, 4]])
def test_durations_must_be_positive_and_ascending(durations):
    with pytest.raises(InputError, match="must be positive and ascending"):
        SimulatedTransfers(MODEL, PERIOD, durations)


def test_plans_know_how_a_load_swings():
    machine = MACHINE.with_effects(EFFECTS["payload_swing"].at("y", f0=1.8, zeta=0.05, r=0.3))
    model, goal = MotionModel(machine), np.zeros((1, 2))
    parameters = np.array([list(model.machine.parameters.values())])
    state, last = model.goal_state(np.array([[0.0, 1e-3]])), np.zeros((1, 2))
    transfers = SimulatedTransfers(model, PERIOD, [6])
    at_rest, swung = (
        transfers.plan(state, goal, parameters, last, memory).volts[0, 0]
        for memory in (None, np.array([[2e-2, 0.0]]))
    )
    # The deflected load pulls its carriage in the direction of y; the voltages hold against it.
    w = 2.0 * np.pi * 1.8
    pull = 0.3 * machine.coordinate("y").mass * w**2 * 2e-2
    held = model.voltage(np.array([[0.0, -pull]]))[0]
    np.testing.assert_allclose(swung - at_rest, held, rtol=0.4)
