"""Compare the reference simulator with energy balances, the paper's speeds and a second formulation."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.reference_simulator import Rig, Stage, energy, simulate
from tests.rigs.excitation import LIMIT_X_M, LIMIT_Y_M, record_runs

pytestmark = pytest.mark.oracle

RADIUS = 0.0194
NO_FRICTION = {"viscous": (0.0,) * 4, "coulomb": (0.0,) * 4}


def _held(volts, duration_s, step_s=1e-3):
    time_s = np.arange(round(duration_s / step_s) + 1) * step_s
    return time_s, np.tile(np.asarray(volts, dtype=float), (len(time_s), 1))


def _random_history(seed, duration_s, hold_s, amplitude):
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(duration_s / hold_s) + 1) * hold_s
    return time_s, rng.uniform(-amplitude, amplitude, (len(time_s), 2))


def _potential(rig, q):
    """Return the belts' energy, J, written out from the geometry and not from the simulator's rows."""
    x, y, phi1, phi2 = q
    left, right, bottom = rig.belt_length_m
    ea_l, ea_r, ea_b = rig.belt_EA_N
    v = 0.5 * ea_l / (left + x + y) * (RADIUS * phi1 + x + y) ** 2
    v += 0.5 * ea_r / (right + x - y) * (-RADIUS * phi2 + x - y) ** 2
    return v + 0.5 * ea_b / (bottom - 2 * x) * (-RADIUS * phi1 + RADIUS * phi2 - 2 * x) ** 2


def _regularized(rig, time_s, inputs, start_xy, creep):
    """Return positions (n, 4) by an implicit method with friction smoothed over a speed of `creep`, m/s.

    The forces are the complex-step gradient of the potential, so that no code is shared with the simulator.
    """
    mass, scale = np.array(rig.mass), creep / np.array([1.0, 1.0, RADIUS, RADIUS])
    stribeck, vs = np.array(rig.stribeck_force), np.array(rig.stribeck_velocity)

    def rhs(_, z, volts):
        q, v = z[:4], z[4:]
        step = 1e-30
        force = -_potential(rig, q[:, None] + 1j * step * np.eye(4)).imag / step
        dry = np.array(rig.coulomb) + stribeck * np.exp(-((v / vs) ** 2))
        force -= np.array(rig.viscous) * v + dry * np.tanh(v / scale)
        for j in range(2):
            emf = rig.gear_ratio * rig.emf_constant[j] * v[2 + j]
            amps = (volts[j] - emf) / rig.resistance_ohm[j]
            force[2 + j] += rig.gear_ratio * rig.torque_constant[j] * amps
        return np.concatenate([v, force / mass])

    x, y = start_xy
    z = np.array([x, y, -(x + y) / RADIUS, (x - y) / RADIUS, 0.0, 0.0, 0.0, 0.0])
    rows = [z[:4]]
    for a, b, volts in zip(time_s, time_s[1:], inputs, strict=False):
        solution = solve_ivp(rhs, (a, b), z, "LSODA", args=(volts,), rtol=1e-9, atol=1e-12)
        assert solution.success
        z = solution.y[:, -1]
        rows.append(z[:4])
    return np.array(rows)


def test_energy_is_conserved_without_drive_and_friction():
    rig = Rig(torque_constant=(0.0, 0.0), **NO_FRICTION)
    stage = Stage(rig, (0.1, -0.05), rtol=1e-12, atol=1e-15)
    # The belts are stretched by millimeters, so that dk/dq matters, and the carriage drifts.
    stage._z[:8] = [0.105, -0.048, -3.0, 7.5, 0.3, -0.2, 5.0, -4.0]
    before = energy(rig, stage.position, stage.velocity)
    assert before > 0.1
    for until in np.arange(1, 11) * 0.02:
        stage.step((0.0, 0.0), until)
        after = energy(rig, stage.position, stage.velocity)
        assert after == pytest.approx(before, rel=1e-9)


def test_energy_balance_of_a_driven_stage_with_friction():
    rig = dataclasses.replace(Rig(), emf_constant=(0.0, 0.0))
    time_s, inputs = _held((-1.5, 0.7), 0.05, 1e-5)
    q, v = simulate(rig, time_s, inputs)
    per_volt = rig.gear_ratio * 0.023 / 0.71
    power = per_volt * (v[:, 2:] * inputs).sum(axis=1)
    loss = (np.abs(v) * np.array(rig.coulomb) + v**2 * np.array(rig.viscous)).sum(axis=1)
    work = np.trapezoid(power - loss, time_s)
    stored = energy(rig, q[-1], v[-1])
    assert stored > 0.01
    assert work == pytest.approx(stored, rel=1e-4)  # the error of the trapezoidal rule


@pytest.mark.parametrize(("volts", "axis", "speed"), [((-4.0, -4.0), 1, 0.3811), ((-4.0, 4.0), 0, 0.3782)])
def test_steady_speeds(volts, axis, speed):
    # Constant stiffness: the steady speed does not depend on it, but a changing stiffness would disturb it.
    rig = Rig(length_follows=False)
    time_s, inputs = _held(volts, 1.0)
    _, v = simulate(rig, time_s, inputs)
    assert v[-1, axis] == pytest.approx(speed, abs=6e-5)
    assert abs(v[-1, 1 - axis]) < 1e-6


@pytest.mark.parametrize(
    ("rig", "seed", "amplitude"),
    [
        (Rig(), 1, 4.0),
        (Rig(), 2, 1.0),  # sticks and slips
        (Rig(stribeck_force=(3.0, 0.2, 0.0, 0.01), stribeck_velocity=(0.04, 0.05, 1, 2.5)), 3, 2.0),
    ],
)
def test_agrees_with_an_implicit_method_with_regularized_friction(rig, seed, amplitude):
    time_s, inputs = _random_history(seed, 0.24, 0.02, amplitude)
    q, v = simulate(rig, time_s, inputs, (0.1, -0.05))
    assert np.abs(np.diff(q, axis=0)).max(axis=0).min() > 1e-4  # every coordinate moved
    assert (v[1:] == 0.0).any() or amplitude > 1.0
    other = _regularized(rig, time_s, inputs, (0.1, -0.05), creep=1e-7)
    error = np.abs(q - other) * np.array([1.0, 1.0, RADIUS, RADIUS])
    assert error.max() < 1e-7  # m


def test_result_is_converged_in_the_tolerances():
    time_s, inputs = _random_history(4, 0.5, 1e-3, 6.0)
    tight, _ = simulate(Rig(), time_s, inputs)
    loose, _ = simulate(Rig(), time_s, inputs, rtol=1e-8, atol=1e-11)
    assert np.abs(tight - loose)[:, :2].max() < 1e-10


def test_motor_sticks_below_the_breakaway_torque_and_slides_above():
    rig = Rig(stribeck_force=(0.0, 0.0, 0.02, 0.0))
    per_volt = rig.gear_ratio * 0.023 / 0.71
    for torque, moves in ((0.0699, False), (0.0701, True)):
        time_s, inputs = _held((torque / per_volt, 0.0), 0.02)
        q, v = simulate(rig, time_s, inputs)
        assert np.all(v[0] == 0.0)
        assert (v[:, 2].max() > 0.0) == moves
        assert (q[-1, 2] > q[0, 2]) == moves


def test_constant_force_and_input_delay():
    rig = Rig(constant_force=(0.0, 10.0, 0.0, 0.0), belt_EA_N=(1e-9,) * 3)
    time_s, inputs = _held((0.0, 0.0), 1.0)
    _, v = simulate(rig, time_s, inputs)
    assert v[-1, 1] == pytest.approx((10.0 - 0.4) / 35.2944, rel=1e-9)

    time_s, inputs = _held((-4.0, 3.0), 0.1)
    plain, _ = simulate(Rig(), time_s, inputs)
    late, _ = simulate(Rig(input_delay_s=(5e-3, 5e-3)), time_s, inputs)
    assert np.allclose(late[5:], plain[:-5], rtol=0.0, atol=1e-12)
    assert np.all(late[:6] == late[0])


def test_asymmetric_viscous_and_drag_set_the_terminal_speed():
    loose = {"belt_EA_N": (1e-9,) * 3, "viscous_asymmetry": (0.0, 0.2, 0.0, 0.0)}
    for sign, viscous in ((1.0, 35.2944 * 1.2), (-1.0, 35.2944 * 0.8)):
        rig = Rig(constant_force=(0.0, sign * 10.0, 0.0, 0.0), quadratic_drag=(0.0, 8.0, 0.0, 0.0), **loose)
        time_s, inputs = _held((0.0, 0.0), 1.0)
        _, v = simulate(rig, time_s, inputs)
        speed = sign * v[-1, 1]
        assert viscous * speed + 8.0 * speed**2 == pytest.approx(9.6, rel=1e-8)


def test_excitation_is_repeatable_within_the_travel_and_covers_both_directions():
    session = record_runs(7, 4, 2.0, rtol=1e-6, atol=1e-9)
    again = record_runs(7, 1, 2.0, rtol=1e-6, atol=1e-9)
    assert np.array_equal(session[0].inputs, again[0].inputs)
    starts = [run.time_s[0] for run in session]
    assert starts == sorted(starts)
    for run in session:
        assert np.all(run.inputs[:100] == 0.0)
        assert np.all(run.velocities[:100] == 0.0)
        assert np.abs(run.inputs).max() <= 8.0
        assert np.abs(run.positions[:, 0]).max() < LIMIT_X_M
        assert np.abs(run.positions[:, 1]).max() < LIMIT_Y_M
    v = np.vstack([run.velocities for run in session])
    for axis in range(2):
        assert (v[:, axis] > 0.3).any()
        assert (v[:, axis] < -0.3).any()
        slow = np.abs(v[:, axis]) < 0.05
        assert (slow & (v[:, axis] > 0.0)).mean() > 0.03
        assert (slow & (v[:, axis] < 0.0)).mean() > 0.03
