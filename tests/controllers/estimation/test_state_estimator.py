"""Tests of the state estimator and of the divided-difference filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.stats import multivariate_normal

from hframe_gym.controllers import ModelBasedController, OutputFeedbackController, StateEstimator
from hframe_gym.controllers.estimation.state_estimator import sigma_points, transformed_moments
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor, Trajectory, rest_state
from tests.controllers.closed_loop import PERIOD, closed_loop, random_points, random_stages

QUANTUM = 2 * np.pi / (4 * 512 * 5.9)  # rad, one count of the encoders
NOISE = 20e-6  # m, of the lasers
ENCODERS = tuple(Sensor(f"{name}_rad", {name: 1.0}, 0.0, QUANTUM, "encoder") for name in ("phi1", "phi2"))
LASERS = tuple(Sensor(f"{name}_m", {name: 1.0}, NOISE) for name in ("x", "y"))


def with_rig(machine: Machine, span: float) -> Machine:
    """Return the machine with encoders, and lasers whose range of length `span`, m, is in the middle."""
    measured = machine.replace(sensors=(*LASERS, *ENCODERS))
    if np.isinf(span):
        return measured
    sensor_range = EFFECTS["sensor_range"]
    return measured.with_effects(*(sensor_range.at(s.channel, low=-span / 2, high=span / 2) for s in LASERS))


class RigMeasurements:
    """Noisy, quantized and clipped measurements (B, 4) of positions (B, 4 or more), as of `with_rig`."""

    def __init__(self, span: float, seed: int) -> None:
        self.half, self.rng = span / 2, np.random.default_rng(seed)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        tool = values[:, :2] + self.rng.normal(0.0, NOISE, (len(values), 2))
        return np.hstack([np.clip(tool, -self.half, self.half), QUANTUM * np.rint(values[:, 2:4] / QUANTUM)])


def random_motion(
    machine: Machine, start: tuple[float, float], periods: int
) -> tuple[np.ndarray, Trajectory]:
    """Simulate a machine under random voltages; return the voltages and the motion, one sample per period."""
    volts = np.random.default_rng(5).uniform(-9.0, 9.0, (periods + 1, 2))
    return volts, simulate(
        machine, PERIOD * np.arange(periods + 1), volts, rest_state(machine, np.array(start))
    )


def true_states(machine: Machine, motion: Trajectory) -> np.ndarray:
    """Return the states (n, 8) of a motion, in travel."""
    return np.hstack([motion.positions, motion.velocities]) * np.tile(machine.travel_per_unit, 2)


@pytest.mark.integration
@pytest.mark.parametrize("span", [np.inf, 0.1])
def test_settles_randomized_machines_from_measurements(hframe: Machine, span: float) -> None:
    start, goal = random_points(48, 1), random_points(48, 2)
    estimator = StateEstimator(with_rig(hframe, span), PERIOD)
    controller = OutputFeedbackController(ModelBasedController(hframe, PERIOD), estimator)
    changes = random_stages(hframe, 48, 3)
    loop = closed_loop(controller, hframe, start, goal, changes=changes, measure=RigMeasurements(span, 4))
    assert np.all(loop.error[:, -1] < 2e-4)
    periods_after_settling = np.argmax(loop.error[:, ::-1] > 2e-4, axis=1)
    assert PERIOD * np.mean(loop.error.shape[1] - periods_after_settling) < 0.32


def test_effects_with_a_memory_go_on_from_period_to_period(hframe: Machine) -> None:
    heat = EFFECTS["winding_heat"]
    warm = hframe.with_effects(*(heat.at(f"motor{i}", a=0.01, tau=0.5) for i in (1, 2)))
    volts, motion = random_motion(warm, (0.05, -0.02), 60)
    measure, estimator = RigMeasurements(np.inf, 6), StateEstimator(with_rig(warm, np.inf), PERIOD)
    for k in range(61):
        estimator.update(measure(motion.positions[k : k + 1]))
        estimator.send(volts[k : k + 1])
    names = estimator.augmented.names
    motors = [names.index(f"motor{i}.Kt") for i in (1, 2)]
    np.testing.assert_allclose(estimator.parameter_ratios[0, motors], 1.0, atol=0.03)


def test_estimates_the_state_while_lasers_are_out_of_range(hframe: Machine) -> None:
    volts, motion = random_motion(hframe, (0.15, -0.1), 60)
    measure, estimator = RigMeasurements(0.1, 6), StateEstimator(with_rig(hframe, 0.1), PERIOD)
    for k in range(61):
        estimate = estimator.update(measure(motion.positions[k : k + 1]))
        estimator.send(volts[k : k + 1])
    truth = true_states(hframe, motion)[-1]
    np.testing.assert_allclose(estimate[0, :4], truth[:4], atol=3e-5)
    np.testing.assert_allclose(estimate[0, 4:], truth[4:], atol=1e-2)


@pytest.mark.parametrize("span", [np.inf, 0.1])
def test_estimates_parameters_and_velocities_of_another_stage(hframe: Machine, span: float) -> None:
    """Softer belts, more mass and friction; with a range of 0.1 m the lasers are out of range."""
    ratios = {"left.EA": 0.8, "right.EA": 0.8, "bottom.EA": 0.8, "x.mass": 1.15, "phi1.coulomb": 1.7}
    stage = hframe.replace({name: ratio * hframe.parameters[name] for name, ratio in ratios.items()})
    volts, motion = random_motion(stage, (0.12, -0.08), 100)
    truth = true_states(hframe, motion)
    measure, estimator, errors = RigMeasurements(span, 6), StateEstimator(with_rig(hframe, span), PERIOD), []
    for k in range(101):
        estimate = estimator.update(measure(motion.positions[k : k + 1]))
        estimator.send(volts[k : k + 1])
        errors.append(estimate[0] - truth[k])
    # Velocities reach 0.3 m/s.
    np.testing.assert_allclose(np.sqrt(np.mean(np.array(errors)[50:, 4:] ** 2, axis=0)), 0.0, atol=0.005)
    estimates = dict(zip(estimator.augmented.names, estimator.parameter_ratios[0], strict=True))
    for name, ratio in ratios.items():
        assert estimates[name] == pytest.approx(ratio, abs=0.2 if name.endswith("coulomb") else 0.05), name


def test_encoders_that_drift_are_not_taken_for_stretched_belts(hframe: Machine) -> None:
    """A belt creeps by 0.2 mm over its pulley in 0.6 s, which stretches nothing."""
    volts, motion = random_motion(hframe, (0.05, -0.05), 60)
    truth = true_states(hframe, motion)
    crept = np.linspace(0.0, 2e-4, 61) / hframe.travel_per_unit[2]
    wrong = {}
    for drifting in (False, True):
        measure = RigMeasurements(np.inf, 6)
        estimator = StateEstimator(with_rig(hframe, np.inf), PERIOD, drifting_encoders=drifting)
        for k in range(61):
            positions = motion.positions[k : k + 1, :4] + [0.0, 0.0, crept[k], 0.0]
            estimate = estimator.update(measure(positions))
            estimator.send(volts[k : k + 1])
        wrong[drifting] = np.abs(estimate[0, :4] - truth[-1, :4]).max()
        assert estimator.parameter_ratios.shape == (1, len(estimator.augmented.names))
    assert wrong[True] < 0.5 * wrong[False], wrong


def test_a_load_that_no_sensor_sees_is_estimated(hframe: Machine) -> None:
    """Measurements are more probable if the estimator knows the load that pulls at the cart."""
    machine = hframe.with_effects(EFFECTS["payload_swing"].at("y", f0=1.8, zeta=0.02, r=0.3))
    volts, motion = random_motion(machine, (0.05, -0.05), 100)
    probable = []
    for known in (machine, hframe):
        estimator, total = StateEstimator(with_rig(known, np.inf), PERIOD), 0.0
        measure = RigMeasurements(np.inf, 6)
        for k in range(101):
            assert estimator.update(measure(motion.positions[k : k + 1])).shape == (1, 8)
            estimator.send(volts[k : k + 1])
            total += float(estimator.log_likelihood[0])
        probable.append(total)
    assert probable[0] > probable[1] + 10.0, probable


def test_follows_measurements_that_no_model_explains(hframe: Machine) -> None:
    """A stage at rest is displaced by 5 mm by hand; a filter without inflation would follow slowly."""
    estimator, measure = StateEstimator(with_rig(hframe, np.inf), PERIOD), RigMeasurements(np.inf, 7)
    positions = np.repeat([[0.0, 0.0], [0.005, 0.0]], [50, 20], axis=0)
    for k, position in enumerate(positions):
        estimate = estimator.update(measure(rest_state(hframe, position)[None, :4]))
        estimator.send(np.zeros((1, 2)))
        if k >= 50:
            np.testing.assert_allclose(estimate[0, :2], position, atol=1e-4)
            np.testing.assert_allclose(estimate[0, 4:], 0.0, atol=0.05)


@pytest.mark.parametrize("channel", [0, 2])
def test_recovers_from_an_outlier(hframe: Machine, channel: int) -> None:
    volts, motion = random_motion(hframe, (0.05, -0.05), 60)
    estimator = StateEstimator(with_rig(hframe, np.inf), PERIOD)
    for k in range(61):
        measurement = motion.positions[k : k + 1].copy()
        measurement[0, channel] += 1.0 if k == 40 else 0.0
        estimate = estimator.update(measurement)
        estimator.send(volts[k : k + 1])
        if k > 46:
            np.testing.assert_allclose(
                estimate[0, :4], motion.positions[k] * hframe.travel_per_unit, atol=1e-4
            )


def test_lasers_at_the_ends_of_their_ranges_change_nothing(hframe: Machine) -> None:
    with_lasers = StateEstimator(with_rig(hframe, 0.1), PERIOD)
    without_lasers = StateEstimator(hframe.replace(sensors=ENCODERS), PERIOD)
    rng = np.random.default_rng(0)
    for _ in range(20):
        angles = rng.normal([-9.0, 8.0], 0.01, (3, 2))
        clipped = np.hstack([np.full((3, 1), 0.05), np.full((3, 1), -0.05), angles])
        np.testing.assert_allclose(
            with_lasers.update(clipped), without_lasers.update(angles), rtol=0.0, atol=1e-12
        )
        for estimator in (with_lasers, without_lasers):
            estimator.send(np.ones((3, 2)))


def test_delay_of_a_laser_is_compensated(hframe: Machine) -> None:
    """Measurements that are 5 ms old, of a tool at up to 0.3 m/s, with and without a declared delay."""
    volts, motion = random_motion(hframe, (0.0, 0.0), 60)
    fine = simulate(
        hframe, 1e-3 * np.arange(601), np.repeat(volts, 10, axis=0)[:601], rest_state(hframe, np.zeros(2))
    )
    rig = with_rig(hframe, np.inf)
    delays = tuple(EFFECTS["sensor_delay"].at(s.channel, d=0.005) for s in LASERS)
    errors = []
    for machine in (rig, rig.with_effects(*delays)):
        estimator, squares = StateEstimator(machine, PERIOD), []
        for k in range(61):
            measurement = np.hstack([fine.positions[max(10 * k - 5, 0), :2], motion.positions[k, 2:]])
            estimate = estimator.update(measurement[None])
            estimator.send(volts[k : k + 1])
            squares.append((estimate[0, :2] - motion.positions[k, :2]) ** 2)
        errors.append(np.sqrt(np.mean(squares[20:])))
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.oracle
def test_covariance_converges_to_the_riccati_solution() -> None:
    """On the linear machine at rest, against SciPy's solution for the same noise."""
    machine = with_rig(BUILTIN_MACHINES["hframe-linear"](), np.inf)
    estimator = StateEstimator(machine, PERIOD)
    for _ in range(400):
        estimator.update(np.zeros((1, 4)))
    n = 4
    F, _, _ = estimator.model.discretize(np.zeros(2), PERIOD)
    H, R = estimator.measurements.matrix, np.diag(estimator.measurements.variance)
    Q = estimator._process_noise[: 2 * n, : 2 * n] + np.diag(estimator._smallest_std[: 2 * n] ** 2)
    prior = solve_discrete_are(F.T, H.T, Q, R)
    gain = prior @ H.T @ np.linalg.inv(H @ prior @ H.T + R)
    posterior = prior - gain @ H @ prior
    scale = np.sqrt(np.outer(np.diag(posterior), np.diag(posterior))) + 1e-30
    # The estimator integrates in steps of 0.5 ms, and F is a matrix exponential.
    np.testing.assert_allclose(
        estimator._covariance[0, : 2 * n, : 2 * n] / scale, posterior / scale, atol=2e-3
    )
    expected = multivariate_normal.logpdf(np.zeros(n), cov=H @ prior @ H.T + R)
    assert estimator.log_likelihood[0] == pytest.approx(expected, abs=0.01)


