"""Presets against the values that the paper prints, to the last digit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import belt_modes, mode_frequencies, simulate, stiffness_matrix
from hframe_gym.machine import BUILTIN_MACHINES, Machine, with_constant_stiffness
from hframe_gym.machine.presets import STIFFNESS

pytestmark = pytest.mark.oracle

TIME = np.arange(2001) * 1e-3  # s


def step_response(machine: Machine, first: float, second: float, samples: int = 2001) -> np.ndarray:
    """Return positions and velocities, shape (n, 8 or 20), after a step of both voltages from rest."""
    trajectory = simulate(
        machine, TIME[:samples], np.tile([first, second], (samples, 1)), longest_step=0.1e-3
    )
    return np.hstack([trajectory.positions, trajectory.velocities])


def with_stiffness_of_table_1(name: str) -> Machine:
    """Return a preset with the constant belt stiffness of Table 1."""
    machine = BUILTIN_MACHINES[name]()
    return machine if name == "hframe-linear" else with_constant_stiffness(machine, STIFFNESS)


@pytest.mark.parametrize(
    ("name", "modes"),
    [
        ("hframe-linear", [39.83, 52.49]),
        ("hframe-order20", [41.29, 57.53, 80.74, 98.64, 114.55, 121.92, 219.71, 232.07]),
    ],
)
def test_mode_frequencies(name: str, modes: list[float]) -> None:
    machine = BUILTIN_MACHINES[name]()
    np.testing.assert_array_equal(mode_frequencies(machine)[:2], 0.0)
    np.testing.assert_allclose(belt_modes(machine), modes, atol=0.005)


# Without the gear ratio, the speed after 0.4 s is not yet the steady one (see
# test_steady_speed_without_gear_ratio).
@pytest.mark.parametrize(
    ("ratio", "volts", "axis", "linear", "nonlinear"),
    [
        (1.0, 4, "y", 0.1860, 0.1337),
        (1.0, 4, "x", 0.1833, 0.1107),
        (1.0, 2, "x", 0.0917, 0.0),
        (5.9, 2, "y", 0.1916, 0.1761),
        (5.9, 2, "x", 0.1908, 0.1702),
        (5.9, 4, "y", 0.3832, 0.3811),
        (5.9, 4, "x", 0.3815, 0.3782),
        (5.9, 6, "y", 0.5747, 0.5860),
        (5.9, 6, "x", 0.5723, 0.5862),
    ],
)
def test_speeds_after_0_4_s(ratio: float, volts: int, axis: str, linear: float, nonlinear: float) -> None:
    sign, i = {"x": (1, 0), "y": (-1, 1)}[axis]
    for name, expected in (("hframe-linear", linear), ("hframe", nonlinear)):
        machine = with_stiffness_of_table_1(name)
        drives = tuple(dataclasses.replace(d, gear_ratio=ratio) for d in machine.drives)
        speed = step_response(machine.replace(drives=drives), -volts, sign * volts, 401)[-1, 4 + i]
        assert speed == pytest.approx(expected, abs=1.1e-4)


def test_steady_speed_without_gear_ratio() -> None:
    """Balance the forces of the literal model along x at 4 V; 0.1107 m/s is its speed after 0.4 s."""
    machine = with_stiffness_of_table_1("hframe-literal")
    motor = machine.coordinate("phi1")
    drive = machine.drives[0]
    excess_force = 2 * (drive.gain * 4 - motor.coulomb) / motor.radius - machine.coordinate("x").coulomb
    damping = 2 * (motor.viscous + drive.back_emf) / motor.radius**2 + machine.coordinate("x").viscous
    assert excess_force / damping == pytest.approx(0.11158, abs=1e-5)
    assert step_response(machine, -4, 4)[-1, 4] == pytest.approx(excess_force / damping, rel=1e-6)


def test_linear_8th_and_20th_order_models_move_alike() -> None:
    small, large = BUILTIN_MACHINES["hframe-linear"](), BUILTIN_MACHINES["hframe-order20"]()
    along_y = [step_response(m, -4, -4, 301)[:, :2] * 1e3 for m in (small, large)]
    along_x = [step_response(m, -4, 4, 301)[:, :2] * 1e3 for m in (small, large)]
    assert [xy[-1, 1] for xy in along_y] == pytest.approx([111.33, 111.40], abs=0.006)
    assert [xy[-1, 0] for xy in along_x] == pytest.approx([105.59, 105.57], abs=0.006)
    # Largest difference of either axis: 0.29 mm along y in the y-move, 0.10 mm across the x-move.
    assert np.abs(along_y[0] - along_y[1]).max() == pytest.approx(0.29, abs=0.006)
    assert np.abs(along_x[0] - along_x[1]).max() == pytest.approx(0.10, abs=0.006)


def test_sensitivity_to_stiffness() -> None:
    """Change belt stiffness as in section V.

    At (-6, -6) V, the left belt at -25 % and the right one at +25 % change y(0.25 s) by -0.02 mm; twice the
    stiffness of the bottom belt changes x by 0.11 mm.
    """
    machine = BUILTIN_MACHINES["hframe"]()
    base = with_constant_stiffness(machine, STIFFNESS)
    k_l, k_r, k_b = (STIFFNESS[k] for k in ("left", "right", "bottom"))
    skewed = with_constant_stiffness(machine, {"left": 0.75 * k_l, "right": 1.25 * k_r, "bottom": k_b})
    stiffer = with_constant_stiffness(machine, {"left": k_l, "right": k_r, "bottom": 2 * k_b})
    y = [1e3 * step_response(m, -6, -6, 251)[-1, 1] for m in (base, skewed)]
    x = [1e3 * step_response(m, -6, 6, 251)[-1, 0] for m in (base, stiffer)]
    assert y[1] - y[0] == pytest.approx(-0.02, abs=0.006)
    assert x[1] - x[0] == pytest.approx(0.11, abs=0.006)


def test_table_4_implies_table_1() -> None:
    """Compute the stiffness of Table 1 from sections, cross section and modulus at that position."""
    machine = BUILTIN_MACHINES["hframe"]()
    x, y = -0.2227, -0.1163
    position = {"x": x, "y": y}
    stiffness = {
        b.name: b.EA / (b.rest_length + sum(f * position[c] for c, f in b.length.items()))
        for b in machine.belts
    }
    assert [stiffness[k] for k in ("left", "right", "bottom")] == pytest.approx([13164, 10789, 8047], abs=0.6)
    for name, value in stiffness.items():
        assert value == pytest.approx(STIFFNESS[name], rel=4e-4)


def test_parameters_of_the_20th_order_model() -> None:
    machine = BUILTIN_MACHINES["hframe-order20"]()
    assert machine.coordinate("y").mass == pytest.approx(0.4460, abs=6e-5)
    assert machine.coordinate("y").viscous == pytest.approx(23.2326, abs=6e-4)
    K = stiffness_matrix(machine)
    np.testing.assert_allclose(K, K.T)
    assert np.linalg.matrix_rank(K) == 8


def test_lumping_of_the_20th_order_model() -> None:
    """Lump the sections in series and the pulleys into the 8th-order model (eq. 4-9)."""
    small, large = BUILTIN_MACHINES["hframe-linear"](), BUILTIN_MACHINES["hframe-order20"]()
    k = {b.name: b.EA / b.rest_length for b in large.belts}
    series = {"left": ("s1", "s5", "s7"), "right": ("s2", "s6", "s8"), "bottom": ("s3", "s4", "s9")}
    for name, sections in series.items():
        assert 1 / sum(1 / k[s] for s in sections) == pytest.approx(STIFFNESS[name], rel=4e-4)
    pulley = large.coordinate("phi5")
    for key in ("mass", "viscous"):
        assert 2 * getattr(pulley, key) == pytest.approx(getattr(small.coordinate("phi1"), key))
        carried = getattr(large.coordinate("y"), key) + 4 * getattr(pulley, key) / 0.0194**2
        assert carried == pytest.approx(getattr(small.coordinate("y"), key))
