from __future__ import annotations

import numpy as np

from hframe_gym.controllers import MotionModel
from hframe_gym.dynamics import rollout, simulate
from hframe_gym.effects.cogging import EFFECT as COGGING
from hframe_gym.effects.constant_force import EFFECT as CONSTANT_FORCE
from hframe_gym.machine import BUILTIN_MACHINES, Machine

RADIUS = 0.0194


def test_state_is_travel_in_the_machines_order(hframe: Machine) -> None:
    values = np.array([[0.1, -0.05, 2.0, 3.0, 0.2, 0.3, 10.0, 20.0]])
    state = MotionModel(hframe).state({"observation": values})
    expected = [0.1, -0.05, 2 * RADIUS, 3 * RADIUS, 0.2, 0.3, 10 * RADIUS, 20 * RADIUS]
    np.testing.assert_allclose(state[0], expected)


def test_axes_decouple_through_sum_and_difference(hframe: Machine) -> None:
    """x takes v1 and v2 of opposite sign, y of the same."""
    model = MotionModel(hframe)
    along_x, along_y = model.voltage(np.array([[10.0, 0.0], [0.0, 10.0]]))
    assert along_x[0] == -along_x[1] < 0.0
    assert along_y[0] == along_y[1] < 0.0


def test_goal_state_has_unstretched_belts(hframe: Machine) -> None:
    state = MotionModel(hframe).goal_state(np.array([[0.1, -0.05]]))[0]
    stretch = [hframe.row(belt.extension) @ state[:4] for belt in hframe.belts]
    np.testing.assert_allclose(stretch, 0.0, atol=1e-12)


def test_disturbance_sees_friction_whatever_the_belts_do(hframe: Machine) -> None:
    """In a cruise along y the unexplained force is the Coulomb friction of the cart and both motors."""
    time = 0.01 * np.arange(21)
    volts = np.full((21, 2), -6.0)
    softer = hframe.replace({f"{belt.name}.EA": 0.7 * belt.EA for belt in hframe.belts})
    for machine in (hframe, softer):
        states = rollout(machine, time, volts, velocities=True)[0] * np.tile(machine.radii, 2)
        force = MotionModel(hframe).disturbance(states[19:20], states[20:21], volts[:1], 0.01)[0]
        assert abs(force[1] + 0.4 + 2 * 0.05 / RADIUS) < 0.1


def test_held_stretch_holds_the_tool_against_a_force() -> None:
    """With the motors there, and the voltages that hold them, the simulated stage stays where it is."""
    machine = BUILTIN_MACHINES["hframe"]()
    frictionless = machine.replace({name: 0.0 for name in machine.parameters if name.endswith(".coulomb")})
    pushed = frictionless.with_effects(CONSTANT_FORCE.at("x", size=20.0), CONSTANT_FORCE.at("y", size=-10.0))
    model = MotionModel(pushed)
    goal = np.array([[0.1, -0.05]])
    state = model.goal_state(goal)
    force = model.pushes(state, np.zeros(1))
    state[:, :4] += model.held_stretch(force, goal)
    volts = -model.voltage(force @ model.rigid)
    run = simulate(pushed, 0.01 * np.arange(11), np.repeat(volts, 11, axis=0), state[0] / np.tile(pushed.radii, 2))
    np.testing.assert_allclose(run.positions[:, :2], np.repeat(goal, 11, axis=0), atol=3e-6)
    assert np.abs(model.held_stretch(force, goal)[0, 2:]).max() > 1e-4


def test_top_speed_is_that_of_the_simulated_stage() -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    time = 0.01 * np.arange(16)
    states = rollout(machine, time, np.full((16, 2), -12.0), velocities=True, start=None)[0]
    assert abs(MotionModel(machine).top_speed()[1] - states[-1, 5]) < 0.02


def test_a_motors_torque_pushes_its_belt(hframe: Machine) -> None:
    model = MotionModel(hframe.with_effects(COGGING.at("motor1", A=0.03, n=24.0, p=0.5)))
    state = model.state({"observation": np.array([[0.0, 0.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0]])})
    force = model.pushes(state, np.zeros(1))
    np.testing.assert_allclose(force, [[0.0, 0.0, 0.03 * np.sin(24.0 * 2.0 + 0.5) / RADIUS, 0.0]])
