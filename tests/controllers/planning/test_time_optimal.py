"""Tests of the time-optimal motions: closed forms, the simulator, and effects."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.optimize import brentq

from hframe_gym.dynamics import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Machine, rest_state

pytestmark = pytest.mark.integration

casadi = pytest.importorskip("casadi")

from hframe_gym.controllers.models.casadi_model import SymbolicModel  # noqa: E402
from hframe_gym.controllers.planning.time_optimal import HOLD_S, TimeOptimalReach  # noqa: E402

BAND = 2e-4
HFRAME, AXIS = BUILTIN_MACHINES["hframe"](), BUILTIN_MACHINES["axis"]()
START, GOAL = (-0.1, 0.05), (-0.06, 0.02)


@pytest.fixture(scope="module")
def hframe_problem() -> TimeOptimalReach:
    """Return the problem of the H-frame; it has no memory."""
    return TimeOptimalReach(HFRAME, band=BAND)


def bang_bang_time(machine: Machine, distance: float, band: float) -> float:
    """Return the least time, s, of m v' = +-F - b v - f into the band.

    Full force, then full braking to rest at the far edge of the band: no motion that stays within the band
    afterwards passes its near edge earlier.
    """
    c, d = machine.coordinates[0], machine.drives[0]
    viscous = c.viscous + d.back_emf
    tau, force = c.mass / viscous, d.gain * d.rated_voltage
    top_speed, braking_speed = (force - c.coulomb) / viscous, (force + c.coulomb) / viscous

    def accelerated(t: float) -> tuple[float, float]:
        return top_speed * (1.0 - np.exp(-t / tau)), top_speed * (t - tau * (1.0 - np.exp(-t / tau)))

    def braking_time(speed: float) -> float:
        return float(tau * np.log1p(speed / braking_speed))

    def braking_distance(speed: float, t: float) -> float:
        return float((speed + braking_speed) * tau * (1.0 - np.exp(-t / tau)) - braking_speed * t)

    def beyond_far_edge(t: float) -> float:
        speed, x = accelerated(t)
        return x + braking_distance(speed, braking_time(speed)) - (distance + band)

    switch = brentq(beyond_far_edge, 1e-9, 10.0)
    speed, x = accelerated(switch)
    return float(
        switch
        + brentq(lambda t: x + braking_distance(speed, t) - (distance - band), 0.0, braking_time(speed))
    )


@pytest.mark.oracle
@pytest.mark.parametrize("coulomb", [0.0, 1.0])
def test_rigid_axis_agrees_with_the_bang_bang_solution(coulomb: float) -> None:
    axis = AXIS.replace({"x.coulomb": coulomb})
    problem = TimeOptimalReach(axis, band=BAND)
    for distance in (0.02, -0.1, 0.3):
        motion = problem.solve([0.0], [distance])
        assert motion.solved
        assert motion.time_s == pytest.approx(bang_bang_time(axis, abs(distance), BAND), abs=5e-5)


@pytest.mark.oracle
def test_a_constant_force_changes_the_bang_bang_solution_of_an_axis() -> None:
    """A force against the motion acts like Coulomb friction while moving and more force while braking."""
    axis = AXIS.replace({"x.coulomb": 0.0})
    pushed = axis.with_effects(EFFECTS["constant_force"].at("x", size=-1.0))
    motion = TimeOptimalReach(pushed, band=BAND).solve([0.0], [0.1])
    assert motion.solved
    assert motion.time_s == pytest.approx(
        bang_bang_time(axis.replace({"x.coulomb": 1.0}), 0.1, BAND), abs=5e-5
    )


@pytest.mark.oracle
def test_a_wider_band_is_reached_earlier() -> None:
    times = [TimeOptimalReach(AXIS, band=band).solve([0.0], [0.1]).time_s for band in (2e-4, 1e-3)]
    expected = [bang_bang_time(AXIS, 0.1, band) for band in (2e-4, 1e-3)]
    assert np.diff(times) == pytest.approx(np.diff(expected), abs=5e-5)
    assert times[1] < times[0] - 2e-3


EFFECT_SETS: Mapping[str, tuple] = {
    "none": (),
    "friction": (
        EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.5),
        EFFECTS["asymmetric_viscous"].at("y", a=0.3),
    ),
    "forces": (
        EFFECTS["constant_force"].at("y", size=5.0),
        EFFECTS["cogging"].at("motor1", A=0.03, n=24.0, p=0.5),
    ),
    "eccentric pulley": (EFFECTS["eccentric_pulley"].at("motor2", e=3e-4, p=0.5),),
    "voltage offset": (EFFECTS["voltage_offset"].at("motor1", V0=0.5),),
    "belt hardening": (EFFECTS["belt_hardening"].at("belts", h=2e4),),
}


@pytest.mark.parametrize("effects", EFFECT_SETS)
def test_symbolic_equations_agree_with_the_simulator(effects: str) -> None:
    """The reference is the velocity change over a very short step, where friction does not reverse."""
    machine = HFRAME.with_effects(*EFFECT_SETS[effects])
    rng, h = np.random.default_rng(0), 1e-7
    P = casadi.SX.sym("P", len(machine.parameters))
    begin = casadi.SX.sym("begin", 8)
    model = SymbolicModel(machine, P, begin, 1e-3)
    values = np.array(list(machine.parameters.values()))
    low, high = (
        np.array([[-12.0, -12.0], [12.0, 12.0]])
        + (0.5 if effects == "voltage offset" else 0.0) * np.eye(2)[0]
    )
    scale = machine.travel_per_unit
    for _ in range(5):
        start = rest_state(machine, rng.uniform(-0.15, 0.15, 2))
        start[2:4] += 0.2 * rng.uniform(-1.0, 1.0, 2)  # stretches belts by millimeters
        start[4:] = rng.choice([-1.0, 1.0], 4) * rng.uniform(0.3, 1.0, 4) / scale
        volts = rng.uniform(-11.0, 11.0, 2)
        motion = simulate_batch(machine, np.array([0.0, h]), np.tile(volts, (2, 1)), start=start)
        expected = (motion.velocities[0, 1] - motion.velocities[0, 0]) / h * scale
        motor_volts = volts + np.array([0.5, 0.0]) * (effects == "voltage offset")
        action = (motor_volts - 0.5 * (low + high)) / (0.5 * (high - low))
        state = start * np.tile(scale, 2)
        rate = np.array(model._rate(state, action, 0.0, values, state)).ravel()
        np.testing.assert_allclose(rate[4:], expected, rtol=1e-4, atol=2e-2)


def test_the_voltages_bring_the_simulated_stage_into_the_band(hframe_problem: TimeOptimalReach) -> None:
    """Without feedback; smoothed friction may leave the tool outside the band by its radius."""
    motion = hframe_problem.solve(START, GOAL)
    assert motion.solved
    assert np.all(np.abs(motion.volts) <= 12.0 + 1e-6)
    assert motion.edges_s[-1] == pytest.approx(motion.time_s + HOLD_S)
    held = np.concatenate([motion.volts, motion.volts[-1:]])
    simulated = simulate_batch(
        HFRAME, motion.edges_s, held, start=rest_state(HFRAME, START), longest_step=5e-5
    )
    error = np.linalg.norm(simulated.positions[0][:, :2] - GOAL, axis=1)
    arrived = motion.edges_s >= motion.time_s
    assert np.all(error[~arrived] > BAND)
    assert np.all(error[arrived] < 2.0 * BAND)


def test_a_mirrored_motion_takes_as_long(hframe_problem: TimeOptimalReach) -> None:
    motion = hframe_problem.solve([-0.1, 0.05], [0.0, -0.05])
    mirrored = hframe_problem.solve([-0.1, -0.05], [0.0, 0.05])
    assert mirrored.time_s == pytest.approx(motion.time_s, abs=2e-5)


@pytest.mark.parametrize(
    ("effects", "slower"),
    [
        (("stribeck_friction", "x", {"dF": 10.0, "vs": 1.0}), True),
        (("constant_force", "x", {"size": -10.0}), True),
        (("constant_force", "x", {"size": 10.0}), False),
        (("dead_band", "motor1", {"Vd": 1.0, "drop": 1.0}), True),
        (("current_limit", "motor1", {"I": 7.0}), True),
        (("asymmetric_viscous", "x", {"a": 0.5}), True),
    ],
)
def test_effects_change_the_least_time_in_the_plausible_direction(
    hframe_problem: TimeOptimalReach, effects: tuple[str, str, dict[str, float]], slower: bool
) -> None:
    """Of a motion along +x."""
    name, site, parameters = effects
    machine = HFRAME.with_effects(EFFECTS[name].at(site, **parameters))
    start, goal = (-0.05, 0.0), (0.05, 0.0)
    plain = hframe_problem.solve(start, goal)
    changed = TimeOptimalReach(machine, band=BAND).solve(start, goal)
    assert plain.solved
    assert changed.solved
    assert np.all(np.abs(changed.volts) <= 12.0 + 1e-6)
    assert (changed.time_s > plain.time_s + 1e-4) is slower
    assert abs(changed.time_s - plain.time_s) < 0.3 * plain.time_s


def test_a_small_dead_band_does_not_change_the_least_time(hframe_problem: TimeOptimalReach) -> None:
    """A switch leaves the largest voltages as they are."""
    machine = HFRAME.with_effects(EFFECTS["dead_band"].at("motor1", Vd=0.4, drop=0.0))
    motion = TimeOptimalReach(machine, band=BAND).solve(START, GOAL)
    assert motion.time_s == pytest.approx(hframe_problem.solve(START, GOAL).time_s, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "site", "reason"),
    [
        ("input_delay", "drives", "dead time of the drives"),
        ("presliding", "x", "has a memory"),
        ("electrical_lag", "motor1", "has a memory"),
        ("belt_play", "belts", "not differentiable"),
        ("belt_slack", "left", "not differentiable"),
        ("electrical_lag", "drives", "memory"),
        ("frame_resonance", "x", "moves a sensor"),
        ("belt_slack", "belts", "not differentiable"),
    ],
)
def test_unsupported_effects_are_rejected_with_the_reason(name: str, site: str, reason: str) -> None:
    definition = EFFECTS[name]
    values = {p.name: min(max(p.lower, 0.01), p.upper) for p in definition.parameters}
    with pytest.raises(InputError, match=f"{name}@{site}: .*{reason}"):
        TimeOptimalReach(HFRAME.with_effects(definition.at(site, **values)))


def test_effects_of_sensors_do_not_matter(hframe_problem: TimeOptimalReach) -> None:
    machine = HFRAME.with_effects(EFFECTS["sensor_delay"].at("x_m", d=0.01))
    motion = TimeOptimalReach(machine, band=BAND).solve(START, GOAL)
    assert motion.time_s == pytest.approx(hframe_problem.solve(START, GOAL).time_s, abs=1e-7)


def test_a_missing_casadi_is_reported_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    monkeypatch.delitem(sys.modules, "hframe_gym.controllers.planning.time_optimal")
    with pytest.raises(ImportError, match=r"hframe_gym\[bound\]"):
        importlib.import_module("hframe_gym.controllers.planning.time_optimal")


def test_a_fast_motor_turns_in_the_least_time_whatever_the_radius_of_its_coordinate() -> None:
    motor = BUILTIN_MACHINES["motor"]()
    for radius in (0.02, 0.1, 1.0):  # m; without a belt it has no influence
        machine = motor.replace({"shaft.radius": radius})
        motion = TimeOptimalReach(machine, band=2e-3, reversal_speed=0.01 * radius).solve((0.0,), (3.0,))
        assert motion.solved
        assert motion.time_s == pytest.approx(bang_bang_time(motor, 3.0, 2e-3), rel=0.01)
