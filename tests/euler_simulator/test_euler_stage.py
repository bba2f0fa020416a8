"""Compare the Euler simulator with the package's kernel and, by effect, with the reference simulator."""

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.machine import rest_state
from tests import reference_simulator as reference
from tests.effects.one_of_each import CASES
from tests.euler_simulator import EulerStage
from tests.reference_simulator import Frame, Rig
from tests.rigs.euler_rig import euler_parameters

pytestmark = pytest.mark.oracle

START = (0.08, -0.05)
TRAVEL = np.array([1.0, 1.0, 0.0194, 0.0194])  # m per m and per rad of x, y, phi1, phi2
MORE = {
    "frame": Rig(frame=Frame()),
    "warm-up": Rig(friction_cold=(1.5,) * 4, warm_up_s=2.0),
    "hysteresis": Rig(hysteresis_force=(4.0, 0.0, 0.01, 0.0)),
    "catch": Rig(catch_force=(8.0, 2.0, 0.0, 0.0), catch_position=(0.07, -0.04, 0.0, 0.0)),
    "missing energy force": Rig(belt_energy_force=False),
    "another Stribeck exponent": Rig(stribeck_force=(3.0, 0.8, 0.03, 0.0), stribeck_exponent=(1.7,) * 4),
    "unequal damping": Rig(belt_damping_s=1e-3, belt_damping_factor=(1.15, 0.85, 1.0)),
    "second harmonic": Rig(wave_force=(0.5, 0.0, 0.03, 0.0), wave_second=(0.2, 0.0, 0.15, 0.0)),
}
# What the Euler simulator lacks or has in another form.
LACKING = (
    *("idler_inertia", "frame_resonance", "dwell_friction", "torque_saturation"),
    *("commutation_ripple", "gear_backlash", "winding_heat", "supply_sag", "payload_swing"),
    *("belt_mesh", "eddy_brake", "coasting_bridge", "inverter_dead_time"),
)
ONE_OF_EACH = {n: dataclasses.replace(Rig(), **c.rig) for n, c in CASES.items() if c.rig and n not in LACKING}


def _history(seed: int, seconds: float, limit_V: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) at 1 kHz and random voltages (n, 2), held for 20 ms, after 50 ms of rest."""
    time_s = np.arange(round(seconds * 1000)) * 1e-3
    levels = np.random.default_rng(seed).uniform(-limit_V, limit_V, (len(time_s) // 20 + 1, 2))
    inputs = np.repeat(levels, 20, axis=0)[: len(time_s)]
    inputs[:50] = 0.0
    return time_s, inputs


def _positions(rig: Rig, time_s: np.ndarray, inputs: np.ndarray, step_s: float = 4e-6) -> np.ndarray:
    """Return x, y, phi1, phi2 (n, 4) of the Euler simulator."""
    stage = EulerStage(euler_parameters(rig), rig.input_delay_s, START, time_s[0], step_s)
    rows = [stage.position]
    for volts, until in zip(inputs, time_s[1:], strict=False):
        stage.step(volts, until)
        rows.append(stage.position)
    return np.array(rows)


def test_agrees_with_the_kernel_on_the_declared_machine(hframe):
    time_s, inputs = _history(3, 2.0, 4.0)
    start = rest_state(hframe, START)
    expected = simulate(hframe, time_s, inputs, start, longest_step=0.125e-3).positions
    error = np.abs(_positions(Rig(), time_s, inputs) - expected) * TRAVEL
    assert np.ptp(expected, axis=0).min() > 0.02
    assert np.sqrt(np.mean(error**2)) < 1e-6
    assert error.max() < 3e-6


@pytest.mark.parametrize("name", [*ONE_OF_EACH, *MORE])
def test_each_effect_agrees_with_the_reference_simulator(name):
    rig = (ONE_OF_EACH | MORE)[name]
    time_s, inputs = _history(5, 0.6, 6.0)
    expected, _ = reference.simulate(rig, time_s, inputs, START, rtol=1e-9, atol=1e-12)
    plain, _ = reference.simulate(Rig(), time_s, inputs, START, rtol=1e-9, atol=1e-12)
    error = np.abs((_positions(rig, time_s, inputs) - expected) * TRAVEL).max()
    assert error < 4e-6
    if name != "missing energy force":  # by definition a small one
        assert np.abs((plain - expected) * TRAVEL).max() > 10 * error


def test_error_is_of_first_order():
    time_s, inputs = _history(7, 0.5, 6.0)
    expected, _ = reference.simulate(Rig(), time_s, inputs, START, rtol=1e-9, atol=1e-12)
    fine, coarse = (
        np.abs((_positions(Rig(), time_s, inputs, h) - expected) * TRAVEL).max() for h in (10e-6, 80e-6)
    )
    assert 4.0 < coarse / fine < 16.0


def test_sticks_exactly_and_carries_a_load_below_the_friction():
    rig = Rig(constant_force=(1.5, 0.0, 0.0, 0.0))
    stage = EulerStage(euler_parameters(rig), start_xy=START)
    stage.step((0.0, 0.0), 0.5)
    assert np.array_equal(stage.velocity, np.zeros(4))
    assert stage.position[0] == START[0]


@pytest.mark.parametrize(
    ("name", "value"), [("idlers", True), ("coasting_V", (0.1, 0.0)), ("friction_age", (0.5, 0.0, 0.0, 0.0))]
)
def test_rejects_what_it_does_not_model(name, value):
    with pytest.raises(ValueError, match=f"no {name}$"):
        euler_parameters(Rig(**{name: value}))