def test_a_laser_out_of_range_does_not_count_in_the_likelihood(hframe: Machine) -> None:
    with_lasers = StateEstimator(with_rig(hframe, 0.1), PERIOD)
    without_lasers = StateEstimator(hframe.replace(sensors=ENCODERS), PERIOD)
    for angle in (-9.0, -9.01):
        with_lasers.update(np.array([[0.05, -0.05, angle, 8.0]]))
        without_lasers.update(np.array([[angle, 8.0]]))
    np.testing.assert_allclose(with_lasers.log_likelihood, without_lasers.log_likelihood, rtol=1e-9)


def test_masked_reset_starts_a_new_episode(hframe: Machine) -> None:
    machine = with_rig(hframe, 0.1)
    estimator = StateEstimator(machine, PERIOD)
    rng = np.random.default_rng(1)
    for _ in range(5):
        estimator.update(np.hstack([np.zeros((2, 2)), rng.normal(0.0, 0.05, (2, 2))]))
        estimator.send(np.full((2, 2), 3.0))
    measurement = np.array([[0.01, 0.02, -0.03 / 0.0194, -0.01 / 0.0194]])
    estimator.reset(np.array([True, False]))
    estimate = estimator.update(np.repeat(measurement, 2, axis=0))
    first = StateEstimator(machine, PERIOD).update(measurement)
    np.testing.assert_allclose(estimate[0], first[0], atol=1e-12)
    assert not np.allclose(estimate[1], first[0], atol=1e-6)


