"""Tests of the gain of effects on the held-out runs."""

from __future__ import annotations

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.evidence import held_out
from hframe_gym.identification.fit.estimation import prediction_cost
from hframe_gym.identification.forces.inverse_dynamics import force_error
from hframe_gym.identification.predict.prediction import POLISH_STEP
from tests.identification.scripted_fits import AXIS, DRAG, FRAME, PUSH, selected
from tests.identification.single_axis import axis_runs


def test_the_held_out_gain_compares_forces_with_the_widest_observer_and_costs_otherwise() -> None:
    """On a single axis, inverse dynamics gives the force; both show what a machine without the push lacks."""
    both, with_drag = AXIS.with_effects(PUSH, DRAG), AXIS.with_effects(DRAG)
    data = axis_runs(both, rows=1000, volts=6.0)
    for bandwidth in (60.0, 0.0):
        gain = held_out.held_out_gain(selected(PUSH), both, data, bandwidth)
        assert gain == held_out.error_reduction(with_drag, both, data, bandwidth)
        assert 0.5 < gain < 1.0
        assert held_out.error_reduction(both, with_drag, data, bandwidth) < -1.0
        assert held_out.is_excited(selected(PUSH), both, data, bandwidth)
    forces = [force_error(machine, data) for machine in (with_drag, both)]
    expected = 1.0 - (forces[1] / forces[0]) ** 2
    assert held_out.error_reduction(with_drag, both, data, 60.0) == pytest.approx(expected)
    costs = [prediction_cost(m, data, 0.0, longest_step=POLISH_STEP) for m in (with_drag, both)]
    assert held_out.error_reduction(with_drag, both, data, 0.0) == pytest.approx(1.0 - costs[1] / costs[0])


def test_the_gain_of_an_effect_on_a_sensor_compares_predictions() -> None:
    """Inverse dynamics uses one sensor of each coordinate, and says nothing about the others."""
    delayed = AXIS.with_effects(EFFECTS["sensor_delay"].at("x_m", d=0.004))
    data = axis_runs(delayed, rows=1000, volts=6.0)
    costs = [prediction_cost(m, data, 60.0, longest_step=POLISH_STEP) for m in (AXIS, delayed)]
    gain = held_out.held_out_gain(selected(delayed.effects[0]), delayed, data, 60.0)
    assert gain == pytest.approx(1.0 - costs[1] / costs[0])
    assert gain > 0.5


def test_the_gain_of_a_structure_compares_with_the_machine_before_it() -> None:
    """Without the effect alone, its coordinate would stay."""
    framed = AXIS.with_effects(FRAME)
    data = axis_runs(framed, rows=1000, volts=6.0)
    gain = held_out.held_out_gain(selected(FRAME), framed, data, 0.0)
    assert gain == held_out.error_reduction(AXIS, framed, data, 0.0)
    assert gain > 0.5


def test_an_effect_that_hardly_changes_a_prediction_is_not_excited() -> None:
    """A force of a hundred thousandth of a newton is no more than a thousandth of the noise."""
    tiny = EFFECTS["constant_force"].at("x", size=1e-5)
    data = axis_runs(AXIS, rows=1000, volts=6.0)
    assert not held_out.is_excited(selected(tiny), AXIS.with_effects(tiny), data, 60.0)
