"""Tests of the machine model of the controllers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.controllers import MotionModel, OperatingPointGrid
from hframe_gym.dynamics import rollout, simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Machine

RADIUS = 0.0194


def test_state_is_travel_in_the_order_of_the_machine(hframe: Machine) -> None:
    values = np.array([[0.1, -0.05, 2.0, 3.0, 0.2, 0.3, 10.0, 20.0]])
    model = MotionModel(hframe)
    state = model.state({"observation": values})
    expected = [0.1, -0.05, 2 * RADIUS, 3 * RADIUS, 0.2, 0.3, 10 * RADIUS, 20 * RADIUS]
    np.testing.assert_allclose(state[0], expected)
    np.testing.assert_allclose(model.observation(state), values)


def test_axes_decouple_through_sum_and_difference(hframe: Machine) -> None:
    """A force along x needs voltages of opposite sign, a force along y equal ones."""
    along_x, along_y = MotionModel(hframe).voltage(np.array([[10.0, 0.0], [0.0, 10.0]]))
    assert along_x[0] == -along_x[1] < 0.0
    assert along_y[0] == along_y[1] < 0.0


def test_goal_state_has_unstretched_belts(hframe: Machine) -> None:
    state = MotionModel(hframe).goal_state(np.array([[0.1, -0.05]]))[0]
    stretch = [hframe.coefficients(belt.extension) @ state[:4] for belt in hframe.belts]
    np.testing.assert_allclose(stretch, 0.0, atol=1e-12)


def test_disturbance_force_is_friction_whatever_the_belts_do(hframe: Machine) -> None:
    """In a cruise along y the disturbance is the Coulomb friction of the cart and of both motors."""
    time = 0.01 * np.arange(21)
    volts = np.full((21, 2), -6.0)
    softer = hframe.replace({f"{belt.name}.EA": 0.7 * belt.EA for belt in hframe.belts})
    for machine in (hframe, softer):
        states = rollout(machine, time, volts, velocities=True)[0] * np.tile(machine.travel_per_unit, 2)
        force = MotionModel(hframe).disturbance_force(states[19:20], states[20:21], volts[:1], 0.01)[0]
        assert abs(force[1] + 0.4 + 2 * 0.05 / RADIUS) < 0.1


def test_static_stretch_holds_the_tool_against_a_force(hframe: Machine) -> None:
    """The simulated stage stays where it is with the motors there and the voltages that hold them."""
    frictionless = hframe.replace({name: 0.0 for name in hframe.parameters if name.endswith(".coulomb")})
    constant_force = EFFECTS["constant_force"]
    pushed = frictionless.with_effects(constant_force.at("x", size=20.0), constant_force.at("y", size=-10.0))
    model = MotionModel(pushed)
    goal = np.array([[0.1, -0.05]])
    state = model.goal_state(goal)
    force = model.effect_force(state, np.zeros(1))
    state[:, :4] += model.static_stretch(force, goal)
    volts = -model.voltage(force @ model.rigid)
    initial = state[0] / np.tile(pushed.travel_per_unit, 2)
    motion = simulate(pushed, 0.01 * np.arange(11), np.repeat(volts, 11, axis=0), initial)
    np.testing.assert_allclose(motion.positions[:, :2], np.repeat(goal, 11, axis=0), atol=3e-6)
    assert np.abs(model.static_stretch(force, goal)[0, 2:]).max() > 1e-4


def test_top_speed_is_that_of_the_simulated_stage(hframe: Machine) -> None:
    time = 0.01 * np.arange(16)
    states = rollout(hframe, time, np.full((16, 2), -12.0), velocities=True, start=None)[0]
    assert abs(MotionModel(hframe).top_speed()[1] - states[-1, 5]) < 0.02


def test_torque_at_a_motor_is_a_force_on_its_belt(hframe: Machine) -> None:
    model = MotionModel(hframe.with_effects(EFFECTS["cogging"].at("motor1", A=0.03, n=24.0, p=0.5)))
    state = model.state({"observation": np.array([[0.0, 0.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0]])})
    force = model.effect_force(state, np.zeros(1))
    np.testing.assert_allclose(force, [[0.0, 0.0, 0.03 * np.sin(24.0 * 2.0 + 0.5) / RADIUS, 0.0]])


def test_friction_of_effects(hframe: Machine) -> None:
    """At 0.5 m/s the direction of motion is 1: by the formulas, -a b v and -dF exp(-(v/vs)^2)."""
    machine = hframe.with_effects(
        EFFECTS["asymmetric_viscous"].at("x", a=0.3), EFFECTS["stribeck_friction"].at("y", dF=2.0, vs=0.5)
    )
    model = MotionModel(machine)
    state = np.zeros((1, 8))
    state[0, 4:6] = 0.5
    expected = [-0.3 * machine.coordinate("x").viscous * 0.5, -2.0 * np.exp(-1.0), 0.0, 0.0]
    np.testing.assert_allclose(model.effect_friction(state, np.zeros(1))[0], expected, atol=1e-12)
    coulomb = np.array([machine.coordinate(name).coulomb for name in ("x", "y")])
    np.testing.assert_allclose(model.friction_force(state, np.zeros(1))[0, :2], expected[:2] - coulomb)


def test_effects_with_a_memory_are_left_out(hframe: Machine) -> None:
    presliding = EFFECTS["presliding"]
    values = {p.name: max(p.lower, min(1e-4, p.upper)) for p in presliding.parameters}
    with_memory, without = MotionModel(hframe.with_effects(presliding.at("x", **values))), MotionModel(hframe)
    state = np.random.default_rng(0).normal(0.0, 0.1, (3, 8))
    np.testing.assert_array_equal(
        with_memory.friction_force(state, np.zeros(3)), without.friction_force(state, np.zeros(3))
    )


def test_nearest_operating_point(hframe: Machine) -> None:
    grid = OperatingPointGrid(hframe)
    position = np.random.default_rng(1).uniform(-0.1, 0.1, (20, 2))
    distance = np.linalg.norm(grid.points[None] - position[:, None], axis=2)
    np.testing.assert_array_equal(grid.nearest(position), distance.argmin(axis=1))


def test_workspace_without_range_is_rejected(hframe: Machine) -> None:
    coordinates = tuple(dataclasses.replace(c, range=None) for c in hframe.coordinates)
    with pytest.raises(InputError, match="x and y must have a range"):
        OperatingPointGrid(hframe.replace(coordinates=coordinates))


def test_machine_without_full_state_measurement_is_rejected() -> None:
    with pytest.raises(InputError, match="the controllers need one or two axes, linear or rotary"):
        MotionModel(BUILTIN_MACHINES["hframe-order20"]())


def test_one_axis_has_one_row_of_operating_points() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    model, grid = MotionModel(axis), OperatingPointGrid(axis)
    assert (model.axes, model.rigid.shape, model.force_per_volt.shape) == (("x",), (1, 1), (1, 1))
    assert grid.points.shape == (9, 1)
    np.testing.assert_array_equal(grid.nearest(np.array([[-1.0], [0.01], [0.24]])), [0, 4, 8])


def test_friction_that_grows_with_the_drive_force_is_not_compensated(hframe):
    """The model knows position, velocity and time only; at 0 V back-EMF alone would determine friction."""
    model = MotionModel(hframe.with_effects(EFFECTS["load_friction"].at("motor1", mu=0.3)))
    state = np.array([[0.0, 0.0, 0.0, 0.0, 0.2, 0.1, -0.3, 0.1]])
    np.testing.assert_array_equal(model.effect_friction(state, np.zeros(1)), np.zeros((1, 4)))


def test_mean_force_of_teeth_is_that_of_the_whole_period(hframe: Machine) -> None:
    """At 0.3 m/s, 1.5 teeth of 2 mm pass in a period of 10 ms."""
    n, period, speed = 61.0, 0.01, 0.3 / RADIUS  # teeth a turn, s, rad/s
    model = MotionModel(hframe.with_effects(EFFECTS["cogging"].at("motor1", A=0.03, n=n, p=0.5)))
    middle = model.state({"observation": np.array([[0.0, 0.0, 2.0, 0.0, 0.0, 0.0, speed, 0.0]])})
    turned = 0.5 * n * speed * period
    mean = 0.03 * np.sin(n * 2.0 + 0.5) * np.sin(turned) / turned / RADIUS
    force = model.mean_effect_force(middle, np.zeros(1), period)
    np.testing.assert_allclose(force, [[0.0, 0.0, mean, 0.0]], rtol=0.05)
    assert abs(mean) < 0.25 * np.abs(model.effect_force(middle, np.zeros(1))).max()
