"""Predictions of held-out runs, by run and sensor."""

from __future__ import annotations

import math

import numpy as np

from hframe_gym.identification.validate.held_out_predictions import largest, predictions_by_run
from hframe_gym.identification.validate.machine_errors import ModelEvaluation, PredictionErrors
from tests.identification.single_axis import AXIS, axis_runs


def test_the_true_machine_leaves_noise_of_each_run_and_a_wrong_one_more() -> None:
    data = axis_runs(AXIS, rows=1000, volts=6.0)
    heavier = AXIS.replace({"x.mass": 1.2 * AXIS.coordinates[0].mass})
    right, wrong = (
        predictions_by_run(ModelEvaluation(machine, PredictionErrors({}, None)), data, data)
        for machine in (AXIS, heavier)
    )
    assert right.shape == (3, 1)
    assert largest(right) < 1.5  # the noise is estimated from 50 rows at rest
    assert right.min() > 0.7
    assert largest(wrong) > 2.0


def test_the_largest_error_is_that_of_what_is_measured() -> None:
    nan = math.nan
    assert largest(np.array([[1.0, nan], [1.1, nan]])) == 1.1
    assert largest(np.array([[nan], [math.inf]])) == math.inf
    assert largest(np.array([[nan]])) == math.inf
