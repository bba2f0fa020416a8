"""Compare each effect of the simulator on one coordinate with its scalar equation, integrated by SciPy."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests.reference_simulator import Rig, simulate

pytestmark = pytest.mark.oracle

LOOSE = {"belt_EA_N": (1e-9,) * 3}  # without belt forces every coordinate moves independently
M, B, FC = 1.0412, 35.2944, 0.4  # the cart
J, BM, FM = 1.12e-4, 0.0036, 0.05  # a motor
PER_AMP, EMF, OHM = 5.9 * 0.023, 5.9 * 0.023, 0.71


def _cart(push=10.0, start_xy=(0.0, 0.0), duration_s=0.3, **effects):
    """Return times, y and dy/dt (n,) of a cart under a constant force."""
    rig = Rig(constant_force=(0.0, push, 0.0, 0.0), **LOOSE, **effects)
    time_s = np.linspace(0.0, duration_s, 61)
    q, v = simulate(rig, time_s, np.zeros((61, 2)), start_xy)
    assert np.all(np.diff(q[:, 1]) > 0)  # one direction: sign(v) = 1 in the equations below
    return time_s, q[:, 1], v[:, 1]


def _solve(rhs, start, time_s):
    solution = solve_ivp(rhs, time_s[[0, -1]], start, "DOP853", time_s, rtol=1e-11, atol=1e-14)
    assert solution.success
    return solution.y


CART = {
    "stribeck": (
        {"stribeck_force": 0.3, "stribeck_velocity": 0.05},
        lambda t, q, v: -0.3 * math.exp(-((v / 0.05) ** 2)),
    ),
    "friction wave": (
        {"friction_wave": 0.3, "friction_wavelength": 0.02, "friction_phase": 0.4},
        lambda t, q, v: -0.3 * math.sin(2 * math.pi * q / 0.02 + 0.4),
    ),
    "friction slope": ({"friction_slope": 5.0}, lambda t, q, v: -5.0 * q),
    "cold": ({"friction_cold": 1.5}, lambda t, q, v: -0.4 * 1.5 * math.exp(-t / 40.0)),
    "bent rail": ({"friction_cross_position": 6.0}, lambda t, q, v: -6.0 * 0.1),  # x rests at 0.1 m
    "drag": ({"quadratic_drag": 20.0}, lambda t, q, v: -20.0 * v * v),
    "brake": ({"brake_drag": 20.0, "brake_speed": 0.1}, lambda t, q, v: -20.0 * v / (1.0 + (v / 0.1) ** 2)),
    "spring": ({"spring_stiffness": 60.0, "spring_rest": 0.03}, lambda t, q, v: -60.0 * (q - 0.03)),
    "lifting cable": ({"spring_square": 80.0, "spring_rest": -0.1}, lambda t, q, v: -80.0 * (q + 0.1) ** 2),
    "stale grease": (  # in one direction from y = 0 the path is y
        {"friction_stale": 2.0, "friction_stale_path": 0.05},
        lambda t, q, v: -0.4 * 2.0 * math.exp(-q / 0.05),
    ),
    "asymmetry": ({"viscous_asymmetry": 0.3}, lambda t, q, v: -0.3 * B * v),
    "magnets": (
        {"wave_force": 2.5, "wave_number": 196.0, "wave_phase": 0.4},
        lambda t, q, v: 2.5 * math.sin(196.0 * q + 0.4),
    ),
    "second harmonic": (
        {"wave_force": 1.0, "wave_second": 2.0, "wave_number": 98.0, "wave_phase": 0.4},
        lambda t, q, v: math.sin(98.0 * q + 0.4) + 2.0 * math.sin(2.0 * 98.0 * q),
    ),
    "catch": (
        {"catch_force": 6.0, "catch_position": 0.04, "catch_width": 0.01},
        lambda t, q, v: (
            -6.0 * math.sqrt(math.e) * (q - 0.04) / 0.01 * math.exp(-(((q - 0.04) / 0.01) ** 2) / 2)
        ),
    ),
}


@pytest.mark.parametrize("name", CART)
def test_force_on_the_cart(name):
    fields, force = CART[name]
    per_coordinate = {key: (0.0, value, 0.0, 0.0) for key, value in fields.items()}
    for key in ("stribeck_velocity", "friction_wavelength", "catch_width"):
        if key in per_coordinate:
            per_coordinate[key] = (fields[key],) * 4
    time_s, y, v = _cart(start_xy=(0.1, 0.0), **per_coordinate)

    def rhs(t, z):
        return [z[1], (10.0 - B * z[1] - FC + force(t, *z)) / M]

    expected = _solve(rhs, [0.0, 0.0], time_s)
    plain = _solve(lambda t, z: [z[1], (10.0 - B * z[1] - FC) / M], [0.0, 0.0], time_s)
    assert np.abs(y - expected[0]).max() < 1e-9
    assert np.abs(v - expected[1]).max() < 1e-8
    assert np.abs(plain[0] - expected[0]).max() > 2e-5  # the effect is visible


@pytest.mark.parametrize(("damping", "stribeck"), [(0.0, 0.0), (20.0, 0.3)])
def test_presliding(damping, stribeck):
    """Dahl's and the LuGre model move the cart from rest through presliding to sliding."""
    stiffness = 2e4
    time_s, y, _ = _cart(
        2.0,
        duration_s=0.1,
        bristle_stiffness=(0.0, stiffness, 0.0, 0.0),
        bristle_damping=(0.0, damping, 0.0, 0.0),
        stribeck_force=(0.0, stribeck, 0.0, 0.0),
    )

    def rhs(t, z):
        level = FC + stribeck * math.exp(-((z[1] / 0.05) ** 2))
        rate = z[1] - stiffness * abs(z[1]) * z[2] / level
        return [z[1], (2.0 - B * z[1] - stiffness * z[2] - damping * rate) / M, rate]

    assert np.abs(y - _solve(rhs, [0.0, 0.0, 0.0], time_s)[0]).max() < 1e-9


