"""Accelerations and rates of states with each effect, at random points, against independent equations.

Nothing is integrated and no kernel is compiled, so that a wrong sign or factor is found within a second.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import (
    Equations,
    MotionPoint,
    belt_forces,
    belt_states,
    effect_forces,
    kernel_source_text,
    net_forces,
)
from hframe_gym.dynamics.elementwise import where
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Effect, EffectParameter, Machine
from tests.effects.one_of_each import CASES, Case
from tests.reference_simulator import Rig
from tests.reference_simulator.equations import derivative, state_size
from tests.reference_simulator.parameter_arrays import parameter_arrays
from tests.reference_simulator.sensors import Sensors

pytestmark = pytest.mark.oracle

POINTS = 40
DELAYS = {"input_delay", "sensor_delay"}  # no quantity of a single point
DYNAMIC = [case for case in CASES.values() if case.rig and case.name not in DELAYS]
# Entry of the simulator's state (offset in multiples of the number of coordinates, constant) and its factor
# per unit of the effect's state.
STATES = {
    "presliding": (2, 2, 1.0),
    "bouc_wen_hysteresis": (3, 2, CASES["bouc_wen_hysteresis"].parameters["L"]),
    "dahl_hysteresis": (3, 2, CASES["dahl_hysteresis"].parameters["L"]),
    "dwell_friction": (4, 6, 1.0),
    "electrical_lag": (2, 1, 1.0),  # the second drive
    "winding_heat": (4, 2, 1.0),
    "supply_sag": (5, 8, 1.0),
}
STATE_SIZES = {
    "presliding": 1e-4,
    "bouc_wen_hysteresis": 0.5,
    "dahl_hysteresis": 0.5,
    "electrical_lag": 3.0,
    "winding_heat": 20.0,
    "supply_sag": 0.2,
    "dwell_friction": 0.05,
}
# Of two coordinates at a gear, the simulator appends the motor's side and the package the far one.
ORDER = {"gear_backlash": [0, 1, 4, 3, 2]}
WIDE = {"belt_play": 2e-4, "belt_hardening": 2e-3}  # m, belt extension at which the effect is large


def random_points(
    machine: Machine, case: Case
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, float, float]]:
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
        for contact in machine.contacts:
            near, far = (machine.coordinate_names.index(name) for name in (contact.near, contact.far))
            travel[far] = travel[near]
        travel += stretch * rng.normal(size=count)
        speed = rng.uniform(0.01, 0.4, count) * rng.choice([-1.0, 1.0], count)
        scale = machine.travel_per_unit
        state = STATE_SIZES.get(case.name, 0.0) * rng.uniform(-1.0, 1.0)
        volts = rng.choice([0.2, 8.0]) * rng.uniform(-1.0, 1.0, 2)
        points.append((travel / scale, speed / scale, volts, rng.uniform(0.0, 1.0), state))
    return points


def oracle_rates(
    case: Case, q: np.ndarray, v: np.ndarray, volts: np.ndarray, t: float, state: float
) -> np.ndarray:
    """Return the derivative of the simulator's state, with every coordinate sliding."""
    arrays, _ = parameter_arrays(dataclasses.replace(Rig(), **case.rig))
    count = len(arrays.coordinates)
    z = np.zeros(state_size(arrays))
    z[:count], z[count : 2 * count] = q[:count], v[:count]
    if case.name == "frame_resonance":
        z[4 * count + 4 : 4 * count + 6] = q[4], v[4]
    if case.name == "payload_swing":  # the simulator has the load's position, not its deflection
        z[4], z[count + 4] = q[1] + q[4], v[1] + v[4]
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
    k, dt = equations.states[0], 1e-7
    after = equations.next_state(
        k, state, balance.arguments.get(k, {}), list(v * scale * dt), list(v * scale), dt
    )
    return accelerations, float(after - state) / dt


@pytest.mark.parametrize("case", DYNAMIC, ids=lambda case: case.name)
def test_accelerations_and_rates_agree(case: Case, hframe: Machine) -> None:
    machine = hframe.with_effects(case.effect)
    count = len(machine.coordinates) - (case.name == "frame_resonance")
    changed = 0
    for q, v, volts, t, state in random_points(machine, case):
        if case.name == "eccentric_pulley":  # the run started where the pulley's eccentricity draws no belt
            state = q[3] + case.parameters["p"]
        order, age = ORDER.get(case.name, slice(None)), abs(state)
        if case.name == "dwell_friction":
            state = np.log1p(age / case.parameters["tau"])
        point = (q, v, volts, t, state)
        in_oracle = age if case.name == "dwell_friction" else state
        expected = oracle_rates(case, q[order], v[order], volts, t, in_oracle)
        accelerations, rate = own_rates(machine, case, *point)
        wanted = expected[count : 2 * count][order]
        if case.name == "frame_resonance":
            wanted = np.append(wanted, expected[4 * count + 5])  # the rate of the frame's velocity
        if case.name == "payload_swing":
            wanted[4] -= wanted[1]
        np.testing.assert_allclose(accelerations, wanted, rtol=1e-7, atol=1e-7)
        if case.name in STATES:
            multiple, offset, factor = STATES[case.name]
            if case.name == "dwell_friction":
                rate *= case.parameters["tau"] + age
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
    positions = np.column_stack(
        [rng.uniform(0.07, 0.09, 30), rng.uniform(-0.1, 0.1, 30), *rng.normal(size=(2, 30))]
    )
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