def test_measurement_that_is_not_finite_is_rejected(hframe: Machine) -> None:
    estimator = StateEstimator(with_rig(hframe, 0.1), PERIOD)
    with pytest.raises(InputError, match="channel 2 of machine 1 is nan"):
        estimator.update(np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, np.nan, 0.0]]))


@pytest.mark.parametrize("size", [1e-3, 0.1])
def test_stays_finite_with_random_measurements(hframe: Machine, size: float) -> None:
    estimator, rng = StateEstimator(with_rig(hframe, np.inf), PERIOD), np.random.default_rng(2)
    for _ in range(100):
        assert np.all(np.isfinite(estimator.update(rng.normal(0.0, size, (4, 4)))))
        estimator.send(rng.uniform(-12.0, 12.0, (4, 2)))


def test_works_with_sensors_without_noise(hframe: Machine) -> None:
    """Exact measurements make the covariance almost zero; it must stay positive definite."""
    sensors = tuple(Sensor(f"{name}_position", {name: 1.0}) for name in ("x", "y", "phi1", "phi2"))
    estimator = StateEstimator(hframe.replace(sensors=sensors), PERIOD)
    start, goal = random_points(16, 8), random_points(16, 9)
    controller = OutputFeedbackController(ModelBasedController(hframe, PERIOD), estimator)
    changes = random_stages(hframe, 16, 10)
    loop = closed_loop(controller, hframe, start, goal, changes=changes, measure=lambda values: values[:, :4])
    assert np.all(loop.error[:, -1] < 5e-5)


