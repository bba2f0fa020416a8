"""Tests of what an exact machine leaves in predictions of a log that is slower than its controller."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from hframe_gym.effects import get_effect
from hframe_gym.identification import Dataset, prepare
from hframe_gym.identification.fit.estimation import prediction_cost
from hframe_gym.identification.predict.exact_machine import certain_jitter, expected_chi2
from hframe_gym.identification.predict.prediction import POLISH_STEP, SEARCH_BANDWIDTH
from hframe_gym.identification.predict.voltage_errors import with_voltage_errors
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.identification.controlled_runs import controlled_run, every, random_places

AXIS = BUILTIN_MACHINES["belt-axis"]()
ROWS, RUNS, UPDATES = 3000, 3, 8
LASER_NOISE_M = 150e-6  # several steps of the motor's encoder, which the belts pull after the laser


def slow_log(truth: Machine, laser_noise_m: float = LASER_NOISE_M) -> Dataset:
    """Return logs with every eighth row of a controller, with a noisy laser, in units of noise at rest."""
    runs = []
    laser = [sensor.channel for sensor in AXIS.sensors].index("x_m")
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        angles = random_places(rng, ROWS) / AXIS.coordinates[1].radius
        noise = np.zeros((ROWS, len(AXIS.sensors)))
        noise[:, laser] = rng.normal(0.0, laser_noise_m, ROWS)
        run = controlled_run(f"run_{seed}", truth, angles, noise, window=60, gains=(10.0, 0.05))
        runs.append(every(run, UPDATES))
    data = prepare(runs, AXIS).with_updates(UPDATES)
    quiet = tuple(dataclasses.replace(r, noise=np.broadcast_to(data.noise, r.noise.shape)) for r in data.runs)
    return with_voltage_errors(AXIS, dataclasses.replace(data, runs=quiet))


@cache
def exact_log() -> Dataset:
    """Return the logs of the declared machine."""
    return slow_log(AXIS)


def predicted(data: Dataset) -> float:
    """Return chi-squared per sample of the declared machine's predictions."""
    return prediction_cost(AXIS, data, SEARCH_BANDWIDTH, longest_step=POLISH_STEP) / data.count


def test_noise_of_a_laser_moves_the_predictions_of_an_encoder() -> None:
    """The right machine seems to leave five times the squared noise: that of the laser, at the encoder."""
    measured = predicted(exact_log())
    assert measured > 3.0
    assert 0.9 < measured / expected_chi2(AXIS, exact_log(), SEARCH_BANDWIDTH) < 1.1


def test_sensors_without_noise_leave_nothing_else() -> None:
    """Errors of the voltages are in the statistics already."""
    data = slow_log(AXIS, laser_noise_m=0.0)
    assert 0.9 < expected_chi2(AXIS, data, SEARCH_BANDWIDTH) < 1.1


def test_rows_that_were_sampled_late_have_errors_that_grow_with_speed() -> None:
    jitter, data = 50e-6, slow_log(AXIS, laser_noise_m=0.0)
    rng = np.random.default_rng(7)
    late = [jitter * rng.normal(size=(len(run.time_s), 1)) for run in data.runs]
    runs = [
        dataclasses.replace(
            run, outputs=run.outputs + np.gradient(run.outputs, run.time_s, axis=0) * lateness
        )
        for run, lateness in zip(data.runs, late, strict=True)
    ]
    jittered = dataclasses.replace(data, runs=tuple(runs))
    measured = predicted(jittered)
    assert measured > 2.0 * predicted(data)
    assert 0.8 < measured / expected_chi2(AXIS, jittered, SEARCH_BANDWIDTH, jitter) < 1.2


def test_one_encoder_confirms_no_jitter() -> None:
    assert certain_jitter(AXIS, dataclasses.replace(exact_log(), jitter=1e-5)) == 0.0


def test_a_machine_that_lacks_an_effect_leaves_more() -> None:
    data = slow_log(AXIS.with_effects(get_effect("stribeck_friction").at("x", dF=3.0, vs=0.05)))
    assert predicted(data) > 2.0 * expected_chi2(AXIS, data, SEARCH_BANDWIDTH)
