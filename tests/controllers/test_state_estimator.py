from __future__ import annotations

import numpy as np
import pytest
from closed_loop import PERIOD, closed_loop, random_points, random_stages
from scipy.linalg import solve_discrete_are

from hframe_gym.controllers import Channel, ModelBasedController, OutputFeedbackController, StateEstimator
from hframe_gym.dynamics import simulate
from hframe_gym.machine import BUILTIN_MACHINES, Machine, rest_state

QUANTUM = 2 * np.pi / (4 * 512 * 5.9)
NOISE = 20e-6
ENCODERS = [Channel(name, QUANTUM / np.sqrt(12.0)) for name in ("phi1", "phi2")]


def rig(span: float) -> list[Channel]:
    """Lasers of a range around the middle, and encoders."""
    return [*(Channel(axis, NOISE, -span / 2, span / 2) for axis in ("x", "y")), *ENCODERS]


class Readings:
    """Positions (B, 8) as a rig's sensors of `rig(span)` show them: noisy, quantised, stuck at the ends."""

    def __init__(self, span: float, seed: int) -> None:
        self.half, self.rng = span / 2, np.random.default_rng(seed)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        tool = values[:, :2] + self.rng.normal(0.0, NOISE, (len(values), 2))
        return np.hstack([np.clip(tool, -self.half, self.half), QUANTUM * np.rint(values[:, 2:4] / QUANTUM)])


def observed(machine: Machine, span: float) -> OutputFeedbackController:
    return OutputFeedbackController(ModelBasedController(machine, PERIOD), StateEstimator(machine, PERIOD, rig(span)))


@pytest.mark.parametrize("span", [np.inf, 0.1])
def test_settles_on_random_machines_from_readings_alone(hframe: Machine, span: float) -> None:
    start, goal = random_points(48, 1), random_points(48, 2)
    run = closed_loop(
        observed(hframe, span), hframe, start, goal, changes=random_stages(hframe, 48, 3), sense=Readings(span, 4)
    )
    assert np.all(run.error[:, -1] < 2e-4)
    settled = np.argmax(run.error[:, ::-1] > 2e-4, axis=1)
    assert PERIOD * np.mean(run.error.shape[1] - settled) < 0.32


def test_the_state_of_its_own_machine_is_found_while_lasers_stick(hframe: Machine) -> None:
    """Voltages played to the machine alone, the tool far out of the lasers' range: the encoders say where it is."""
    time = PERIOD * np.arange(61)
    volts = np.random.default_rng(5).uniform(-9.0, 9.0, (61, 2))
    start = np.array([0.15, -0.1])
    run = simulate(hframe, time, volts, rest_state(hframe, start))
    readings = Readings(0.1, 6)
    observer = StateEstimator(hframe, PERIOD, rig(0.1))
    for k in range(61):
        estimate = observer.update(readings(run.positions[k : k + 1]))
        observer.sent(volts[k : k + 1])
    truth = np.concatenate([run.positions[-1], run.velocities[-1]]) * np.tile(hframe.radii, 2)
    np.testing.assert_allclose(estimate[0, :4], truth[:4], atol=3e-5)
    np.testing.assert_allclose(estimate[0, 4:], truth[4:], atol=1e-2)


@pytest.mark.parametrize("span", [np.inf, 0.1])
def test_another_stage_is_learnt_and_its_speeds_with_it(hframe: Machine, span: float) -> None:
    """Softer belts, heavier, more friction; far out, where lasers of 100 mm stick, by the encoders alone."""
    factors = {"left.EA": 0.8, "right.EA": 0.8, "bottom.EA": 0.8, "x.mass": 1.15, "phi1.coulomb": 1.7}
    stage = hframe.replace({name: factor * hframe.parameters[name] for name, factor in factors.items()})
    time = PERIOD * np.arange(101)
    volts = np.random.default_rng(5).uniform(-9.0, 9.0, (101, 2))
    run = simulate(stage, time, volts, rest_state(hframe, np.array([0.12, -0.08])))
    truth = np.hstack([run.positions, run.velocities]) * np.tile(hframe.radii, 2)
    readings, observer, misses = Readings(span, 6), StateEstimator(hframe, PERIOD, rig(span)), []
    for k in range(101):
        estimate = observer.update(readings(run.positions[k : k + 1]))
        observer.sent(volts[k : k + 1])
        misses.append(estimate[0] - truth[k])
    np.testing.assert_allclose(np.sqrt(np.mean(np.array(misses)[50:, 4:] ** 2, axis=0)), 0.0, atol=0.005)  # of 0.3 m/s
    found = dict(zip(observer.unknowns.names, observer.factors[0], strict=True))
    for name, factor in factors.items():
        assert found[name] == pytest.approx(factor, abs=0.2 if name.endswith("coulomb") else 0.05), name


def test_readings_that_no_model_explains_are_believed(hframe: Machine) -> None:
    """A stage at rest, well known by then, is put 5 mm aside by hand; a certain filter would not follow at once."""
    observer = StateEstimator(hframe, PERIOD, rig(np.inf))
    readings = Readings(np.inf, 7)
    places = np.repeat([[0.0, 0.0], [0.005, 0.0]], [50, 20], axis=0)
    for k, place in enumerate(places):
        estimate = observer.update(readings(rest_state(hframe, place)[None, :4]))
        observer.sent(np.zeros((1, 2)))
        if k >= 50:
            np.testing.assert_allclose(estimate[0, :2], place, atol=1e-4)
            np.testing.assert_allclose(estimate[0, 4:], 0.0, atol=0.05)