@pytest.mark.oracle
def test_moments_of_a_linear_map_are_exact() -> None:
    """Mean A m and covariance A P A', also for a singular covariance."""
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(5, 4, 3))
    mean, covariance = rng.normal(size=(5, 4)), roots @ roots.transpose(0, 2, 1)
    A = rng.normal(size=(6, 4))
    mapped_mean, mapped_covariance = transformed_moments(sigma_points(mean, covariance, np.zeros(4)) @ A.T)
    np.testing.assert_allclose(mapped_mean, mean @ A.T, atol=1e-12)
    np.testing.assert_allclose(mapped_covariance, A @ covariance @ A.T, atol=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("mean", [0.0, 1.5])
def test_moments_of_the_square_of_a_normal_variable(mean: float) -> None:
    """E x^2 = m^2 + s^2 and var x^2 = 4 m^2 s^2 + 2 s^4."""
    s = 0.7
    points = sigma_points(np.array([[mean]]), np.array([[[s**2]]]), np.zeros(1))
    mapped_mean, mapped_covariance = transformed_moments(points**2)
    assert mapped_mean[0, 0] == pytest.approx(mean**2 + s**2, rel=1e-6)
    assert mapped_covariance[0, 0, 0] == pytest.approx(4.0 * mean**2 * s**2 + 2.0 * s**4, rel=1e-6)


def test_points_of_a_certain_variable_have_the_smallest_distance() -> None:
    points = sigma_points(np.zeros((1, 2)), np.zeros((1, 2, 2)), np.array([1e-8, 1e-6]))
    np.testing.assert_allclose(points[0, 1:3], np.sqrt(3.0) * np.diag([1e-8, 1e-6]))
