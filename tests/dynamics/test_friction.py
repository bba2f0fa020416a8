"""The closed-form flow with friction against an integration with events (SciPy)."""

from __future__ import annotations

from decimal import Decimal

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hframe_gym.dynamics import LANES
from hframe_gym.dynamics.physics import friction
from tests.dynamics.lanes import run

pytestmark = pytest.mark.oracle


FLOW = """
def f(A, h: float, out):
    v = load(A, 0)
    f = load(A, 1)
    coulomb = load(A, 2)
    viscous = load(A, 3)
    mass = load(A, 4)
    z = viscous * h / mass
    gain = h / mass * decay_integral(z)
    decay = 1.0 - z * decay_integral(z)
    after = update_speed(v, f, coulomb, decay, gain)
    weight = end_weight(z)
    travel = h * ((1.0 - weight) * v + weight * after)
    turned, turned_travel = stop_or_reverse(v, f, coulomb, viscous, viscous, mass, 1.0 / mass, h)
    stops = v * after < 0.0
    store(out, 0, where(stops, turned, after))
    store(out, 1, where(stops, turned_travel, travel))
"""


def exact(v: float, f: float, coulomb: float, viscous: float, mass: float, h: float) -> tuple[float, float]:
    """Return speed and travel after h, integrated from event to event."""
    t, travel = 0.0, 0.0
    while t < h:
        if v == 0.0 and abs(f) <= coulomb:
            return 0.0, travel
        sign = np.sign(v) if v != 0.0 else np.sign(f)

        def rate(_: float, s: np.ndarray, sign: float = sign) -> list[float]:
            return [s[1], (f - viscous * s[1] - coulomb * sign) / mass]

        def stops(_: float, s: np.ndarray, sign: float = sign) -> float:
            return float(sign * s[1]) if s[1] != 0.0 else 1.0

        stops.terminal, stops.direction = True, -1  # type: ignore[attr-defined]
        piece = solve_ivp(rate, (t, h), [0.0, v], events=stops, rtol=1e-11, atol=1e-15)
        travel += piece.y[0, -1]
        t = piece.t[-1]
        v = 0.0 if piece.status == 1 else piece.y[1, -1]
    return v, travel


