from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
from scipy.optimize import brentq

from hframe_gym.dynamics.simulation import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.machine.kinematics import rest_state

pytest.importorskip("casadi")

from hframe_gym.controllers.casadi_model import equations
from hframe_gym.controllers.time_optimal import HOLD_S, TimeOptimalReach

BAND = 2e-4
HFRAME, AXIS = BUILTIN_MACHINES["hframe"](), BUILTIN_MACHINES["axis"]()


@pytest.fixture(scope="module")
def hframe() -> TimeOptimalReach:
    return TimeOptimalReach(HFRAME, band=BAND)


def bang_bang(machine: Machine, way: float, band: float) -> float:
    """When m v' = +-F - b v - f, from rest at full force and then full brake to rest at the band's far edge, passes its
    near edge: no motion that stays within the band from then on passes it earlier."""
    c, d = machine.coordinates[0], machine.drives[0]
    viscous = c.viscous + d.back_emf
    tau, force = c.mass / viscous, d.gain * d.rated_voltage
    fast, brake = (force - c.coulomb) / viscous, (force + c.coulomb) / viscous

    def pushed(t: float) -> tuple[float, float]:
        return fast * (1.0 - np.exp(-t / tau)), fast * (t - tau * (1.0 - np.exp(-t / tau)))

    def braking(speed: float) -> float:
        return float(tau * np.log1p(speed / brake))

    def travel(speed: float, t: float) -> float:
        return float((speed + brake) * tau * (1.0 - np.exp(-t / tau)) - brake * t)

    def beyond(t: float) -> float:
        speed, x = pushed(t)
        return x + travel(speed, braking(speed)) - (way + band)

    switch = brentq(beyond, 1e-9, 10.0)
    speed, x = pushed(switch)
    return float(switch + brentq(lambda t: x + travel(speed, t) - (way - band), 0.0, braking(speed)))


@pytest.mark.parametrize("coulomb", [0.0, 1.0])
def test_a_rigid_axis_takes_what_bang_bang_takes(coulomb: float) -> None:
    axis = AXIS.replace({"x.coulomb": coulomb})
    problem = TimeOptimalReach(axis, band=BAND)
    for way in (0.02, -0.1, 0.3):
        found = problem.solve([0.0], [way])
        assert found.solved
        assert found.time_s == pytest.approx(bang_bang(axis, abs(way), BAND), abs=5e-5)


def test_a_wider_band_is_reached_earlier() -> None:
    times = [TimeOptimalReach(AXIS, band=band).solve([0.0], [0.1]).time_s for band in (2e-4, 1e-3)]
    expected = [bang_bang(AXIS, 0.1, band) for band in (2e-4, 1e-3)]
    assert np.diff(times) == pytest.approx(np.diff(expected), abs=5e-5)
    assert times[1] < times[0] - 2e-3


def test_the_equations_are_those_of_the_kernel() -> None:
    """Two codes, one machine: a change of speed over a very short step, away from speeds where friction turns over."""
    rng = np.random.default_rng(0)
    rate = equations(HFRAME).rate
    h = 1e-7
    for _ in range(5):
        state = rest_state(HFRAME, rng.uniform(-0.15, 0.15, 2))
        state[:4] += np.array([0.0, 0.0, 0.2, 0.2]) * rng.uniform(-1.0, 1.0, 4)  # belts stretched by millimetres
        state[4:] = rng.choice([-1.0, 1.0], 4) * rng.uniform(0.3, 1.0, 4) / HFRAME.radii
        volts = rng.uniform(-12.0, 12.0, 2)
        motion = simulate_batch(HFRAME, np.array([0.0, h]), np.tile(volts, (2, 1)), start=state)
        scale = HFRAME.radii
        expected = (motion.velocities[0, 1] - motion.velocities[0, 0]) / h * scale
        values = np.array(list(HFRAME.parameters.values()))
        found = np.array(rate(state * np.tile(scale, 2), volts / 12.0, values, 1e-3)).ravel()
        np.testing.assert_allclose(found[4:], expected, rtol=1e-4, atol=1e-2)


def test_the_voltages_take_the_exact_stage_into_the_band(hframe: TimeOptimalReach) -> None:
    """Without feedback, so that smoothed friction may leave the tool beside the band by as much again."""
    found = hframe.solve([-0.1, 0.05], [-0.06, 0.02])
    assert found.solved
    assert np.all(np.abs(found.volts) <= 12.0 + 1e-6)
    assert found.edges_s[-1] == pytest.approx(found.time_s + HOLD_S)
    held = np.concatenate([found.volts, found.volts[-1:]])
    motion = simulate_batch(HFRAME, found.edges_s, held, start=rest_state(HFRAME, [-0.1, 0.05]), longest_step=5e-5)
    off = np.linalg.norm(motion.positions[0][:, :2] - [-0.06, 0.02], axis=1)
    arrived = found.edges_s >= found.time_s
    assert np.all(off[~arrived] > BAND)
    assert np.all(off[arrived] < 2.0 * BAND)


def test_a_mirrored_stage_takes_as_long(hframe: TimeOptimalReach) -> None:
    there, mirrored = hframe.solve([-0.1, 0.05], [0.0, -0.05]), hframe.solve([-0.1, -0.05], [0.0, 0.05])
    assert mirrored.time_s == pytest.approx(there.time_s, abs=2e-5)


def test_refuses_effects() -> None:
    with pytest.raises(ValueError, match="has effects"):
        TimeOptimalReach(HFRAME.with_effects(EFFECTS["constant_force"].at("x", size=1.0)))


def test_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    monkeypatch.delitem(sys.modules, "hframe_gym.controllers.time_optimal")
    with pytest.raises(ImportError, match=r"hframe_gym\[bound\]"):
        importlib.import_module("hframe_gym.controllers.time_optimal")