def test_presliding_springs_back_below_the_level():
    """Under half the friction level F a Dahl bristle comes to rest at -F/s0 ln(1 - f/F)."""
    rig = Rig(
        constant_force=(0.0, 0.2, 0.0, 0.0),
        viscous=(32.5, 100.0, 0.0036, 0.0036),  # approaches without overshoot
        bristle_stiffness=(0.0, 2e3, 0.0, 0.0),
        **LOOSE,
    )
    q, _ = simulate(rig, np.array([0.0, 2.0]), np.zeros((2, 2)))
    assert q[-1, 1] == pytest.approx(FC / 2e3 * math.log(2.0), rel=1e-4)


def test_cable_chain_hysteresis():
    time_s, y, _ = _cart(hysteresis_force=(0.0, 3.0, 0.0, 0.0))

    def rhs(t, z):
        w = z[2] / 0.005
        return [z[1], (10.0 - B * z[1] - FC - 3.0 * w) / M, z[1] * (1.0 - 0.5 * (abs(w) * w + w * w))]

    assert np.abs(y - _solve(rhs, [0.0, 0.0, 0.0], time_s)[0]).max() < 1e-9


def test_dahl_hysteresis():
    time_s, y, _ = _cart(dahl_force=(0.0, 3.0, 0.0, 0.0))

    def rhs(t, z):
        w = z[2] / 0.005
        return [z[1], (10.0 - B * z[1] - FC - 3.0 * w) / M, z[1] - abs(z[1]) * w]

    assert np.abs(y - _solve(rhs, [0.0, 0.0, 0.0], time_s)[0]).max() < 1e-9


def test_friction_that_depends_on_the_speed_of_the_other_axis():
    rig = Rig(constant_force=(20.0, 10.0, 0.0, 0.0), friction_cross_speed=(0.0, 4.0, 0.0, 0.0), **LOOSE)
    time_s = np.linspace(0.0, 0.3, 31)
    q, _ = simulate(rig, time_s, np.zeros((31, 2)))

    def rhs(t, z):
        return [z[1], (18.0 - 32.5114 * z[1]) / 4.07, z[3], (10.0 - B * z[3] - FC - 4.0 * abs(z[1])) / M]

    assert np.abs(q[:, :2] - _solve(rhs, [0.0] * 4, time_s)[[0, 2]].T).max() < 1e-9


