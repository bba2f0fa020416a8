"""Accelerations and rates of states with each effect, at random points, against the independent simulator's equations.

Nothing is integrated and no kernel is compiled, so that a wrong sign or factor is found within a second.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import Equations, MotionPoint
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import Machine
from tests.effects.one_of_each import CASES, Case
from tests.reference_simulator import Rig
from tests.reference_simulator.equations import EXTRA, derivative
from tests.reference_simulator.parameter_arrays import parameter_arrays
from tests.reference_simulator.sensors import Sensors

pytestmark = pytest.mark.oracle

POINTS = 40
DELAYS = {"input_delay", "sensor_delay"}  # no quantity of a single point
DYNAMIC = [case for case in CASES.values() if case.rig and case.name not in DELAYS]
# Entry of the simulator's state (offset in multiples of the number of coordinates, constant) and its factor per unit of
# the effect's state.
STATES = {
    "presliding": (2, 2, 1.0),
    "bouc_wen_hysteresis": (3, 2, CASES["bouc_wen_hysteresis"].parameters["L"]),
    "dahl_hysteresis": (3, 2, CASES["dahl_hysteresis"].parameters["L"]),
    "electrical_lag": (2, 1, 1.0),  # the second drive
}
STATE_SIZES = {"presliding": 1e-4, "bouc_wen_hysteresis": 0.5, "dahl_hysteresis": 0.5, "electrical_lag": 3.0}
WIDE = {"belt_play": 2e-4, "belt_hardening": 2e-3}  # m, belt extension at which the effect is large


def random_points(machine: Machine, case: Case) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, float, float]]:
    """Return positions, velocities, voltages, time and the effect's state at random points in motion."""
    rng, count = np.random.default_rng(8), len(machine.coordinates)
    stretch = WIDE.get(case.name, 5e-4)
    points = []
    for _ in range(POINTS):
        xy = rng.uniform(-0.1, 0.1, 2)
        travel = np.zeros(count)
        travel[:4] = *xy, -(xy[0] + xy[1]), xy[0] - xy[1]
        if count == 10:  # the idlers
            travel[4:6], travel[6:8] = travel[2:4], (-xy[0] - travel[2], xy[0] - travel[3])
            travel[8:10] = -xy[0] - travel[4], xy[0] - travel[5]
        travel += stretch * rng.normal(size=count)
        speed = rng.uniform(0.01, 0.4, count) * rng.choice([-1.0, 1.0], count)
        scale = machine.travel_per_unit
        state = STATE_SIZES.get(case.name, 0.0) * rng.uniform(-1.0, 1.0)
        volts = rng.choice([0.2, 8.0]) * rng.uniform(-1.0, 1.0, 2)
        points.append((travel / scale, speed / scale, volts, rng.uniform(0.0, 1.0), state))
    return points


def oracle_rates(case: Case, q: np.ndarray, v: np.ndarray, volts: np.ndarray, t: float, state: float) -> np.ndarray:
    """Return the derivative of the simulator's state, with every coordinate sliding."""
    arrays, _ = parameter_arrays(dataclasses.replace(Rig(), **case.rig))
    count = len(arrays.coordinates)
    z = np.zeros(4 * count + EXTRA)
    z[:count], z[count : 2 * count] = q[:count], v[:count]
    if case.name == "frame_resonance":
        z[4 * count + 4 :] = q[4], v[4]
    if case.name in STATES:
        multiple, offset, factor = STATES[case.name]
        z[multiple * count + offset] = factor * state
    rates = np.zeros_like(z)
    derivative(t, z, volts, np.sign(v[:count]), arrays, rates, np.zeros(count), np.zeros(count))
    return rates


