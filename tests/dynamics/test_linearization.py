"""Linearization against eq. 21-22 as printed (with the erratum's gear ratio), textbook formulas and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from hframe_gym.dynamics import linearize, mode_frequencies, resolved_step, simulate, stiffness_matrix
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine, rest_state

pytestmark = pytest.mark.oracle


def stiffness_by_formula(machine: Machine, position: np.ndarray) -> np.ndarray:
    """Return K = G' diag(k) G with k = EA / (l0 + H p)."""
    travel = position * machine.travel_per_unit
    lengths = np.array([b.rest_length + machine.coefficients(b.length) @ travel for b in machine.belts])
    G, EA = machine.belt_matrix, np.array([b.EA for b in machine.belts])
    return G.T @ ((EA / lengths)[:, None] * G)


@pytest.mark.parametrize("name", [n for n, machine in BUILTIN_MACHINES.items() if not machine().drive_laws])
def test_derivatives_equal_the_formulas(name: str) -> None:
    """Stiffness G' diag(k) G, damping with back-EMF, motor gains, sensor coefficients, off the center."""
    machine = BUILTIN_MACHINES[name]()
    n = len(machine.coordinates)
    position = rest_state(machine, 0.07)[:n]
    mass = np.array([c.mass for c in machine.coordinates])
    viscous = np.array([c.viscous for c in machine.coordinates])
    gains = np.zeros((n, len(machine.drives)))
    for j, d in enumerate(machine.drives):
        i = machine.coordinate_names.index(d.coordinate)
        gains[i, j] = d.gear_ratio * d.Kt / d.resistance
        viscous[i] += d.gear_ratio**2 * d.Kt * d.Ke / d.resistance
    K = stiffness_by_formula(machine, position)
    model, tolerance = linearize(machine, position), {"rtol": 1e-12, "atol": 1e-12 * np.abs(K).max()}
    np.testing.assert_allclose(stiffness_matrix(machine, position), K, **tolerance)
    np.testing.assert_allclose(mass[:, None] * model.A[n:], np.hstack([-K, -np.diag(viscous)]), **tolerance)
    np.testing.assert_array_equal(model.A[:n], np.eye(2 * n)[n:])
    np.testing.assert_allclose(model.B, np.vstack([0 * gains, gains / mass[:, None]]), rtol=1e-12)
    np.testing.assert_allclose(model.C[:, :n], machine.sensor_matrix, rtol=1e-12)
    squared = np.sort(np.linalg.eigvals(K / mass[:, None]).real)
    np.testing.assert_allclose(
        (2 * np.pi * mode_frequencies(machine, position)) ** 2, squared, rtol=1e-9, atol=1e-2
    )


def test_stiffness_at_several_positions_at_once(hframe: Machine) -> None:
    positions = np.stack([rest_state(hframe, (x, -0.05))[:4] for x in (-0.1, 0.0, 0.2)])
    expected = [stiffness_by_formula(hframe, position) for position in positions]
    np.testing.assert_allclose(stiffness_matrix(hframe, positions), expected, rtol=1e-12, atol=1e-8)


def test_effects_do_not_enter_the_linearization(hframe: Machine) -> None:
    """The coordinate that an effect adds remains, with the parameters that were tied to the effect."""
    yawing = hframe.with_effects(EFFECTS["bridge_yaw"].at("machine", J=0.1, k=2e3, c=1.0, w=0.25))
    position = np.zeros(len(yawing.coordinates))
    expected = stiffness_by_formula(yawing, position)
    np.testing.assert_allclose(stiffness_matrix(yawing, position), expected, rtol=1e-12, atol=1e-8)


def test_state_space_matrices_equal_equations_21_and_22() -> None:
    machine = BUILTIN_MACHINES["hframe-linear"]()
    k_l, k_r, k_b, r = 1.3167e4, 1.0791e4, 8.0492e3, 0.0194
    M_bridge, M_cart, J, B_M = 4.07, 1.0412, 1.12e-4, 0.0042
    b_bridge, b_cart = 46.4449, 45.5517
    gain, emf = 5.9 * 23e-3 / 0.71, 5.9**2 * 23e-3**2 / 0.71
    # States in the paper's order: x, x', y, y', phi1, phi1', phi2, phi2'.
    A = np.zeros((8, 8))
    A[0, 1] = A[2, 3] = A[4, 5] = A[6, 7] = 1.0
    A[1, [0, 1, 2, 4, 6]] = [
        -(k_l + k_r + 4 * k_b) / M_bridge,
        -b_bridge / M_bridge,
        -(k_l - k_r) / M_bridge,
        -(k_l + 2 * k_b) * r / M_bridge,
        (k_r + 2 * k_b) * r / M_bridge,
    ]
    A[3, [0, 2, 3, 4, 6]] = np.array([-(k_l - k_r), -(k_l + k_r), -b_cart, -k_l * r, -k_r * r]) / M_cart
    A[5, [0, 2, 4, 5, 6]] = (
        np.array([-(k_l + 2 * k_b) * r, -k_l * r, -(k_l + k_b) * r**2, -(B_M + emf), k_b * r**2]) / J
    )
    A[7, [0, 2, 4, 6, 7]] = (
        np.array([(k_r + 2 * k_b) * r, -k_r * r, k_b * r**2, -(k_r + k_b) * r**2, -(B_M + emf)]) / J
    )
    order = [0, 4, 1, 5, 2, 6, 3, 7]
    model = linearize(machine)
    np.testing.assert_allclose(model.A[np.ix_(order, order)], A, rtol=1e-12, atol=1e-9)
    B = np.zeros((8, 2))
    B[5, 0] = B[7, 1] = gain / J
    np.testing.assert_allclose(model.B[order], B, rtol=1e-12)
    np.testing.assert_array_equal(model.C[:2, order], np.eye(8)[[4, 6]])
    np.testing.assert_array_equal(model.D, 0.0)


