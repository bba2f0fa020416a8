"""Outliers: single wrong samples are found, and shocks and stops of a real motion are none."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording, load_recordings, outlier_mask, without_outliers
from tests.example_runs import example_runs

X = 2  # column of x_m


@pytest.fixture
def run() -> Recording:
    """Return a recorded run of 2.5 s, whose arrays cannot be written."""
    return example_runs("rig_b")[1]


def with_x(run: Recording, x: np.ndarray) -> Recording:
    """Return the run with other measurements of x."""
    return dataclasses.replace(run, outputs=np.column_stack([run.outputs[:, :X], x, run.outputs[:, X + 1 :]]))


def test_recorded_runs_have_no_outliers(hframe: Machine) -> None:
    for rig in ("rig_a", "rig_b"):
        assert not any(outlier_mask(r, hframe).any() for r in example_runs(rig))


@pytest.mark.parametrize("rows", [[1200], [1200, 1201, 1202], [700, 704, 1900]])
@pytest.mark.parametrize("size", [0.05, -0.003])
def test_single_wrong_samples_are_found(
    rows: list[int], size: float, run: Recording, hframe: Machine
) -> None:
    x = run.outputs[:, X].copy()
    x[rows] += size
    mask = outlier_mask(with_x(run, x), hframe)
    assert np.flatnonzero(mask[:, X]).tolist() == rows
    assert mask.sum() == len(rows)
    cleaned = without_outliers(with_x(run, x), hframe)
    assert np.flatnonzero(np.isnan(cleaned.outputs[:, X])).tolist() == rows


@pytest.mark.parametrize("row", [0, 2499])
def test_the_first_and_the_last_sample_are_examined(row: int, run: Recording, hframe: Machine) -> None:
    x = run.outputs[:, X].copy()
    x[row] += 0.05
    assert np.flatnonzero(outlier_mask(with_x(run, x), hframe)[:, X]).tolist() == [row]


def test_a_dropped_word_is_found_in_every_channel(run: Recording, hframe: Machine) -> None:
    outputs = run.outputs.copy()
    outputs[1000] = 0.0
    mask = outlier_mask(dataclasses.replace(run, outputs=outputs), hframe)
    assert mask[1000].all()
    assert mask.sum() == 4


def test_the_few_samples_of_a_move_in_a_slow_log_are_no_outliers() -> None:
    """A servo at rest, logged at 10 Hz, moves within four samples; a dropped value leaves the motion."""
    machine = BUILTIN_MACHINES["servo"]()
    rests = np.full(200, 2.9836), np.full(200, 3.1339)
    angle = np.concatenate([rests[0], [2.9974, 3.0434, 3.1032, 3.1309], rests[1]])
    log = Recording("log", 0.1 * np.arange(len(angle)), np.zeros((len(angle), 1)), angle[:, None])
    assert not outlier_mask(log, machine).any()
    angle[108] = 0.0
    assert np.flatnonzero(outlier_mask(log, machine)).tolist() == [108]


@pytest.mark.parametrize(
    ("samples", "outliers"),
    [
        ([0.28, 0.16], []),  # turns back between both rests
        ([0.20, 0.36, 0.30], []),
        ([0.28, 0.60], [201]),  # leaves the range of the move
    ],
)
def test_a_move_that_turns_back_between_two_rests_has_no_outliers(
    samples: list[float], outliers: list[int]
) -> None:
    """A cylinder at rest, logged at 10 Hz, bounces on its way from 0.1 to 0.4 rad."""
    angle = np.concatenate([np.full(200, 0.1), samples, np.full(200, 0.4)])
    log = Recording("log", 0.1 * np.arange(len(angle)), np.zeros((len(angle), 1)), angle[:, None])
    assert np.flatnonzero(outlier_mask(log, BUILTIN_MACHINES["servo"]())).tolist() == outliers


def test_outliers_are_found_between_empty_cells(run: Recording, hframe: Machine) -> None:
    x = np.where(np.arange(len(run.time_s)) % 5 == 2, run.outputs[:, X], np.nan)
    assert not outlier_mask(with_x(run, x), hframe).any()
    x[1202] += 0.02
    assert np.flatnonzero(outlier_mask(with_x(run, x), hframe)[:, X]).tolist() == [1202]


@pytest.mark.parametrize("noise", [0.0, 2e-5])
def test_shocks_and_stops_are_no_outliers(noise: float, run: Recording, hframe: Machine) -> None:
    """Impacts that reverse the speed within a sample, vibration after a shock, a sudden stop and a step."""
    t = np.arange(len(run.time_s)) * 1e-3
    bouncing = 0.1 * np.abs((7.3 * t) % 2 - 1)  # m; 0.73 m/s, reversed at either end
    stopping = np.where(t < 1.2345, 0.05 * np.sin(8 * t), 0.05 * np.sin(8 * 1.2345))
    since = np.maximum(t - 1.5003, 0.0)  # s after a shock
    ringing = bouncing + 1e-3 * np.exp(-since / 4e-3) * np.sin(2 * np.pi * 280 * since)
    stepping = np.where(t < 1.0, 0.0, 0.004)
    normal = np.random.default_rng(0).standard_normal(len(t))
    for x in (bouncing, stopping, stepping, ringing):
        assert not outlier_mask(with_x(run, x + noise * normal), hframe).any()


def test_a_shock_near_the_end_of_a_run_is_no_outlier(run: Recording, hframe: Machine) -> None:
    """A motor is reversed five samples before the end: it stops within two samples and vibrates."""
    x = 6e-3 * np.arange(len(run.time_s))
    x[-5:] = x[-6] + 8e-5 * np.array([47.0, 52.0, 35.0, 10.0, -9.0])
    assert not outlier_mask(with_x(run, x), hframe).any()


def test_a_run_that_is_too_short_for_a_scale_has_no_outliers(run: Recording, hframe: Machine) -> None:
    short = Recording(
        "short", run.time_s[:20], run.inputs[:20], run.outputs[:20] * 0 + np.arange(20)[:, None] ** 3
    )
    assert not outlier_mask(short, hframe).any()


def test_a_wrong_sample_is_no_evidence_of_a_wrong_unit(
    tmp_path: Path, run: Recording, hframe: Machine
) -> None:
    x = run.outputs[:, X].copy()
    x[1000] = 32.767
    table = np.column_stack([run.time_s, run.inputs, with_x(run, x).outputs])
    header = ",".join(["time_s", *hframe.input_channels, *hframe.output_channels])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=header, comments="")
    [loaded] = load_recordings(tmp_path, hframe)
    assert np.flatnonzero(outlier_mask(loaded, hframe)[:, X]).tolist() == [1000]


def test_steps_of_an_encoder_that_is_coarser_than_declared_are_no_outliers() -> None:
    """At rest between two counts, single samples are one count off, 25 times the declared noise."""
    axis = BUILTIN_MACHINES["axis"]()
    count, time_s = 5e-4, np.arange(2000) * 1e-3
    position = np.zeros(2000)
    position[100::190] = count
    coarse = Recording("run", time_s, np.zeros((2000, 1)), position[:, None])
    assert axis.sensors[0].noise < count / 20
    assert not outlier_mask(coarse, axis).any()
    beyond = coarse.outputs.copy()
    beyond[1000] += 30 * count
    assert np.flatnonzero(outlier_mask(dataclasses.replace(coarse, outputs=beyond), axis)).tolist() == [1000]