@pytest.mark.parametrize("channel", [0, 2])
def test_one_wild_reading_is_made_up_for(hframe: Machine, channel: int) -> None:
    time = PERIOD * np.arange(61)
    volts = np.random.default_rng(5).uniform(-9.0, 9.0, (61, 2))
    run = simulate(hframe, time, volts, rest_state(hframe, np.array([0.05, -0.05])))
    observer = StateEstimator(hframe, PERIOD, rig(np.inf))
    for k in range(61):
        reading = run.positions[k : k + 1].copy()
        reading[0, channel] += 1.0 if k == 40 else 0.0
        estimate = observer.update(reading)
        observer.sent(volts[k : k + 1])
        if k > 46:
            np.testing.assert_allclose(estimate[0, :4], run.positions[k] * hframe.radii, atol=1e-4)


def test_a_stuck_laser_changes_nothing(hframe: Machine) -> None:
    """With both lasers at their ends the estimate is to the bit that of the encoders alone."""
    with_lasers, without = StateEstimator(hframe, PERIOD, rig(0.1)), StateEstimator(hframe, PERIOD, ENCODERS)
    rng = np.random.default_rng(0)
    for _ in range(20):
        angles = rng.normal([-9.0, 8.0], 0.01, (3, 2))
        stuck = np.hstack([np.full((3, 1), 0.05), np.full((3, 1), -0.05), angles])
        a, b = with_lasers.update(stuck), without.update(angles)
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12)
        for o in (with_lasers, without):
            o.sent(np.ones((3, 2)))


def test_covariance_goes_to_that_of_the_riccati_equation() -> None:
    """On the linear machine at rest, against SciPy's solution for the same noises."""
    machine = BUILTIN_MACHINES["hframe-linear"]()
    observer = StateEstimator(machine, PERIOD, rig(np.inf))
    for _ in range(400):
        observer.update(np.zeros((1, 4)))
    n = 4
    F, _, _ = observer.model.discretize(np.zeros(2), PERIOD)
    H = np.zeros((4, 2 * n))
    H[np.arange(4), observer._rows] = 1.0
    Q, R = observer._Q[: 2 * n, : 2 * n] + np.diag(observer._least[: 2 * n] ** 2), np.diag(observer._noise)
    prior = solve_discrete_are(F.T, H.T, Q, R)
    gain = prior @ H.T @ np.linalg.inv(H @ prior @ H.T + R)
    posterior = prior - gain @ H @ prior
    scale = np.sqrt(np.outer(np.diag(posterior), np.diag(posterior))) + 1e-30
    # Steps of 0.5 ms, not the matrix exponential.
    np.testing.assert_allclose(observer._P[0, : 2 * n, : 2 * n] / scale, posterior / scale, atol=2e-3)


def test_masked_reset_begins_anew(hframe: Machine) -> None:
    observer = StateEstimator(hframe, PERIOD, rig(0.1))
    rng = np.random.default_rng(1)
    for _ in range(5):
        observer.update(np.hstack([np.zeros((2, 2)), rng.normal(0.0, 0.05, (2, 2))]))
        observer.sent(np.full((2, 2), 3.0))
    reading = np.array([[0.01, 0.02, -0.03 / 0.0194, -0.01 / 0.0194]])
    observer.reset(np.array([True, False]))
    kept = observer.update(np.repeat(reading, 2, axis=0))
    fresh = StateEstimator(hframe, PERIOD, rig(0.1)).update(reading)
    np.testing.assert_allclose(kept[0], fresh[0], atol=1e-12)
    assert not np.allclose(kept[1], fresh[0], atol=1e-6)


def test_refuses_channels_that_do_not_tell_where_the_tool_is(hframe: Machine) -> None:
    with pytest.raises(ValueError, match="do not tell where its tool is"):
        StateEstimator(hframe, PERIOD, [Channel("x", 1e-5)])
    with pytest.raises(ValueError, match="phi9"):
        StateEstimator(hframe, PERIOD, [Channel("x", 1e-5), Channel("phi9", 1e-5)])


def test_refuses_a_reading_that_is_no_number(hframe: Machine) -> None:
    observer = StateEstimator(hframe, PERIOD, rig(0.1))
    with pytest.raises(ValueError, match="channel 2 of stage 1 is nan"):
        observer.update(np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, np.nan, 0.0]]))


@pytest.mark.parametrize("size", [1e-3, 0.1])
def test_readings_without_sense_do_not_break_it(hframe: Machine, size: float) -> None:
    observer, rng = StateEstimator(hframe, PERIOD, rig(np.inf)), np.random.default_rng(2)
    for _ in range(100):
        assert np.all(np.isfinite(observer.update(rng.normal(0.0, size, (4, 4)))))
        observer.sent(rng.uniform(-12.0, 12.0, (4, 2)))


def test_sensors_without_noise_are_not_too_good(hframe: Machine) -> None:
    """Exact readings of everything: the covariance is all but zero, and stays a covariance."""
    observer = StateEstimator(hframe, PERIOD, [Channel(name, 0.0) for name in ("x", "y", "phi1", "phi2")])
    start, goal = random_points(16, 8), random_points(16, 9)
    controller = OutputFeedbackController(ModelBasedController(hframe, PERIOD), observer)
    run = closed_loop(
        controller, hframe, start, goal, changes=random_stages(hframe, 16, 10), sense=lambda values: values[:, :4]
    )
    assert np.all(run.error[:, -1] < 5e-5)