def own_rates(machine: Machine, case: Case, *point: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the accelerations in the coordinates' units, and the rate of the effect's state."""
    q, v, volts, t, state = point
    equations = Equations(machine)
    scale = machine.travel_per_unit
    states = dict.fromkeys(equations.states, state)
    motion = MotionPoint(list(q * scale), list(v * scale), t, states)
    accelerations = np.array(equations.accelerations(motion, list(volts)), float) / scale
    if not equations.states:
        return accelerations, 0.0
    voltages = equations.motor_voltages(list(volts))
    belts = equations.belt_forces(motion, equations.belt_states(motion))
    balance = equations.force_balance(motion, voltages, equations.add_drive_forces(belts, voltages))
    (k,), dt = equations.states, 1e-7
    after = equations.next_state(k, state, balance.arguments.get(k, {}), list(v * scale * dt), list(v * scale), dt)
    return accelerations, float(after - state) / dt


@pytest.mark.parametrize("case", DYNAMIC, ids=lambda case: case.name)
def test_accelerations_and_rates_agree(case: Case, hframe: Machine) -> None:
    machine = hframe.with_effects(case.effect)
    count = len(machine.coordinates) - (case.name == "frame_resonance")
    changed = 0
    for q, v, volts, t, state in random_points(machine, case):
        if case.name == "eccentric_pulley":  # the run started where the pulley's eccentricity draws no belt
            state = q[3] + case.parameters["p"]
        point = (q, v, volts, t, state)
        expected = oracle_rates(case, *point)
        accelerations, rate = own_rates(machine, case, *point)
        wanted = expected[count : 2 * count]
        if case.name == "frame_resonance":
            wanted = np.append(wanted, expected[-1])
        np.testing.assert_allclose(accelerations, wanted, rtol=1e-7, atol=1e-7)
        if case.name in STATES:
            multiple, offset, factor = STATES[case.name]
            assert rate == pytest.approx(expected[multiple * count + offset] / factor, rel=1e-3, abs=1e-3)
        if case.name == "eccentric_pulley":
            assert rate == pytest.approx(v[3], rel=1e-6)
        if not EFFECTS[case.name].structure:
            without, _ = own_rates(hframe, case, *point)
            changed += int(np.abs(accelerations - without).max() > 1e-3)
    assert changed > POINTS // 8 or EFFECTS[case.name].structure  # the points show the effect


def test_accelerations_without_effects_agree(hframe: Machine) -> None:
    case = Case("none", "", {})
    for point in random_points(hframe, case):
        expected = oracle_rates(case, *point)[4:8]
        np.testing.assert_allclose(own_rates(hframe, case, *point)[0], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["sensor_skew", "sensor_scale", "sensor_range"])
def test_readings_agree(name: str, hframe: Machine) -> None:
    case = CASES[name]
    machine = hframe.with_effects(case.effect)
    rng = np.random.default_rng(1)
    positions = np.column_stack([rng.uniform(0.07, 0.09, 30), rng.uniform(-0.1, 0.1, 30), *rng.normal(size=(2, 30))])
    expected = Sensors(**case.sensors).ideal(np.arange(30.0), positions, np.zeros_like(positions))
    readings = Equations(machine).sensor_readings(list(positions.T))
    np.testing.assert_allclose(np.array(readings).T, expected, rtol=1e-12)


def test_delays_are_those_of_the_effects(hframe: Machine) -> None:
    """The delay of a drive and that of a sensor, as parameters say."""
    d = CASES["input_delay"].parameters["d"]
    machine = hframe.with_effects(CASES["input_delay"].effect, CASES["sensor_delay"].effect)
    assert Equations(machine).voltage_delays() == [d, d]
    channel = machine.output_channels.index(CASES["sensor_delay"].site)
    assert Equations(machine).measurement_delays()[channel] == CASES["sensor_delay"].parameters["d"]


@pytest.mark.parametrize("name", ["presliding", "bouc_wen_hysteresis", "dahl_hysteresis", "electrical_lag"])
def test_a_long_step_of_a_state_equals_many_short_ones(name: str) -> None:
    """The closed solution over a finite step, with and without a reversal; the rate is tested above."""
    effect = CASES[name].effect
    for state in np.linspace(-0.9, 0.9, 7):
        for distance in (-8e-3, -1e-3, 1e-3, 3e-3, 2e-2):
            arguments = {"v": distance / 1e-2, "level": 1.5, "i": 4.0}
            z = state * (1.5e-4 if name == "presliding" else 1.0)
            long = effect("next_state", z=z, dq=distance, dt=1e-2, **arguments)
            short = z
            for _ in range(50):
                short = effect("next_state", z=short, dq=distance / 50, dt=1e-2 / 50, **arguments)
            assert long == pytest.approx(short, rel=1e-9, abs=1e-12)


def test_an_eccentric_pulley_at_rest_has_drawn_as_much_belt_as_a_round_one() -> None:
    """The lag is exact to the second order of eccentricity / radius."""
    case, radius = CASES["eccentric_pulley"], 0.0194
    e, p = case.parameters["e"], case.parameters["p"]
    for q in np.linspace(-3.0, 3.0, 13):
        angle = q - float(case.effect("rest_angle_offset", q=q, per_radius=1.0 / radius))
        assert radius * angle + e * np.sin(angle + p) == pytest.approx(radius * q, abs=1.01 * e**2 / radius)
    turned = case.effect("lever_arm", q=1.0, z=1.0 + p, per_radius=1.0 / radius)  # started where the lag is zero
    assert turned == pytest.approx(e * np.cos(1.0 + p))
    # Started at q = 0 instead, where the pulley lags: the arm is that of the lagging eccentricity.
    lag = e * np.sin(p) / radius
    assert case.effect("lever_arm", q=1.0, z=1.0, per_radius=1.0 / radius) == pytest.approx(e * np.cos(1.0 + p - lag))
    travel = e * (np.sin(1.0 + p - lag) - np.sin(p - lag))
    assert case.effect("belt_travel", q=1.0, z=1.0, per_radius=1.0 / radius) == pytest.approx(travel)
