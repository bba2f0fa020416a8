"""Tests of prepared recordings: noise, rows that count, typical scales."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification import prepare
from hframe_gym.identification.propose.typical_scales import scales_of_motion
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.preparation.session import with_all_measurements
from hframe_gym.preparation.usable import usable_run
from hframe_gym.recordings import Recording

QUANTUM = 5.2e-4


def resting(outputs: np.ndarray, name: str = "run") -> Recording:
    """Return a run without voltage."""
    return Recording(name, np.arange(len(outputs)) * 1e-3, np.zeros((len(outputs), 2)), outputs)


def test_noise_comes_from_the_resting_rows_or_from_the_declaration(hframe: Machine) -> None:
    rng = np.random.default_rng(1)
    outputs = np.zeros((400, 4))
    outputs[:, 2] = rng.normal(0, 35e-6, 400)
    outputs[:, 3] = rng.normal(0, 12e-6, 400)
    noise = prepare([resting(outputs)], hframe).noise
    assert noise[2] == pytest.approx(35e-6, rel=0.1)
    assert noise[3] == pytest.approx(12e-6, rel=0.1)
    driven = Recording("run", np.arange(400) * 1e-3, np.ones((400, 2)), outputs)
    assert prepare([driven], hframe).noise[2] == hframe.sensors[2].noise


def test_the_quantum_is_that_of_the_moving_runs(hframe: Machine) -> None:
    """Half of the runs rest; the encoders' noise follows from the quantum."""
    rng = np.random.default_rng(2)
    runs = []
    for k in range(4):
        outputs = np.zeros((500, 4))
        if k % 2:
            outputs[:, :2] = np.round(np.cumsum(rng.normal(0, 2e-3, (500, 2)), axis=0) / QUANTUM) * QUANTUM
        runs.append(resting(outputs, f"run_{k}"))
    data = prepare(runs, hframe)
    np.testing.assert_allclose(data.quantum[:2], QUANTUM)


@pytest.mark.parametrize("encoders", [True, False])
def test_lasers_show_the_jitter_of_the_clock_where_no_encoder_measured(
    hframe: Machine, encoders: bool
) -> None:
    """The stage moves fast; the times of the samples err by 0.2 ms. The encoders are blank or show none."""
    rng = np.random.default_rng(3)
    time_s = np.arange(2000) * 1e-3
    late = time_s + rng.normal(0.0, 2e-4, 2000)
    outputs = np.zeros((2000, 4))
    outputs[:, 2] = 0.1 * np.sin(20.0 * late) + rng.normal(0.0, 20e-6, 2000)
    outputs[:, 3] = 0.1 * np.cos(20.0 * late) + rng.normal(0.0, 20e-6, 2000)
    outputs[:, :2] = 0.0 if encoders else np.nan
    noise = prepare([Recording("run", time_s, np.ones((2000, 2)), outputs)], hframe).runs[0].noise
    largest = np.max(noise[:, 2]) / hframe.sensors[2].noise
    assert largest == pytest.approx(1.0 if encoders else 2e-4 * 2.0 / hframe.sensors[2].noise, rel=0.25)


def test_runs_are_chosen_by_name_and_all_measurements_return(hframe: Machine) -> None:
    complete = [resting(np.tile([0.0, 0.0, 0.01, 0.02], (50, 1)), f"run_{i}") for i in range(3)]
    blank = [Recording(r.name, r.time_s, r.inputs, r.outputs.copy()) for r in complete]
    for run in blank:
        run.outputs[20:, 2] = np.nan
    data = prepare(blank, hframe).with_runs(["run_1"])
    assert [run.name for run in data.runs] == ["run_1"]
    assert data.count == pytest.approx(1 + 1 + 20 + 50)  # an encoder at rest has one rounding error
    restored = with_all_measurements(data, complete)
    assert restored.count == pytest.approx(1 + 1 + 50 + 50)
    np.testing.assert_allclose(restored.runs[0].outputs[:, 2], 0.01, atol=1e-9)


@pytest.mark.parametrize(("pieces", "piece", "counts"), [(1, 1, (204.0, 102.0)), (2, 3, (255.0, 51.0))])
def test_a_piece_is_left_out_of_the_fit_and_remains_measured(
    hframe: Machine, pieces: int, piece: int, counts: tuple[float, float]
) -> None:
    """Each run has 50 values of each laser, and one of each encoder; at rest, repeats count as one."""
    outputs = np.tile([0.0, 0.0, 0.01, 0.02], (50, 1))
    data = prepare([resting(outputs, f"run_{i}") for i in range(3)], hframe)
    others, left_out = data.leaving_out(piece, pieces)
    assert data.count == pytest.approx(sum(counts))
    assert (others.count, left_out.count) == pytest.approx(counts)
    assert left_out.runs[0].name == "run_1"
    np.testing.assert_array_equal(left_out.runs[0].outputs, data.runs[1].outputs)


def test_an_angle_that_wraps_is_unwrapped_with_a_word(hframe: Machine) -> None:
    time_s = np.arange(1000) * 1e-3
    outputs = np.zeros((1000, 4))
    outputs[:, 0] = np.round(20.0 * np.sin(4.0 * time_s), 4)
    wrapped = outputs.copy()
    wrapped[:, 0] %= 2 * np.pi
    lines: list[str] = []
    cleaned = usable_run(Recording("run", time_s, np.ones((1000, 2)), wrapped), hframe, lines.append).usable
    np.testing.assert_allclose(cleaned.outputs[:, 0], outputs[:, 0], atol=1e-9)
    jumps = np.count_nonzero(np.abs(np.diff(wrapped[:, 0])) > np.pi)
    assert lines == [f"run: phi1_rad wraps {jumps} times at one turn (6.28319 rad) and is unwrapped"]


def test_the_repetitions_of_a_slow_sensor_are_not_used_and_named(hframe: Machine) -> None:
    time_s = np.arange(1000) * 1e-3
    outputs = np.zeros((1000, 4))
    outputs[:, 2] = 0.1 * np.sin(6.0 * time_s)[np.arange(1000) // 5 * 5]
    lines: list[str] = []
    cleaned = usable_run(Recording("run", time_s, np.ones((1000, 2)), outputs), hframe, lines.append).usable
    assert np.flatnonzero(np.isfinite(cleaned.outputs[:, 2])).tolist() == list(range(0, 1000, 5))
    assert lines == ["run: x_m is measured every 5 rows; the 800 repeated values are not used"]


def test_typical_scales_of_an_axis() -> None:
    """The axis moves over 0.2 m at up to 0.5 m/s; its typical force is a tenth of the rated one."""
    axis = BUILTIN_MACHINES["axis"]()
    positions = np.linspace(-0.1, 0.1, 100)[:, None]
    velocities = np.full((100, 1), 0.5)
    scales = scales_of_motion(axis, positions, velocities, [np.zeros((100, 1))]).of("x")
    drive = axis.drives[0]
    assert scales["force"] == pytest.approx(0.1 * drive.gain * drive.rated_voltage)
    assert scales["speed"] == pytest.approx(0.5)
    assert scales["position"] == pytest.approx(0.2)
    assert scales["viscous"] == pytest.approx(scales["force"] / 0.5)
    assert scales["stiffness"] == pytest.approx(scales["force"] / 0.2)