@pytest.mark.parametrize("viscous", [0.0, 3.0, 800.0])
def test_flow_agrees_with_event_integration(viscous: float) -> None:
    """Lanes: no stop, stop and rest, stop and reversal, breakaway and static friction, in both directions."""
    h, mass, coulomb = 1e-3, 0.3, 2.0
    v = np.resize([0.5, 0.004, 0.004, -0.004, 0.0, 0.0, 0.0, -0.3], LANES)
    f = np.resize([1.0, -1.0, -6.0, 9.0, 1.9, -2.5, 0.0, -4.0], LANES)
    A = np.array([v, f, np.full(LANES, coulomb), np.full(LANES, viscous), np.full(LANES, mass)])
    out = np.empty((2, LANES))
    run(FLOW, A, h, out)
    expected = np.array([exact(v[i], f[i], coulomb, viscous, mass, h) for i in range(LANES)]).T
    np.testing.assert_allclose(out[0], expected[0], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(out[1], expected[1], rtol=1e-7, atol=1e-13)
    assert out[0, 4] == out[0, 6] == 0.0


WEIGHTS = """
def f(A, out, n: int):
    for i in range(n):
        store(out, 2 * i, decay_integral(load(A, i)))
        store(out, 2 * i + 1, end_weight(load(A, i)))
"""


def test_series_agree_with_closed_forms_over_ten_decades() -> None:
    """The functions of b h/m by which a step weights force and speed."""
    z = np.logspace(-8, 2, 50 * LANES).reshape(-1, LANES)
    out = np.empty((2 * len(z), LANES))
    run(WEIGHTS, z, out, len(z))
    np.testing.assert_allclose(out[0::2], -np.expm1(-z) / z, rtol=3e-12)
    # 1/(1 - e^-z) - 1/z cancels for small z; there its series is 1/2 + z/12.
    expected = np.where(z < 1e-2, 0.5 + z / 12 - z**3 / 720, -1 / np.expm1(-z) - 1 / z)
    np.testing.assert_allclose(out[1::2], expected, rtol=1e-11)


def test_weights_without_compilation() -> None:
    """The series and the closed forms, on both sides of the point where they change over, to rounding."""
    for z in np.concatenate([np.linspace(1e-3, 0.5, 200), np.linspace(0.501, 30.0, 50)]):
        z_exact = Decimal(float(z))
        decay = 1 - (-z_exact).exp()
        point = np.array([z])
        assert friction.decay_integral(point)[0] == pytest.approx(float(decay / z_exact), rel=3e-14)
        assert friction.end_weight(point)[0] == pytest.approx(float(1 / decay - 1 / z_exact), rel=2e-12)
        for signed in (z, -z):
            exact = Decimal(float(signed))
            expected = float((exact - 1 + (-exact).exp()) / (exact * exact))
            assert friction.ramp(np.array([signed]))[0] == pytest.approx(expected, rel=1e-12)
    mixed = np.array([0.1, 3.0])  # one lane on each side
    np.testing.assert_allclose(friction.decay_integral(mixed), -np.expm1(-mixed) / mixed, rtol=1e-14)


@pytest.mark.parametrize("viscous", [0.0, 3.0, 800.0])
def test_flow_without_compilation(viscous: float) -> None:
    """The cases of `test_flow_agrees_with_event_integration`, with another coefficient after a reversal."""
    h, mass, coulomb = 1e-3, 0.3, 2.0
    v = np.array([0.5, 0.004, 0.004, -0.004, 0.0, 0.0, 0.0, -0.3, 0.0066])
    f = np.array([1.0, -1.0, -6.0, 9.0, 1.9, -2.5, 0.0, -4.0, 0.0])
    z = viscous * h / mass * np.ones_like(v)
    gain, weight = h / mass * friction.decay_integral(z), friction.end_weight(z)
    after = friction.update_speed(v, f, coulomb, np.exp(-z), gain)
    stopped = v * after < 0.0
    arguments = (v, f, coulomb, viscous * np.ones_like(v))
    turned, turned_travel = friction.stop_or_reverse(*arguments, arguments[3], mass, 1.0 / mass, h)
    travel = np.where(stopped, turned_travel, h * ((1.0 - weight) * v + weight * after))
    expected = np.array([exact(v[i], f[i], coulomb, viscous, mass, h) for i in range(len(v))]).T
    np.testing.assert_allclose(np.where(stopped, turned, after), expected[0], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(travel[:-1], expected[1, :-1], rtol=1e-7, atol=1e-13)
    # The stop's series ends where damping is strongest.
    assert travel[-1] == pytest.approx(expected[1, -1], rel=1e-5)
    # After a reversal the coefficient of the new direction acts for the rest of the step.
    lane = 2
    stop = (
        mass / viscous * np.log1p(viscous * v[lane] / (coulomb - f[lane]))
        if viscous
        else v[lane] * mass / 8.0
    )
    _, other = friction.stop_or_reverse(*arguments, 5.0 * np.ones_like(v), mass, 1.0 / mass, h)
    to_rest = exact(v[lane], f[lane], coulomb, viscous, mass, stop)[1]
    away = exact(0.0, f[lane], coulomb, 5.0, mass, h - stop)[1]
    assert other[lane] == pytest.approx(to_rest + away, rel=1e-6)


def test_directions_and_static_friction() -> None:
    v, f = np.array([0.2, -0.2, 0.0, 0.0, 0.0]), np.array([-1.0, 1.0, 1.5, -1.5, 9.0])
    np.testing.assert_array_equal(np.sign(friction.direction(v, f)), [1.0, -1.0, 1.0, -1.0, 1.0])
    np.testing.assert_array_equal(friction.static_friction(f, 2.0), [-1.0, 1.0, 1.5, -1.5, 2.0])
    np.testing.assert_array_equal(friction.static_friction(-f, 2.0), [1.0, -1.0, -1.5, 1.5, -2.0])
    np.testing.assert_array_equal(friction.friction_force(v, f, 2.0), [2.0, -2.0, 1.5, -1.5, 2.0])
