"""Predictions of held-out runs, by run and sensor."""

from __future__ import annotations

from hframe_gym.identification.validate.held_out_predictions import predictions_by_run
from hframe_gym.identification.validate.machine_errors import ModelEvaluation, PredictionErrors
from tests.identification.single_axis import AXIS, axis_runs


def test_the_true_machine_leaves_noise_of_each_run_and_a_wrong_one_more() -> None:
    data = axis_runs(AXIS, rows=1000, volts=6.0)
    heavier = AXIS.replace({"x.mass": 1.2 * AXIS.coordinates[0].mass})
    right, wrong = (
        predictions_by_run(ModelEvaluation(machine, PredictionErrors({}, None)), data, data)
        for machine in (AXIS, heavier)
    )
    assert right.judging.shape == right.slow.shape == (3, 1)
    assert max(right.worst) < 1.5  # the noise is estimated from 50 rows at rest
    assert min(right.judging.min(), right.slow.min()) > 0.7
    assert min(wrong.worst) > 2.0