@pytest.mark.parametrize(
    "name", ["presliding", "bouc_wen_hysteresis", "dahl_hysteresis", "electrical_lag", "supply_sag"]
)
def test_a_long_step_of_a_state_equals_many_short_ones(name: str) -> None:
    """The closed solution over a finite step, with and without a reversal; the rate is tested above."""
    effect = CASES[name].effect
    for state in np.linspace(-0.9, 0.9, 7):
        for distance in (-8e-3, -1e-3, 1e-3, 3e-3, 2e-2):
            arguments = {"v": distance / 1e-2, "level": 1.5, "i": 4.0, "power": 40.0, "stall_power": 90.0}
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
    # Started where the lag is zero.
    turned = case.effect("lever_arm", q=1.0, z=1.0 + p, per_radius=1.0 / radius)
    assert turned == pytest.approx(e * np.cos(1.0 + p))
    # Started at q = 0 instead, where the pulley lags: the arm is that of the lagging eccentricity.
    lag = e * np.sin(p) / radius
    assert case.effect("lever_arm", q=1.0, z=1.0, per_radius=1.0 / radius) == pytest.approx(
        e * np.cos(1.0 + p - lag)
    )
    travel = e * (np.sin(1.0 + p - lag) - np.sin(p - lag))
    assert case.effect("belt_travel", q=1.0, z=1.0, per_radius=1.0 / radius) == pytest.approx(travel)


def test_forces_along_a_motion_are_mass_times_acceleration(hframe: Machine) -> None:
    """Arrays over samples in the coordinates' units, and positions without velocities."""
    case = Case("none", "", {})
    points = random_points(hframe, case)
    q, v, volts = (np.array([point[k] for point in points]) for k in range(3))
    mass = np.array([c.mass for c in hframe.coordinates])
    expected = mass * np.array([own_rates(hframe, case, *point)[0] for point in points])
    forces = net_forces(hframe, np.arange(len(q)) * 1e-3, q, v, volts)
    np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=1e-9)
    equations = Equations(hframe)
    point = equations.point(q[0])
    assert point.speed == [0.0] * 4
    np.testing.assert_allclose(equations.in_units(point.travel), q[0] * hframe.travel_per_unit**2)


def _push(q: Any, F: Any) -> Any:
    return 0.0 * q + F


def _beyond(q: Any, limit: Any) -> Any:
    return q > limit


def _wall(q: Any, limit: Any, k: Any) -> Any:
    return where(q > limit, -k * (q - limit), 0.0)


def _inertial(m: Any, net: Any, friction: Any, r: Any) -> Any:
    return m * r + 2.0 * net + 3.0 * friction


def test_forces_behind_a_branch_add_to_the_others(hframe: Machine) -> None:
    """Two walls on one coordinate and one on another, in all combinations; beside an ordinary force."""
    limit = EffectParameter("limit", "position", -1.0, 1.0, scale=1.0)
    stiffness = EffectParameter("k", "stiffness", 0.0, 1e6, scale=1.0)
    fields = {"family": "test", "site": "coordinate", "formula": "", "source": ""}
    walls = [
        Effect(name=f"wall{i}", parameters=(limit, stiffness), force=_wall, active_region=_beyond, **fields)
        for i in range(2)
    ]
    push = Effect(
        name="push", parameters=(EffectParameter("F", "force", 0.0, 9.0, scale=1.0),), force=_push, **fields
    )
    machine = hframe.with_effects(
        walls[0].at("x", limit=0.01, k=100.0),
        walls[1].at("x", limit=0.03, k=1000.0),
        walls[0].at("phi1", limit=0.5, k=2.0),
        push.at("y", F=4.0),
    )
    for x, phi, on_x, on_phi in ((0.0, 0.0, 0.0, 0.0), (0.02, 0.0, -1.0, 0.0), (0.05, 0.6, -24.0, -0.2)):
        q = np.array([[x, 0.0, phi, 0.0]])
        change = effect_forces(machine, np.zeros(1), q, np.zeros_like(q), np.zeros((1, 2)))
        np.testing.assert_allclose(change, [[on_x, 4.0, on_phi, 0.0]], atol=1e-9)
    # The kernel evaluates the three forces where any of the three acts.
    conditions = re.findall(r"if any_of\((.* \| .*)\):", kernel_source_text(machine))
    assert [len(set(condition.split(" | "))) for condition in conditions] == [3, 3]


