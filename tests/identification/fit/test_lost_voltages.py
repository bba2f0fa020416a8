"""Tests of the voltages in rows that the logger dropped, which the motion determines."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import identify, prepare
from hframe_gym.identification.fit.lost_voltages import (
    _count_unknown_rows,
    estimate_lost_voltages,
    held_over_gaps,
    with_lost_voltages,
)
from hframe_gym.identification.predict.voltage_responses import _groups_together, voltage_responses
from hframe_gym.identification.validate.recording_simulation import simulate_recording
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording

AXIS, HFRAME = BUILTIN_MACHINES["axis"](), BUILTIN_MACHINES["hframe"]()
NOISE = 5e-6  # m
ROWS = 1500


def random_steps(seed: int, drives: int = 1) -> Array:
    """Return voltages that jump every 10 ms, after 0.1 s without voltage."""
    inputs = np.repeat(np.random.default_rng(seed).uniform(-3.0, 3.0, (ROWS // 10, drives)), 10, axis=0)
    inputs[:100] = 0.0
    return inputs


def recorded(machine: Machine, inputs: Array, seed: int) -> Recording:
    """Return a noisy recording without a gap."""
    time_s = np.arange(len(inputs)) * 1e-3
    outputs = machine.simulate(time_s, inputs).outputs
    noise = [5e-4 if sensor.incremental else NOISE for sensor in machine.sensors]
    return Recording(
        f"run_{seed}", time_s, inputs, outputs + np.random.default_rng(seed).normal(0.0, noise, outputs.shape)
    )


def without_rows(run: Recording, dropped: Sequence[int] | Array) -> Recording:
    """Return a recording without some rows."""
    keep = np.setdiff1d(np.arange(len(run.time_s)), dropped)
    return Recording(run.name, run.time_s[keep], run.inputs[keep], run.outputs[keep])


def random_rows(seed: int) -> Array:
    """Return 2 % of the rows, all of them after the rest."""
    return 100 + np.flatnonzero(np.random.default_rng(seed).random(ROWS - 101) < 0.02)


@pytest.mark.parametrize(("machine", "improvement"), [(AXIS, 3.0), (HFRAME, 5.0)])
def test_the_motion_determines_lost_voltages(machine: Machine, improvement: float) -> None:
    complete = recorded(machine, random_steps(1, len(machine.drives)), 1)
    rows = random_rows(1)
    data = prepare([without_rows(complete, rows)], machine)
    estimated = estimate_lost_voltages(data, machine)
    errors = [np.linalg.norm(d.runs[0].inputs - complete.inputs, axis=1) for d in (data, estimated)]
    assert np.array_equal(np.flatnonzero(data.runs[0].dropped), rows)
    assert np.max(np.delete(errors[1], rows)) == 0.0  # recorded voltages stay
    assert improvement * np.linalg.norm(errors[1]) < np.linalg.norm(errors[0])
    assert estimate_lost_voltages(estimated, machine) is estimated


def test_a_recording_without_gaps_is_unchanged() -> None:
    data = prepare([recorded(AXIS, random_steps(1), 1)], AXIS)
    assert estimate_lost_voltages(data, AXIS) is data


def test_voltages_in_long_gaps_stay_interpolated() -> None:
    complete = recorded(AXIS, random_steps(1), 1)
    data = prepare([without_rows(complete, np.arange(300, 321))], AXIS)
    assert estimate_lost_voltages(data, AXIS) is data
    data = prepare([without_rows(complete, np.arange(300, 320))], AXIS)
    assert estimate_lost_voltages(data, AXIS) is not data


def late_controller(commands: Array, gaps: Sequence[tuple[int, int]], seed: int) -> Recording:
    """Return the log of a controller that neither computed nor logged in gaps: commands were held."""
    lost = np.concatenate([np.arange(first, end) for first, end in gaps])
    kept = np.setdiff1d(np.arange(ROWS), lost)
    held = commands[kept[np.searchsorted(kept, np.arange(ROWS), side="right") - 1]]
    return without_rows(recorded(AXIS, held, seed), lost)


LONG_GAPS = [(195, 260), (395, 460), (795, 830)]
SHORT_GAPS = [(first, first + 15) for first in range(195, 1400, 100)]


@pytest.mark.parametrize("gaps", [LONG_GAPS, SHORT_GAPS])
def test_commands_of_a_late_controller_are_held_over_its_gaps(gaps: Sequence[tuple[int, int]]) -> None:
    """Interpolation begins steps that fall into gaps too early: it leaves 3440 and 2.5 times the noise."""
    steps = np.repeat(np.random.default_rng(5).uniform(-3.0, 3.0, (ROWS // 100, 1)), 100, axis=0)
    steps[:100] = 0.0
    run = late_controller(steps, gaps, 5)
    assert np.sqrt(np.mean(simulate_recording(AXIS, run).error ** 2)) < 1.5 * NOISE
    data = prepare([run], AXIS)
    lines: list[str] = []
    fitted, _, held = with_lost_voltages(AXIS, data, data, lines.append)
    assert lines[-1].startswith("the commands keep their last value over the gaps")
    assert held
    (known,) = held_over_gaps(data).runs  # for the plain fit, which uses no estimates
    for first, end in gaps:
        assert np.all(known.inputs[first:end] == known.inputs[first - 1])
    assert np.max(np.abs(fitted.runs[0].inputs - data.runs[0].inputs)) > 1.0


def test_a_wrong_machine_does_not_move_held_commands() -> None:
    """It would have commands far beyond those at the ends of a gap, which its simulations then use."""
    steps = np.repeat(np.random.default_rng(5).uniform(-3.0, 3.0, (ROWS // 100, 1)), 100, axis=0)
    steps[:100] = 0.0
    run = late_controller(steps, SHORT_GAPS, 5)
    wrong = AXIS.replace({"x.mass": 0.7 * AXIS.coordinates[0].mass})
    (estimated,) = estimate_lost_voltages(prepare([run], AXIS), wrong).runs
    for first, end in SHORT_GAPS:
        assert np.all(estimated.inputs[first:end] == estimated.inputs[first - 1])


def test_a_step_within_a_single_gap_is_estimated_although_a_held_command_is_nearer() -> None:
    """The logger lost rows 95 to 110; the step in row 108 is nearer to their end than to their middle."""
    steps = np.where(np.arange(ROWS) < 108, 1.0, 3.0)[:, None] * (np.arange(ROWS) >= 50)[:, None]
    complete = recorded(AXIS, steps, 5)
    data = prepare([without_rows(complete, np.arange(95, 110))], AXIS)
    (estimated,) = estimate_lost_voltages(data, AXIS).runs
    lost = slice(95, 110)
    assert np.sum(estimated.inputs[lost] - steps[lost]) == pytest.approx(0.0, abs=0.4)  # held: -4 V


def test_smooth_commands_are_not_held() -> None:
    """A command that changes in every row also changed in the gaps, whatever a wrong machine seems to say."""
    time_s = np.arange(ROWS) * 1e-3
    smooth = np.where(time_s > 0.1, 3.0 * np.sin(20.0 * (time_s - 0.1)), 0.0)[:, None]
    data = prepare([late_controller(smooth, LONG_GAPS, 6)], AXIS)
    assert estimate_lost_voltages(data, AXIS) is data


def test_a_wrong_machine_leaves_smooth_voltages_at_their_spline() -> None:
    """What the machine does not explain counts as noise; recorded rows show a spline accurate to 1 mV."""
    time_s = np.arange(ROWS) * 1e-3
    inputs = np.where(time_s > 0.1, 3.0 * np.sin(300.0 * (time_s - 0.1)), 0.0)[:, None]
    complete, rows = recorded(AXIS, inputs, 2), random_rows(2)
    data = prepare([without_rows(complete, rows)], AXIS)
    wrong = AXIS.replace({"x.mass": 0.5 * AXIS.coordinates[0].mass})
    errors = [
        np.sqrt(np.mean((d.runs[0].inputs - inputs)[rows] ** 2))
        for d in (data, estimate_lost_voltages(data, wrong))
    ]
    assert errors[0] > 0.05
    assert errors[1] < 0.01


def test_a_wrong_machine_moves_no_voltage_that_is_equal_on_both_sides_of_a_gap() -> None:
    """Recorded rows show that such a voltage does not change in between."""
    complete, rows = recorded(AXIS, random_steps(4), 4), random_rows(4)
    data = prepare([without_rows(complete, rows)], AXIS)
    wrong = AXIS.replace({"x.mass": 0.5 * AXIS.coordinates[0].mass})
    moved = np.abs(estimate_lost_voltages(data, wrong).runs[0].inputs - data.runs[0].inputs)[rows, 0]
    equal = np.abs(data.runs[0].inputs[rows - 1] - data.runs[0].inputs[rows + 1])[:, 0] == 0.0
    assert np.max(moved[equal]) < 1e-3
    assert np.max(moved[~equal]) > 0.1


def test_a_simulation_over_a_recording_with_gaps_agrees_with_the_measurements() -> None:
    complete = recorded(AXIS, random_steps(3), 3)
    gaps = without_rows(complete, random_rows(3))
    error = simulate_recording(AXIS, gaps).error
    assert error.shape == gaps.outputs.shape
    assert np.sqrt(np.mean(error**2)) < 1.5 * NOISE
    # Without measurements, voltages in gaps are interpolated.
    blind = Recording(gaps.name, gaps.time_s, gaps.inputs, np.full_like(gaps.outputs, np.nan))
    difference = simulate_recording(AXIS, blind).outputs - gaps.outputs
    assert np.sqrt(np.mean(difference**2)) > 10.0 * NOISE


def test_a_machine_that_lacks_nothing_is_recognized_despite_dropped_rows() -> None:
    rig = AXIS.replace(
        {"x.mass": 1.1 * AXIS.coordinates[0].mass, "x.coulomb": 0.8 * AXIS.coordinates[0].coulomb}
    )
    runs = [without_rows(recorded(rig, random_steps(seed), seed), random_rows(seed)) for seed in range(4)]
    lines: list[str] = []
    result = identify(runs, AXIS, log=lines.append)
    assert result.verdict == "no_effect"
    count = sum(len(random_rows(seed)) for seed in range(4))
    assert f"voltages of {count} dropped rows are estimated from the measurements" in lines
    ratio = result.after.held_out.channels["x_m"].noise_ratio
    assert ratio is not None
    assert ratio < 2.0  # in open loop; with interpolated voltages it is 15


def jacobians(run: Recording, machine: Machine, bandwidth: float) -> tuple[Array, Array]:
    """Return the Jacobian with several rows in one prediction, and with one row in each prediction."""
    data = prepare([run], machine)
    rows = np.flatnonzero(data.runs[0].dropped)
    together, _ = voltage_responses(machine, data.runs[0], data, rows, bandwidth)
    alone = [
        voltage_responses(machine, data.runs[0], data, rows[k : k + 1], bandwidth)[0]
        for k in range(len(rows))
    ]
    return together.toarray(), np.hstack([one.toarray() for one in alone])


@pytest.mark.parametrize("measured_every", [1, 5])
def test_rows_that_are_perturbed_together_have_the_derivatives_of_single_rows(measured_every: int) -> None:
    """The observer corrects only where a sensor measures, and all rows determine the zero of the sensor."""
    inputs = np.where(np.arange(8 * ROWS) < 100, 0.0, 3.0)[:, None]  # the axis never sticks after the rest
    complete = recorded(AXIS, inputs, 1)
    complete.outputs[np.arange(8 * ROWS) % measured_every > 0] = np.nan
    together, alone = jacobians(without_rows(complete, np.arange(501, 8 * ROWS, 499)), AXIS, 60.0)
    assert np.linalg.norm(together - alone) < 0.05 * np.linalg.norm(alone)


def test_few_histories_are_predicted_together() -> None:
    """Memory must not grow with the number of dropped rows; the result does not depend on the division."""
    run = without_rows(recorded(HFRAME, random_steps(1, 2), 1), random_rows(1))
    data = prepare([run], HFRAME)
    rows = np.flatnonzero(data.runs[0].dropped)
    model = HFRAME, data.runs[0], data, rows, 60.0
    (together, residual), (divided, same) = (
        voltage_responses(*model),
        voltage_responses(*model, most_values=30_000),
    )
    np.testing.assert_array_equal(together.toarray(), divided.toarray())
    np.testing.assert_array_equal(residual, same)
    assert [_groups_together(30_000, values) for values in (3_000, 7_000, 30_001)] == [10, 4, 1]


def test_voltages_are_estimated_although_no_recorded_row_lies_between_two_others() -> None:
    """With a row of three missing, no row shows how accurate interpolation is."""
    complete = recorded(AXIS, random_steps(1), 1)
    run = without_rows(complete, np.arange(100, ROWS - 1, 3))
    error = simulate_recording(AXIS, run).error
    assert np.sqrt(np.mean(error**2)) < 50.0 * NOISE  # with interpolated voltages it is 250


def test_the_row_in_which_a_constant_voltage_begins_is_estimated() -> None:
    """All recorded rows but four are predicted exactly, which says nothing about the step."""
    inputs = np.where(np.arange(ROWS) < 101, 0.0, 1.5)[:, None]
    run = without_rows(recorded(AXIS, inputs, 1), [101, 500])
    error = simulate_recording(AXIS, run).error
    assert np.sqrt(np.mean(error**2)) < 1.1 * NOISE
    estimated = estimate_lost_voltages(prepare([run], AXIS), AXIS).runs[0].inputs
    np.testing.assert_allclose(estimated, inputs, atol=5e-3)
    assert estimated[500] == 1.5  # equal on both sides


def test_voltages_at_which_the_machine_starts_and_stops_are_estimated() -> None:
    """The response to a voltage depends on it where friction holds; one linearization is not enough."""
    inputs = np.random.default_rng(7).uniform(-3.0, 3.0, (ROWS, 1))
    inputs[:100] = 0.0
    run = without_rows(recorded(AXIS, inputs, 7), random_rows(7))
    assert np.sqrt(np.mean(simulate_recording(AXIS, run).error ** 2)) < 1.5 * NOISE


def test_saturated_measurements_determine_no_voltages() -> None:
    complete = recorded(HFRAME, random_steps(3, 2), 3)
    x = HFRAME.output_channels.index("x_m")
    saturated = complete.outputs.copy()
    saturated[:, x] = np.minimum(saturated[:, x], np.quantile(saturated[:, x], 0.9))
    gaps = without_rows(dataclasses.replace(complete, outputs=saturated), random_rows(3))
    difference = simulate_recording(HFRAME, gaps).outputs - without_rows(complete, random_rows(3)).outputs
    # 20 if the end of the range counts as a position
    assert np.sqrt(np.mean(difference[:, x] ** 2)) < 2.0 * NOISE


def test_delays_between_two_rows_are_resolved() -> None:
    machine = HFRAME.with_effects(EFFECTS["input_delay"].at("drives", d=2.3e-3))
    inputs = random_steps(1, 2)
    run = without_rows(recorded(machine, inputs, 1), random_rows(1))
    error = simulate_recording(machine, run).error
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 1.2 * np.array([5e-4, 5e-4, NOISE, NOISE]))


def test_rows_in_long_gaps_are_not_counted_as_estimated() -> None:
    complete = [recorded(AXIS, random_steps(seed), seed) for seed in range(2)]
    data = prepare([without_rows(run, np.arange(300, 321)) for run in complete], AXIS)
    lines: list[str] = []
    assert with_lost_voltages(AXIS, data, data, lines.append) == (data, data, False)
    assert lines == []
    assert _count_unknown_rows(prepare([without_rows(complete[0], [*range(300, 321), 500])], AXIS)) == 1
