"""Tests of the rest at the beginning of a run: motion without input is neither rest nor noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.identification import prepare, simulate_recording
from hframe_gym.machine import Machine
from hframe_gym.preparation.start.measured_state import estimate_initial_state
from hframe_gym.preparation.start.rest import count_resting_rows, initial_rest, without_moving_start
from hframe_gym.preparation.start.sensor_zeros import sensor_zero_error
from hframe_gym.recordings import Recording, load_machine

NOISE = 20e-6  # m
ROWS, REST = 1000, 150
COUNT = 25e-6  # m, of an encoder


def run(motion: np.ndarray, seed: int = 0, late: int = 0) -> Recording:
    """Return a noisy run: a given motion (m) at 1 kHz, then a fast one from row `REST` - `late` on."""
    rng = np.random.default_rng(seed)
    rows = np.arange(ROWS)
    position = np.pad(motion, (0, ROWS - len(motion)), mode="edge")
    position += 0.1 * (1.0 - np.cos(0.01 * np.maximum(rows - REST + late, 0)))
    volts = np.where(rows >= REST, 3.0, 0.0)[:, None]
    return Recording(f"run_{seed}", rows * 1e-3, volts, (position + rng.normal(0.0, NOISE, ROWS))[:, None])


def counted(
    axis: Machine, free_rows: int, speed: float, noise: float = 0.0, seed: int = 0
) -> tuple[Machine, Recording]:
    """Return an axis whose only sensor is an encoder, and its run that begins with some rows without voltage.

    Args:
        axis: The axis with a laser.
        free_rows: Number of rows at 1 kHz before the first one with a voltage.
        speed: Velocity at the first row, m/s.
        noise: Standard deviation of the noise before rounding, m.
        seed: Seed of the noise.
    """
    encoder = dataclasses.replace(axis.sensors[0], kind="encoder", noise=0.0, resolution=COUNT)
    machine = axis.replace(sensors=(encoder,))
    rows = np.arange(ROWS)
    volts = np.where(rows >= free_rows, 4.0 * np.sin(0.02 * (rows - free_rows) + 0.5), 0.0)[:, None]
    outputs = machine.simulate(rows * 1e-3, volts, [1.1, speed]).outputs
    outputs += np.random.default_rng(seed).normal(0.0, noise, outputs.shape)
    return machine, Recording("counted", rows * 1e-3, volts, np.rint(outputs / COUNT) * COUNT)


def swing(decay: float) -> np.ndarray:
    """Return a swing of 5 mm and 80 ms period over the rows without input, m; decay time in rows."""
    rows = np.arange(REST + 1)
    return 5e-3 * np.cos(2 * np.pi * rows / 80) * np.exp(-rows / decay)


def test_all_rows_before_the_first_input_are_rest_if_only_noise_is_measured(axis: Machine) -> None:
    recordings = [run(np.zeros(REST), seed) for seed in range(50)]
    assert {count_resting_rows(recording, axis) for recording in recordings} == {REST + 1}
    assert all(without_moving_start(recording, axis) is recording for recording in recordings)


def test_slow_noise_of_a_filtered_sensor_is_rest(axis: Machine) -> None:
    for seed in range(20):
        slow = np.convolve(np.random.default_rng(seed).normal(0.0, 1.0, ROWS + 60), np.hanning(60), "same")[
            30:-30
        ]
        recording = run(np.zeros(REST), seed)
        outputs = NOISE * slow[:, None] / slow.std()
        outputs[REST:, 0] += np.linspace(0.0, 0.3, ROWS - REST)
        assert (
            count_resting_rows(Recording("slow", recording.time_s, recording.inputs, outputs), axis)
            == REST + 1
        )


@pytest.mark.parametrize("free_rows", [1, 5, 15, 60])
def test_a_motor_that_coasts_when_its_run_begins_is_not_at_rest(free_rows: int) -> None:
    """At 10 kHz, noise hides that its speed falls; only the speed itself shows the motion."""
    motor, recording = coasting(free_rows, speed=150.0)
    assert count_resting_rows(recording, motor) == 1
    assert estimate_initial_state(recording, motor).velocity[0] == pytest.approx(150.0, rel=0.02)


def test_a_tachometer_with_a_zero_error_is_at_rest() -> None:
    motor, recording = coasting(200, speed=0.0)
    shifted = dataclasses.replace(recording, outputs=recording.outputs + 0.01 * np.ptp(recording.outputs))
    assert count_resting_rows(shifted, motor) == 201


def coasting(free_rows: int, speed: float) -> tuple[Machine, Recording]:
    """Return a motor with a tachometer, and its noisy run at 10 kHz that begins with rows at 0 V."""
    motor = load_machine("motor")
    tachometer = dataclasses.replace(motor.sensors[0], kind="speed", noise=0.0, resolution=0.0)
    motor = motor.replace(sensors=(tachometer,)).replace({"shaft.mass": 50 * motor.coordinates[0].mass})
    rows = np.arange(3000)
    volts = np.where(rows < free_rows, 0.0, 12.0)[:, None]
    outputs = motor.simulate(rows * 1e-4, volts, [0.0, speed]).outputs
    outputs += np.random.default_rng(0).normal(0.0, 0.3, outputs.shape)
    return motor, Recording("coasting", rows * 1e-4, volts, outputs)


def test_a_swing_that_settles_before_the_first_input_is_not_used(axis: Machine) -> None:
    recordings = [run(swing(decay=12.0), seed) for seed in range(3)]
    cleaned = [without_moving_start(recording, axis) for recording in recordings]
    for recording in cleaned:
        removed = np.isnan(recording.outputs[:, 0])
        assert 30 < np.count_nonzero(removed) < 110
        assert not removed[110:].any()
        assert count_resting_rows(recording, axis) == REST + 1
    data = prepare(cleaned, axis)
    assert data.noise[0] == pytest.approx(NOISE, rel=0.2)
    np.testing.assert_allclose([r.initial.position[0] for r in data.runs], 0.0, atol=NOISE)
    simulated = simulate_recording(axis, recordings[0])
    assert np.isnan(simulated.error[:30]).all()
    assert abs(simulated.initial.position[0]) < NOISE


def test_a_swing_that_does_not_settle_is_neither_rest_nor_noise(axis: Machine) -> None:
    swinging = [run(swing(decay=300.0), seed) for seed in range(3)]
    assert [initial_rest(recording, axis).rows for recording in swinging] == [1, 1, 1]
    assert [count_resting_rows(recording, axis) for recording in swinging] == [1, 1, 1]
    assert all(without_moving_start(recording, axis) is recording for recording in swinging)
    data = prepare([*swinging, run(np.zeros(REST), 9)], axis)
    assert data.noise[0] == pytest.approx(NOISE, rel=0.2)
    assert data.runs[0].initial.position[0] == pytest.approx(5e-3, abs=4 * NOISE)


def test_motion_before_the_first_input_ends_the_rest(axis: Machine) -> None:
    """The voltage was logged 30 ms late; the motion begins slowly, so it is seen a little later."""
    rest = initial_rest(run(np.zeros(REST), late=30), axis)
    assert REST - 50 < rest.rows <= REST - 20
    assert rest.first == 0
    assert 0.015 < rest.lead_s <= 0.031
    assert rest.moving.tolist() == [True]


def test_a_run_without_any_input_rests_until_it_moves(axis: Machine) -> None:
    recording = run(np.zeros(REST))
    dead = Recording("dead", recording.time_s, 0.0 * recording.inputs, recording.outputs)
    assert REST - 20 < count_resting_rows(dead, axis) <= REST + 10


@pytest.mark.parametrize("free_rows", [16, 20, 30])
def test_a_coast_that_becomes_slower_has_not_settled(axis: Machine, free_rows: int) -> None:
    """Friction brakes it from 2 counts per row, so that neighboring blocks of a few rows hardly differ."""
    machine, recording = counted(axis, free_rows, speed=0.05)
    assert without_moving_start(recording, machine) is recording
    assert initial_rest(recording, machine).rows == 1
    assert simulate_recording(machine, recording).initial.velocity[0] == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("free_rows", [1, 2, 5, 9, 14])
def test_a_coast_by_several_counts_per_row_is_motion_however_few_rows_have_no_voltage(
    axis: Machine, free_rows: int
) -> None:
    machine, recording = counted(axis, free_rows, speed=0.1)
    rest = initial_rest(recording, machine)
    assert (rest.first, rest.rows, rest.moving.tolist()) == (0, 1, [True])
    initial = estimate_initial_state(recording, machine)
    assert initial.velocity[0] == pytest.approx(0.1, rel=0.15)
    assert initial.position[0] == pytest.approx(1.1, abs=COUNT)


@pytest.mark.parametrize("free_rows", [1, 2, 5, 9, 14])
def test_a_few_rows_in_which_an_encoder_toggles_between_counts_are_rest(
    axis: Machine, free_rows: int
) -> None:
    for seed in range(20):
        machine, recording = counted(axis, free_rows, speed=0.0, noise=COUNT / 2, seed=seed)
        assert count_resting_rows(recording, machine) == free_rows + 1
        assert not estimate_initial_state(recording, machine).velocity.any()


def test_a_single_row_at_rest_does_not_add_its_noise_to_all_errors() -> None:
    rng = np.random.default_rng(5)
    error = rng.normal(0.0, 1.0, (400, 300, 1))
    zero = sensor_zero_error(error, np.ones((300, 1)), 1, np.zeros(1), np.zeros(1))
    assert zero.std() == pytest.approx(1.0 / np.sqrt(5.0), rel=0.15)


def test_a_quantized_sensor_shows_that_a_machine_moves_after_its_only_row_at_rest() -> None:
    """EMPS begins at 7 mm/s, which a sensor of 50 nm steps sees in each row; noise of 10 um would hide it."""
    error = np.zeros((1, 300, 1))
    error[0, :, 0] = 7e-6 * np.arange(300)
    zero = sensor_zero_error(error, np.ones((300, 1)), 1, np.array([25e-9]), np.array([50e-9]))
    assert abs(zero[0, 0, 0]) <= 25e-9


def test_a_row_that_a_faster_controller_has_moved_already_is_no_rest(axis: Machine) -> None:
    """A controller that begins between two rows of a slow log moves the machine before its first voltage."""
    motion = np.zeros(200)
    motion[50:] = 0.001 + 0.01 * np.arange(150.0) / 150.0
    still = run(motion)
    inputs = still.inputs.copy()
    first = int(np.flatnonzero(np.any(inputs != 0.0, axis=1))[0])
    moved = still.outputs - still.outputs.mean(axis=0)
    moved[: first + 1] = np.random.default_rng(0).normal(0.0, 2e-6, (first + 1, moved.shape[1]))
    at_rest = Recording("run", still.time_s, inputs, moved.copy())
    moved[first] += 1e-3
    assert count_resting_rows(at_rest, axis) == first + 1
    assert count_resting_rows(Recording("run", still.time_s, inputs, moved), axis) == first