@pytest.mark.parametrize("speed", [0.2, -0.2, 0.0])
def test_reactions_take_mass_net_force_and_friction_of_the_site(hframe: Machine, speed: float) -> None:
    """In the units of a rotary coordinate too: the inertia, the net torque and the torque of friction."""
    fields = {"family": "test", "site": "coordinate", "formula": "", "source": ""}
    reaction = Effect(
        name="reaction",
        parameters=(EffectParameter("r", "1", -9.0, 9.0, scale=1.0),),
        force=_inertial,
        **fields,
    )
    machine = hframe.with_effects(reaction.at("phi1", r=0.5))
    q, v = np.zeros((1, 4)), np.array([[0.0, 0.0, speed / 0.0194, 0.0]])
    volts = np.array([[0.3, 0.0]])
    change = effect_forces(machine, np.zeros(1), q, v, volts)[0, 2]
    c, drive = hframe.coordinate("phi1"), hframe.drives[0]
    torque = drive.gain * 0.3
    viscous = (c.viscous + drive.back_emf) * v[0, 2]
    dry = np.sign(speed) * c.coulomb if speed else np.clip(torque, -c.coulomb, c.coulomb)
    friction = viscous + dry
    assert change == pytest.approx(0.5 * c.mass + 2.0 * (torque - friction) + 3.0 * friction)


def _constant_travel(q: Any, a: Any) -> Any:
    return a * q


def _constant_arm(a: Any) -> Any:
    return a


def test_effects_on_the_travel_of_one_pulley_add_up(hframe: Machine) -> None:
    """Three pulleys that draw more belt per angle, on the shaft of one motor, equal a larger radius."""
    larger = [
        Effect(
            name=f"larger{i}",
            family="test",
            site="motor",
            formula="",
            source="",
            parameters=(EffectParameter("a", "m", 0.0, 1.0, scale=1.0),),
            belt_travel=_constant_travel,
            lever_arm=_constant_arm,
        )
        for i in range(3)
    ]
    effects = [effect.at("motor1", a=a) for effect, a in zip(larger, (1e-3, 2e-3, 3e-3), strict=True)]
    machine = hframe.with_effects(*effects)
    wider = hframe.replace({"phi1.radius": hframe.coordinate("phi1").radius + 6e-3})
    rng = np.random.default_rng(3)
    for _ in range(5):
        q, v = rng.normal(size=4) * 1e-3, rng.normal(size=4)
        np.testing.assert_allclose(belt_forces(machine, q, v), belt_forces(wider, q, v), rtol=1e-9)
        for state, expected in zip(belt_states(machine, q, v), belt_states(wider, q, v), strict=True):
            np.testing.assert_allclose(state.rate, expected.rate, rtol=1e-9)


def test_a_belt_of_constant_stiffness_and_one_with_two_effects(hframe: Machine) -> None:
    """Tensions of several effects add; the elastic energy is that of the stretch which each leaves."""
    play, hardening = CASES["belt_play"].effect, CASES["belt_hardening"].effect
    q = np.array([2e-3, 1e-3, 0.02, 0.03])
    plain, first, second, both = (
        belt_states(hframe.with_effects(*effects), q)
        for effects in ((), (play,), (hardening,), (play, hardening))
    )
    for a, b, c, d in zip(plain, first, second, both, strict=True):
        assert d.tension == pytest.approx(b.tension + c.tension - a.tension, rel=1e-12)
        assert d.stiffness_force == pytest.approx(
            b.stiffness_force + c.stiffness_force - a.stiffness_force, rel=1e-9
        )
        assert d.net_tension == pytest.approx(d.tension - d.stiffness_force, rel=1e-12)
        assert a.net_tension == pytest.approx(a.tension - a.stiffness_force, rel=1e-12)
    constant = BUILTIN_MACHINES["hframe-linear"]()
    for state, belt in zip(belt_states(constant, q), constant.belts, strict=True):
        extension = float(constant.coefficients(belt.extension) @ (q * constant.travel_per_unit))
        assert state.tension == state.net_tension == pytest.approx(belt.EA / belt.rest_length * extension)
        assert state.stiffness_force == 0.0
