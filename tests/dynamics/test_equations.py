"""The equations of motion on arrays and CasADi expressions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import (
    Equations,
    MotionPoint,
    belt_forces,
    belt_states,
    effect_forces,
    net_forces,
    sensor_readings,
    simulate,
)
from hframe_gym.dynamics.elementwise import tanh
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import AppliedEffect, Machine, rest_state
from tests.effects.one_of_each import CASES, START, Case, history


def stretched(machine: Machine) -> np.ndarray:
    """Return positions near the origin with stretched belts, in the coordinates' units."""
    return np.random.default_rng(2).normal(size=len(machine.coordinates)) * 1e-2


def test_belt_forces_are_the_gradient_of_the_energy(hframe: Machine) -> None:
    """V = sum 1/2 EA/l s^2, differentiated by complex steps."""

    def energy(q: np.ndarray) -> complex:
        travel = q * hframe.travel_per_unit
        total = 0j
        for b in hframe.belts:
            s = travel @ hframe.coefficients(b.extension)
            total += 0.5 * b.EA / (b.rest_length + travel @ hframe.coefficients(b.length)) * s * s
        return total

    q = stretched(hframe)
    gradient = [energy(q + 1e-30j * row).imag / 1e-30 for row in np.eye(len(q))]
    np.testing.assert_allclose(belt_forces(hframe, q), -np.array(gradient), rtol=1e-12)


def test_tension_without_effects_is_hookes_law(hframe: Machine) -> None:
    """T = EA / l s, for an array of positions at once."""
    q = np.stack([stretched(hframe), 2.0 * stretched(hframe)])
    travel = q * hframe.travel_per_unit
    for state, b in zip(belt_states(hframe, q), hframe.belts, strict=True):
        s = travel @ hframe.coefficients(b.extension)
        np.testing.assert_allclose(
            state.tension, b.EA / (b.rest_length + travel @ hframe.coefficients(b.length)) * s, rtol=1e-13
        )


def unexplained_force(machine: Machine, model: Machine) -> np.ndarray:
    """Return the error of m dv/dt = force of the model along a motion of the machine, N of belt.

    Only samples count at which the coordinate moves and no voltage changes: at rest friction is a set.
    """
    time_s, inputs = history(3, seconds=0.15)
    fine_s = np.arange(0.08, 0.15, 5e-5)
    held = inputs[np.searchsorted(time_s, fine_s + 1e-9) - 1]
    motion = simulate(machine, fine_s, held, rest_state(machine, START), longest_step=2.5e-5)
    force = net_forces(model, fine_s, motion.positions, motion.velocities, held)
    mass = np.array([c.mass for c in machine.coordinates])
    error = 0.5 * (force[1:] + force[:-1]) - mass * np.diff(motion.velocities, axis=0) / 5e-5
    same_direction = motion.velocities[1:] * motion.velocities[:-1] > 1e-6
    steady = (np.diff(held, axis=0) == 0.0).all(axis=1)
    return np.where(same_direction & steady[:, None], error / machine.travel_per_unit, 0.0)


def test_net_force_is_mass_times_simulated_acceleration(hframe: Machine) -> None:
    """Forces are up to 100 N."""
    assert np.abs(unexplained_force(hframe, hframe)).max() < 0.3


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_casadi_agrees_with_numpy(case: Case, hframe: Machine) -> None:
    """Acceleration with smooth friction of a machine with each effect, all parameters symbolic."""
    casadi = pytest.importorskip("casadi")
    machine = hframe.with_effects(case.effect)
    n, drives = len(machine.coordinates), len(machine.drives)
    parameters = casadi.SX.sym("p", len(machine.parameters))
    z = casadi.SX.sym("z", 2 * n)
    u = casadi.SX.sym("u", drives)
    equations = Equations(machine, dict(zip(machine.parameters, casadi.vertsplit(parameters), strict=True)))
    point = MotionPoint(casadi.vertsplit(z[:n]), casadi.vertsplit(z[n:]), 0.3)
    result = equations.accelerations(point, casadi.vertsplit(u), lambda v: tanh(v / 0.02))
    function = casadi.Function("acceleration", [z, u, parameters], [casadi.vertcat(*result)])
    rng = np.random.default_rng(0)
    state, voltages = rng.normal(size=2 * n) * 1e-3, rng.normal(size=drives) * 3.0
    expected = Equations(machine).accelerations(
        MotionPoint(state[:n], state[n:], 0.3), voltages, lambda v: tanh(v / 0.02)
    )
    found = np.array(function(state, voltages, list(machine.parameters.values()))).ravel()
    np.testing.assert_allclose(found, np.array(expected, float), rtol=1e-12, atol=1e-12)