def test_simulation_of_linear_machines_equals_scipy() -> None:
    for name in ("hframe-linear", "hframe-order20"):
        machine = BUILTIN_MACHINES[name]()
        rng = np.random.default_rng(2)
        time = np.arange(400) * 1e-3
        inputs = np.repeat(rng.uniform(-6, 6, (20, 2)), 20, axis=0)
        A, B, C, D = linearize(machine)
        discrete = signal.cont2discrete((A, B, C, D), 1e-3)
        _, exact, _ = signal.dlsim(discrete, inputs, time)
        outputs = simulate(machine, time, inputs, longest_step=0.05e-3).outputs
        scale = np.array([0.0194, 0.0194, 1.0, 1.0])  # m per rad, m per m
        assert np.abs((outputs - exact) * scale).max() < 1e-7


def test_the_integration_step_resolves_stiff_belts(hframe: Machine) -> None:
    assert resolved_step(hframe, 0.5e-3) == 0.5e-3
    stiff = hframe.replace(
        {name: 100.0 * value for name, value in hframe.parameters.items() if name.endswith(".EA")}
    )
    step = resolved_step(stiff, 0.5e-3)
    assert 2 * np.pi * mode_frequencies(stiff).max() * step == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("label", "values"),
    [
        ("payload_swing@x", {"f0": 500.0, "zeta": 1.0, "r": 1.0}),
        ("payload_swing@x", {"f0": 500.0, "zeta": 0.0, "r": 30.0}),
        ("frame_resonance@x", {"f0": 500.0, "zeta": 1.0, "r": 0.1, "s": 0.0}),
        ("bridge_yaw@machine", {"J": 1e-3, "k": 1e6, "c": 0.0, "w": 0.25}),
        ("belt_damping@belts", {"c": 1e-2}),
    ],
)
def test_the_integration_step_resolves_what_effects_add(label: str, values: dict[str, float]) -> None:
    """Without it, stiff or strongly damped parts diverge. The belts are stiff, and friction is viscous."""
    linear = BUILTIN_MACHINES["hframe-linear"]()
    stiff = linear.replace({f"{b.name}.EA": 20.0 * b.EA for b in linear.belts})
    name, site = label.split("@")
    machine = stiff.with_effects(EFFECTS[name].at(site, **values))
    step = resolved_step(machine, 0.5e-3)
    assert step < resolved_step(stiff, 0.5e-3)
    time_s = 1e-3 * np.arange(100)
    volts = np.repeat(np.random.default_rng(0).uniform(-6.0, 6.0, (10, 2)), 10, axis=0)
    exact = simulate(machine, time_s, volts, longest_step=0.05 * step).outputs
    errors = np.abs(simulate(machine, time_s, volts, longest_step=step).outputs - exact)
    assert (errors * [0.0194, 0.0194, 1.0, 1.0]).max() < 5e-6


def test_the_integration_step_resolves_a_delay_that_is_no_multiple_of_it(hframe: Machine) -> None:
    delayed = hframe.with_effects(EFFECTS["input_delay"].at("motor1", d=0.43e-3))
    time_s = 1e-3 * np.arange(100)
    volts = np.random.default_rng(0).uniform(-6.0, 6.0, (100, 2))
    exact = simulate(delayed, time_s, volts, longest_step=0.01e-3).outputs

    def error_m(step_s: float) -> float:
        errors = np.abs(simulate(delayed, time_s, volts, longest_step=step_s).outputs - exact)
        return float((errors * [0.0194, 0.0194, 1.0, 1.0]).max())

    assert error_m(0.125e-3) > 2e-6
    assert error_m(resolved_step(delayed, 0.125e-3)) < 0.5e-6
    assert resolved_step(delayed, 0.125e-3, delays=False) == 0.125e-3