# Motor 1 alone at 6 V: effects, current (t, angle, speed, state), rate of the state (speed, state, current).
MOTOR = {
    "plain": ({}, lambda t, a, w, z: (6.0 - EMF * w) / OHM, None),
    "gain and offset": (
        {"drive_gain": (0.9, 1.0), "voltage_offset_V": (0.2, 0.0)},
        lambda t, a, w, z: (5.6 - EMF * w) / OHM,
        None,
    ),
    "dead band": ({"dead_band_V": (0.5, 0.0)}, lambda t, a, w, z: (5.5 - EMF * w) / OHM, None),
    "dead time": (
        {"dead_time_V": (0.5, 0.0), "dead_time_A": (2.0, 0.2)},  # the current falls from 8 A to 1.4 A
        lambda t, a, w, z: brentq(
            lambda i: 6.0 - EMF * w - OHM * i - 0.5 * min(max(i / 2.0, -1.0), 1.0), -20.0, 20.0, xtol=1e-14
        ),
        None,
    ),
    "limit": ({"current_limit_A": (4.0, 9.0)}, lambda t, a, w, z: min((6.0 - EMF * w) / OHM, 4.0), None),
    "lag": (
        {"electrical_lag_s": (2e-3, 0.0)},
        lambda t, a, w, z: z,
        lambda w, z, amps: ((6.0 - EMF * w) / OHM - z) / 2e-3,
    ),
    "heating": (
        {"heating_loss": (0.02, 0.0), "heating_s": (0.1, 1.0)},
        lambda t, a, w, z: (6.0 - EMF * w) / OHM * (1.0 - 0.02 * z),
        lambda w, z, amps: (((6.0 - EMF * w) / OHM) ** 2 - z) / 0.1,
    ),
    "warm winding": (
        {"heating_ohm": (0.02, 0.0), "heating_s": (0.1, 1.0)},
        lambda t, a, w, z: (6.0 - EMF * w) / (OHM * (1.0 + 0.02 * z)),
        lambda w, z, amps: (amps**2 - z) / 0.1,
    ),
    "supply sag": (
        {"supply_V": 12.0, "supply_ohm": 0.4, "supply_s": 0.01},
        lambda t, a, w, z: (6.0 * (1.0 - z) - EMF * w) / OHM,
        lambda w, z, amps: (0.4 * (6.0 / 12.0 * amps) / 12.0 - z) / 0.01,
    ),
    "ripple": (
        {"current_ripple": (0.1, 0.0), "current_ripple_order": (7.0, 1.0)},
        lambda t, a, w, z: (6.0 - EMF * w) / OHM * (1.0 + 0.1 * math.sin(7.0 * a)),
        None,
    ),
}


@pytest.mark.parametrize("name", MOTOR)
def test_drive(name):
    fields, current, state = MOTOR[name]
    time_s = np.linspace(0.0, 0.2, 41)
    q, v = simulate(Rig(**LOOSE, **fields), time_s, np.tile([6.0, 0.0], (41, 1)))

    def rhs(t, z):
        amps = current(t, *z)
        friction = FM if z[1] > 0.0 else min(FM, PER_AMP * amps)
        return [z[1], (PER_AMP * amps - BM * z[1] - friction) / J, state(z[1], z[2], amps) if state else 0.0]

    expected = _solve(rhs, [0.0, 0.0, 0.0], time_s)
    kink = 1e-6 if name in ("limit", "lag", "dead time") else 1e-8  # SciPy steps over the kink
    assert np.abs(q[:, 2] - expected[0]).max() < kink
    assert expected[0, -1] > 5.0
    assert np.all(q[:, 3] == 0.0)
    assert v[-1, 2] == pytest.approx(expected[1, -1], rel=1e-7)


def test_voltages_inside_the_dead_band_move_nothing():
    q, _ = simulate(
        Rig(dead_band_V=(1.0, 1.0), coulomb=(0.0,) * 4), np.array([0.0, 0.1]), np.full((2, 2), 0.99)
    )
    assert np.abs(q[-1]).max() < 1e-12


def test_friction_increases_from_run_to_run():
    rig = Rig(friction_per_run=0.1)
    assert rig.at_run(0) == rig
    assert rig.at_run(3).coulomb == pytest.approx([1.3 * c for c in rig.coulomb])
