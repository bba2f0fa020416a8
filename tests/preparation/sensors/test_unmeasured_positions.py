"""Tests of machines whose declared positions no run measures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import identify
from hframe_gym.machine import Machine, Sensor
from hframe_gym.preparation.sensors.unmeasured_positions import without_unmeasured_positions
from hframe_gym.recordings import Recording
from tests.identification.single_axis import AXIS

SPEED = Sensor("x_m_s", {"x": 1.0}, noise=1e-3, kind="speed")
BOTH = AXIS.replace(sensors=(*AXIS.sensors, SPEED))


def runs_of_speed(truth: Machine) -> list[Recording]:
    """Return three runs in which the speed alone was measured."""
    rng = np.random.default_rng(3)
    runs = []
    for k in range(3):
        time_s = np.arange(2000) * 1e-3
        inputs = np.repeat(rng.uniform(-6.0, 6.0, (10, 1)), 200, axis=0)
        inputs[:100] = 0.0
        outputs = truth.simulate(time_s, inputs).outputs + rng.normal(0.0, 1e-3, (2000, 2))
        outputs[:, 0] = np.nan
        runs.append(Recording(f"run_{k}", time_s, inputs, outputs))
    return runs


@pytest.mark.parametrize(
    ("measured", "left_out"),
    [((False, True), True), ((True, True), False), ((True, False), False), ((False, False), False)],
)
def test_positions_are_left_out_if_only_speeds_are_measured(
    measured: tuple[bool, bool], left_out: bool
) -> None:
    values = np.where(measured, 1.0, np.nan) * np.ones((20, 2))
    empty = Recording("empty", np.arange(20.0), np.zeros((20, 1)), np.full((20, 2), np.nan))
    run = dataclasses.replace(empty, name="run", outputs=values)
    of_encoder = EFFECTS["interpolation_error"].at(AXIS.sensors[0].channel, A=1e-6, n=1e3, p=0.0)
    with_effects = BOTH.with_effects(of_encoder)
    runs, machine, statements = without_unmeasured_positions([empty, run], with_effects)
    assert machine.output_channels == (("x_m_s",) if left_out else BOTH.output_channels)
    assert all(r.outputs.shape == (20, 1 if left_out else 2) for r in runs)
    assert (machine.effects == ()) == left_out
    assert [AXIS.sensors[0].channel in s for s in statements] == [True] * left_out


def test_a_declared_encoder_that_measured_nothing_does_not_cost_the_plain_fit() -> None:
    """An observer would correct no speed beside it, and there would be no balance of forces."""
    truth = BOTH.replace({"x.mass": 4.0 * AXIS.coordinates[0].mass})
    result = identify(runs_of_speed(truth), BOTH, budget=0.0)
    assert result.plain is not None
    assert result.plain.evaluation.held_out.noise_ratio < 1.2
    assert result.after.held_out.noise_ratio < 1.2
    assert result.declared.machine.output_channels == ("x_m_s",)
    assert any(AXIS.sensors[0].channel in sentence for sentence in result.excluded)
