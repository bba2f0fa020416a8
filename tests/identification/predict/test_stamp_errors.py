"""Tests of what rounded stamps do to predictions, and of the verdict where they are rounded."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, SelectionCriteria, identify, prepare
from hframe_gym.identification.fit.channel_errors import errors_by_channel
from hframe_gym.identification.predict.prediction import SIMULATION
from hframe_gym.identification.predict.stamp_errors import (
    has_stamp_errors,
    prediction_changes,
    stamp_deviation,
)
from hframe_gym.identification.validate.evaluation import HeldOutTest
from hframe_gym.identification.validate.machine_errors import (
    ModelEvaluation,
    PredictionErrors,
    evaluate_held_out,
)
from hframe_gym.machine import Machine
from hframe_gym.preparation.session import prepare_session
from hframe_gym.recordings import Recording
from tests.identification.single_axis import AXIS

PERIOD, JITTER = 5e-3, 0.8e-3  # s; the samples are up to so early or late
NOISE = 5e-6  # m


def stamped_runs(truth: Machine = AXIS, digits: int = 4, rows: int = 800) -> list[Recording]:
    """Return four runs whose samples have no regular clock, with stamps of this many decimals."""
    rng = np.random.default_rng(5)
    recordings = []
    for k in range(4):
        late = np.where(np.arange(rows) > 0, rng.uniform(-JITTER, JITTER, rows), 0.0)
        time_s = PERIOD * np.arange(rows) + late
        moving = (time_s > 0.25)[:, None]
        steps = np.repeat(rng.uniform(-6.0, 6.0, (rows // 16, 1)), 16, axis=0)
        inputs = np.where(moving, steps if k % 2 else 6.0 * np.sin((5.0 + k) * time_s)[:, None], 0.0)
        outputs = simulate(truth, time_s, inputs).outputs + rng.normal(0.0, NOISE, (rows, 1))
        recordings.append(Recording(f"run_{k}", np.round(time_s, digits), inputs, outputs))
    return recordings


@pytest.fixture(scope="module")
def data() -> Dataset:
    return prepare(stamped_runs(), AXIS)


def test_stamps_err_by_their_rounding_as_far_as_motion_shows_it(data: Dataset) -> None:
    of_rounding = 1e-4 / np.sqrt(12.0)
    assert data.jitter == pytest.approx(of_rounding, rel=0.3)
    assert stamp_deviation(data.runs[0], data) == pytest.approx(min(of_rounding, data.jitter))
    assert stamp_deviation(data.runs[0], dataclasses.replace(data, jitter=1e-6)) == 1e-6
    assert not has_stamp_errors(dataclasses.replace(data, jitter=0.0))


@pytest.mark.parametrize("digits", [7, 9])
def test_jitter_alone_is_no_rounding(digits: int) -> None:
    """What looks like jitter may be a missing force: only rounding that stamps show counts."""
    runs = prepare(stamped_runs(digits=digits), AXIS)
    assert stamp_deviation(runs.runs[0], dataclasses.replace(runs, jitter=1e-4)) < 1e-7


def test_whole_periods_do_not_tell_rounding_from_missing_rows() -> None:
    time_s = 1e-3 * np.delete(np.arange(900), [200, 500])
    outputs = 0.1 * np.sin(9.0 * time_s)[:, None]
    runs = prepare([Recording("run", time_s, np.zeros((len(time_s), 1)), outputs)], AXIS)
    assert stamp_deviation(runs.runs[0], dataclasses.replace(runs, jitter=1e-4)) == 0.0


def test_the_exact_machine_leaves_what_rounded_stamps_change(data: Dataset) -> None:
    left = evaluate_held_out(AXIS, data, stamped_runs()).held_out.channels["x_m"].rmse
    expected = prediction_changes(AXIS, data, SIMULATION)[0]
    assert left is not None
    assert expected > 5.0 * data.noise[0]
    assert 0.4 < left / expected < 2.5  # errors that add up are known that well
    assert prediction_changes(AXIS, data, 60.0)[0] < 0.5 * expected  # an observer takes them back


@pytest.mark.parametrize(("in_noise", "explains"), [(0.8, False), (1.5, True)])
def test_rounding_that_causes_less_than_noise_explains_nothing(in_noise: float, explains: bool) -> None:
    """Beside noise as large, an error of 2.3 times the noise would pass for one of the stamps."""
    session = prepare_session(stamped_runs(), AXIS, lambda _: None)
    noise = prediction_changes(AXIS, session.data, SIMULATION) / in_noise
    test = HeldOutTest(session, dataclasses.replace(session.data, noise=noise), SelectionCriteria())
    errors = {run.name: np.full(run.outputs.shape, 2.3 * noise) for run in session.data.runs}
    channels = errors_by_channel(list(errors.values()), AXIS, noise)
    model = ModelEvaluation(AXIS, PredictionErrors(channels, None), errors)
    assert test.rounded_stamps_explain(model) == explains


@pytest.mark.integration
def test_no_effect_is_said_where_rounded_stamps_cause_the_error() -> None:
    result = identify(stamped_runs(), AXIS)
    assert (result.verdict, result.effects) == ("no_effect", ())
    left = result.after.held_out.noise_ratio
    assert left > 2.0
    assert result.rounded_stamps
    assert result.after.machine.effects == ()
    assert result.plain is None or not result.plain.delivered
    assert any("time stamps are rounded" in warning for warning in result.notes)


@pytest.mark.integration
def test_rounded_stamps_hide_no_friction() -> None:
    truth = AXIS.with_effects(EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.04))
    assert identify(stamped_runs(truth), AXIS).verdict != "no_effect"