def test_effect_forces_broadcast_over_variants(hframe: Machine) -> None:
    """Parameters of shape (G, 1) give forces of shape (G, n, coordinates)."""
    time_s, inputs = history(1, seconds=0.2)
    motion = simulate(hframe, time_s, inputs, rest_state(hframe, START))
    sizes = np.array([[1.0], [2.0], [-3.0]])
    effect = AppliedEffect(EFFECTS["constant_force"], "y", {"size": sizes})
    force = effect_forces(hframe, time_s, motion.positions, motion.velocities, inputs, [effect])
    assert force.shape == (3, len(time_s), 4)
    np.testing.assert_allclose(force[..., 1], np.broadcast_to(sizes, (3, len(time_s))), atol=1e-12)
    np.testing.assert_allclose(force[..., [0, 2, 3]], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    "name", ["presliding", "electrical_lag", "eccentric_pulley", "belt_damping", "belt_play"]
)
def test_effect_explains_its_part_of_the_force(name: str, hframe: Machine) -> None:
    """The model with the effect explains the motion; the model without it does not."""
    machine = hframe.with_effects(CASES[name].effect)
    error = np.sqrt(np.mean(unexplained_force(machine, machine) ** 2))
    error_without = np.sqrt(np.mean(unexplained_force(machine, hframe) ** 2))
    assert error < 0.2 * error_without


def test_all_effects_of_a_machine_add_up(hframe: Machine) -> None:
    """Without a list, `effect_forces` evaluates the effects of the machine, structural ones included."""
    time_s, inputs = history(4, seconds=0.2)
    machine = hframe.with_effects(CASES["bridge_yaw"].effect, CASES["cable_spring"].effect)
    motion = simulate(machine, time_s, inputs, rest_state(machine, START))
    force = effect_forces(machine, time_s, motion.positions, motion.velocities, inputs)
    spring, yaw = CASES["cable_spring"].parameters, CASES["bridge_yaw"].parameters
    expected = -spring["k"] * (motion.positions[:, 0] - spring["q0"])
    np.testing.assert_allclose(force[:, 0], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(force[:, 4], -yaw["k"] * motion.positions[:, 4], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["sensor_skew", "sensor_scale", "sensor_range", "bridge_yaw"])
def test_sensor_readings_agree_with_the_kernel(name: str, hframe: Machine) -> None:
    """Rows, products and measurement effects."""
    time_s, inputs = history(2, seconds=0.2)
    machine = hframe.with_effects(CASES[name].effect)
    motion = simulate(machine, time_s, inputs, rest_state(machine, START))
    np.testing.assert_allclose(
        sensor_readings(machine, motion.positions), motion.outputs, rtol=1e-12, atol=1e-15
    )


def test_tied_parameter_follows_its_owner(hframe: Machine) -> None:
    """A value for a parameter applies to all parameters that are tied to it."""
    machine = hframe.with_effects(CASES["idler_inertia"].effect)
    tied, (owner, factor) = next(iter(machine.ties.items()))
    assert Equations(machine, {owner: 7.0}).parameter(tied) == pytest.approx(factor * 7.0)


def test_voltage_delay_shifts_the_inputs(hframe: Machine) -> None:
    """A delay of one sample moves a voltage step by one sample; half a sample gives the mean."""
    time_s = np.arange(10) * 1e-3
    inputs = np.zeros((10, 2))
    inputs[5:, 0] = 4.0
    rest = np.zeros((10, 4))
    gain = hframe.drives[0].gain
    for delay, expected in ((1e-3, [0.0, 0.0, 4.0]), (0.5e-3, [0.0, 2.0, 4.0])):
        machine = hframe.with_effects(EFFECTS["input_delay"].at("drives", d=delay))
        machine = dataclasses.replace(machine, belts=())
        force = net_forces(machine, time_s, rest, rest, inputs)
        np.testing.assert_allclose(force[4:7, 2], gain * np.array(expected), atol=1e-9)


@pytest.mark.parametrize(
    ("site", "first", "second"),
    [
        ("motor1", ("electrical_lag", {"tau": 2e-3}), ("current_limit", {"I": 4.0})),
        ("motor1", ("dead_band", {"Vd": 0.5, "drop": 1.0}), ("voltage_offset", {"V0": 0.8})),
        ("motor1", ("voltage_offset", {"V0": 2.0}), ("voltage_limit", {"U": 5.0})),
        ("x_m", ("sensor_scale", {"g": 0.05}), ("sensor_range", {"low": -1e-3, "high": 1e-3})),
    ],
)
def test_effects_act_in_the_order_of_the_signal(
    hframe: Machine, site: str, first: tuple[str, dict[str, float]], second: tuple[str, dict[str, float]]
) -> None:
    """The order in which effects are listed, or were found by identification, does not change the machine."""
    time_s = np.arange(200) * 1e-3
    inputs = np.stack([7.0 * np.sin(60.0 * time_s), 5.0 * np.cos(40.0 * time_s)], axis=1)
    applied = [EFFECTS[name].at(site, **values) for name, values in (first, second)]
    simulated = [
        hframe.with_effects(*order).simulate(time_s, inputs).outputs for order in (applied, applied[::-1])
    ]
    np.testing.assert_array_equal(*simulated)
    without_second = hframe.with_effects(applied[0]).simulate(time_s, inputs).outputs
    assert np.abs(simulated[0] - without_second).max() > 1e-5
