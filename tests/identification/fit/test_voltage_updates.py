"""Tests of logs that are slower than the controller: its voltages change between their rows."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from hframe_gym import simulate
from hframe_gym.data_validation.sampling import check_voltages_between_rows
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, Fit, SelectionCriteria, default_free_parameters, fit, prepare
from hframe_gym.identification.budget import Budget
from hframe_gym.identification.fit.covariance import DELAY_STD
from hframe_gym.identification.fit.model_error import continue_fit
from hframe_gym.identification.fit.slow_logs import ExcessDelay, excess_delay
from hframe_gym.identification.fit.voltage_updates import (
    VoltageUpdates,
    _changing_beside_delay,
    _delays_all_drives,
    _held_after_all,
    _least_error,
    _with_delay,
    can_show_updates,
    count_updates,
    describe_interpolation,
    most_updates,
    number_with_clear_gains,
    number_with_least_excess,
    other_updates,
    successive_changes,
    voltage_updates,
)
from hframe_gym.identification.judge.voltages import voltages_change_at_another_rate
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, SIMULATION, predict
from hframe_gym.identification.predict.voltage_errors import with_voltage_errors
from hframe_gym.identification.search.checked_search import _interpolated, _Runs, _Voltages, find_effects
from hframe_gym.identification.validate.recording_simulation import simulate_recording
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.preparation.inputs.interpolated_voltages import mean_inputs, update_times, updated_inputs
from hframe_gym.recordings import Recording
from tests.identification.controlled_runs import PERIOD, controlled_run, every, random_places
from tests.identification.scripted_fits import fit_with

AXIS = BUILTIN_MACHINES["axis"]()
RIG = AXIS.replace({"x.mass": 1.1 * AXIS.coordinates[0].mass, "x.coulomb": 0.8 * AXIS.coordinates[0].coulomb})
NOISE = 5e-6  # m
ROWS = 1500


@cache
def controlled(seed: int) -> Recording:
    """Return a run of a controller that moves the axis from place to place and reads a noisy sensor."""
    return moved(seed, window=120)


def moved(seed: int, window: int) -> Recording:
    """Return such a run whose moves take that many rows."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(0.0, NOISE, (ROWS, 1))
    places = random_places(rng, ROWS)
    return controlled_run(f"run_{seed}", RIG, places, noise, window=window, gains=(300.0, 5.0))


@cache
def slow_log(rows: int) -> Dataset:
    """Return prepared logs with every such row of three runs."""
    return prepare([every(controlled(seed), rows) for seed in range(3)], AXIS)


def refitted(data: Dataset) -> Fit:
    """Return the axis fitted to a log as it is."""
    return fit(AXIS, default_free_parameters(AXIS), data, SEARCH_BANDWIDTH)


def found(data: Dataset) -> VoltageUpdates:
    """Return how often the voltages change between the rows of a log."""
    return voltage_updates(refitted(data), data, SelectionCriteria())


@pytest.mark.parametrize(("every_row", "expected"), [(False, 0.0), (True, 1.0)])
def test_dropped_rows_show_neither_changes_nor_rests(every_row: bool, expected: float) -> None:
    """Straight lines over gaps change in row after row, whatever the command does."""
    volts = np.random.default_rng(1).uniform(-1.0, 1.0, (300, 1))
    volts = volts if every_row else np.repeat(volts[::20], 20, axis=0)
    keep = np.arange(300) % 40 < 25  # steps at the rows 20, 60, ... are recorded
    run = Recording("run", np.arange(300)[keep] * PERIOD, volts[keep], np.zeros((keep.sum(), 1)))
    assert successive_changes(prepare([run], AXIS)) == pytest.approx(expected, abs=0.01)


def faster(data: Dataset, times: float) -> Dataset:
    """Return a log whose clock runs faster."""
    return dataclasses.replace(
        data, runs=tuple(dataclasses.replace(run, time_s=run.time_s / times) for run in data.runs)
    )


@pytest.mark.parametrize(
    ("period", "most"),
    [(10e-3, 20), (4e-3, 16), (1e-3, 4), (0.5e-3, 2), (0.49e-3, 2), (0.3125e-3, 1), (2e-5, 1)],
)
def test_changes_are_no_closer_than_the_steps_of_the_search(period: float, most: int) -> None:
    assert most_updates(faster(slow_log(4), 4e-3 / period)) == most


def test_rows_as_close_as_the_steps_of_the_search_are_not_divided() -> None:
    """A log at 3200 Hz is fitted with held voltages only; with 16 changes a row, fits are 16 times slower."""
    slow = slow_log(4)
    fast = faster(slow, 4e-3 / 0.3125e-3)
    assert can_show_updates(slow)
    assert not can_show_updates(fast)
    held = fit(AXIS, default_free_parameters(AXIS), fast, SEARCH_BANDWIDTH, iterations=2)
    assert _least_error(held, fast, SelectionCriteria()) == (1, held)  # the same fit, beside no other one
    assert voltage_updates(held, fast, SelectionCriteria()).per_row == 1


def test_held_voltages_stay_held() -> None:
    assert found(slow_log(1)).per_row == 1


def test_the_motion_shows_how_often_the_voltages_change() -> None:
    updates = found(slow_log(4))
    assert updates.per_row in (3, 4, 5)
    assert updates.fitted < 0.5 * updates.held
    assert "change between the rows, about" in updates.describe("voltages", 4e-3)


@pytest.mark.parametrize(("bandwidth", "updates"), [(SEARCH_BANDWIDTH, 1), (15.0, 2), (SIMULATION, 2)])
def test_a_narrower_observer_shows_what_lasting_noise_hides(bandwidth: float, updates: int) -> None:
    """A wide one follows noise of 20 ms, which then leaves more than held voltages do."""
    kept, rng, logs = np.exp(-PERIOD / 0.02), np.random.default_rng(10), []
    for seed in range(3):
        run = controlled(seed)
        white = 8.0 * NOISE * np.sqrt(1.0 - kept**2) * rng.normal(size=run.outputs.shape)
        lasting = lfilter([1.0], [1.0, -kept], white, axis=0)
        logs.append(every(dataclasses.replace(run, outputs=run.outputs + lasting), 2))
    data = prepare(logs, AXIS)
    fitted = continue_fit(refitted(data), data, bandwidth)
    assert voltage_updates(fitted, data, SelectionCriteria()).per_row == updates


@cache
def delayed_log(changes: int = 2) -> Dataset:
    """Return logs of a drive that acts late by some of four changes a row; by two, as held voltages do."""
    runs = (moved(seed, window=30) for seed in range(3))
    late = (dataclasses.replace(run, inputs=np.roll(run.inputs, -changes)) for run in runs)
    return prepare([every(run, 4) for run in late], AXIS)


def test_a_delay_of_the_drives_does_not_hide_that_voltages_change_between_the_rows() -> None:
    """Held voltages act nearly as late, two changes a row without delay earlier, but they are smoother."""
    data = delayed_log()
    assert refitted(data.with_updates(2)).chi2 > refitted(data).chi2
    updates = found(data)
    assert updates.per_row > 1
    assert updates.fitted < 0.5 * updates.held


@pytest.mark.parametrize(("part", "change"), [(0.5, True), (1.5, False)])
def test_what_a_delay_explains_is_no_sign_of_changes_between_the_rows(part: float, change: bool) -> None:
    """Where an effect is missing, smoother voltages reduce the error a little; those with a delay, a lot."""
    data = delayed_log(changes=6)
    held = refitted(data)
    held_late, as_late = (_with_delay(held, runs, start=1e-3) for runs in (data, data.with_updates(2)))
    gain = held_late.chi2 - as_late.chi2
    assert held.chi2 - held_late.chi2 > 10.0 * gain > 0.0
    criteria = SelectionCriteria(min_gain_fraction=2.0 * part * gain / held_late.error.excess)
    assert (_changing_beside_delay(held, data, criteria) is not None) == change


@pytest.mark.parametrize(
    ("late", "all_drives"),
    [
        ({"drives": 1e-3}, True),
        ({"motor2": 1e-3}, False),
        ({"motor1": 1e-3, "motor2": 2e-3}, True),
        ({}, False),
    ],
)
def test_only_a_delay_of_all_drives_makes_up_for_another_number_of_changes(
    late: dict[str, float], all_drives: bool
) -> None:
    """Beside that of one drive of several, instruments tell how late the voltages of all drives act."""
    delays = (EFFECTS["input_delay"].at(site, d=delay) for site, delay in late.items())
    assert _delays_all_drives(BUILTIN_MACHINES["hframe"]().with_effects(*delays)) == all_drives


@pytest.mark.parametrize("share", [0.05, 0.1])
def test_held_voltages_that_act_a_little_earlier_are_held(share: float) -> None:
    """Euler steps act early by half a step; smoother voltages with a delay seem to explain that."""
    runs = (moved(seed, window=30) for seed in range(3))
    later = (
        dataclasses.replace(run, outputs=CubicSpline(run.time_s, run.outputs)(run.time_s + share * PERIOD))
        for run in runs
    )
    assert found(prepare(list(later), AXIS)).per_row == 1


def test_fewer_changes_do_not_take_the_place_of_a_delay_that_is_missing() -> None:
    """With four changes a row, instruments find the delay of fewer, but these explain less than a delay."""
    data = delayed_log().with_updates(4)
    fitted = refitted(data)
    excess = excess_delay(fitted, data)
    assert excess is not None
    assert excess.periods == pytest.approx(0.5, abs=0.05)
    assert other_updates(fitted, with_voltage_errors(fitted.machine, data), SelectionCriteria()) is None


@pytest.mark.parametrize(("present", "expected"), [(2, 4), (4, 4), (8, 8), (16, 8)])
def test_beside_a_known_delay_the_number_counts_that_no_other_one_clearly_improves(
    present: int, expected: int
) -> None:
    """Errors prefer too many changes: what eight explain more than four is less than an effect must."""
    fits = {number: fit_with(chi2=chi2) for number, chi2 in {2: 1.326, 4: 1.252, 8: 1.248, 16: 1.300}.items()}

    def again(fitted: Fit, number: int, goal: float) -> Fit:
        return fits[number]

    found = number_with_clear_gains(fits[present], present, 16, again, SelectionCriteria())
    assert found == (expected, fits[expected])


def test_beside_a_known_delay_instruments_tell_nothing() -> None:
    """They find another delay, but the known one makes up for that of any number of changes."""
    late = AXIS.with_effects(EFFECTS["input_delay"].at("drives", d=2.0 * PERIOD))
    data = delayed_log().with_updates(2)
    fitted = fit(late, default_free_parameters(late), data, SEARCH_BANDWIDTH)
    data = with_voltage_errors(fitted.machine, data)
    excess = excess_delay(fitted, data)
    assert excess is not None
    assert voltages_change_at_another_rate(excess.periods, math.hypot(excess.deviation, DELAY_STD))
    assert other_updates(fitted, data, SelectionCriteria()) is None


def test_interpolated_voltages_give_the_true_mass() -> None:
    """Held voltages act 1.5 ms late."""
    data = slow_log(4)
    mass = RIG.coordinates[0].mass
    held, updated = (refitted(d).machine.coordinates[0].mass for d in (data, data.with_updates(4)))
    assert abs(updated / mass - 1.0) < 0.005
    assert abs(held / mass - 1.0) > 5.0 * abs(updated / mass - 1.0)


def test_a_missing_force_is_no_sign_of_changes_between_rows() -> None:
    """A constant force leaves a large error, however the voltages change."""
    data = slow_log(1)
    pushed = dataclasses.replace(
        data,
        runs=tuple(
            dataclasses.replace(run, inputs=run.inputs + 0.3 * (run.time_s > 0.1)[:, None])
            for run in data.runs
        ),
    )
    assert refitted(pushed).chi2 > 2.0
    assert found(pushed).per_row == 1


def test_steps_that_act_before_their_row_are_no_sign_of_changes_between_rows() -> None:
    """Steps that act 3 ms before the row that has them look like interpolated ones, but rest in between."""
    logs = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        volts = np.repeat(rng.uniform(-4.0, 4.0, (15, 1)), 100, axis=0)
        volts[:100] = 0.0
        run = simulate(RIG, PERIOD * np.arange(-1, len(volts) - 1), volts)
        measured = run.outputs + rng.normal(0.0, NOISE, run.outputs.shape)
        logs.append(every(Recording(f"run_{seed}", run.time_s[1:], volts[1:], measured[1:]), 4))
    assert found(prepare(logs, AXIS)).per_row == 1


def test_a_prediction_with_changes_between_rows_is_that_of_a_log_at_the_rate_of_the_controller() -> None:
    """Held for 1 ms, interpolated voltages act in each row like the same voltages in a fast log."""
    slow = slow_log(4).with_updates(4)
    run = slow.runs[0]
    outputs = np.full((4 * len(run.time_s) - 3, run.outputs.shape[1]), np.nan)
    outputs[::4] = run.outputs
    fast = dataclasses.replace(
        run,
        updates=1,
        time_s=update_times(run.time_s, 4),
        inputs=updated_inputs(run.time_s, run.inputs, 4),
        outputs=outputs,
    )
    for bandwidth in (SIMULATION, SEARCH_BANDWIDTH):
        both = [predict(RIG, r, bandwidth, period=4e-3, states=True) for r in (run, fast)]
        for slowly, quickly in zip(*both, strict=True):
            assert np.array_equal(slowly, quickly[:, ::4])


def test_a_simulation_of_a_slow_log_interpolates_the_voltages() -> None:
    log = every(controlled(0), 4)
    errors = [
        np.sqrt(np.mean(simulate_recording(RIG, log, updates=updates).error ** 2)) for updates in (1, 4)
    ]
    assert errors[1] < 0.5 * errors[0]  # the controller also reacts to noise between the rows


def test_check_names_voltages_that_change_between_rows() -> None:
    (finding,) = check_voltages_between_rows(slow_log(4), AXIS)
    assert finding.severity == "advice"
    assert "change between the rows" in finding.message
    assert "log at the rate of the controller, or log the mean voltages" in finding.message
    assert "mass 0" not in finding.message
    assert check_voltages_between_rows(slow_log(1), AXIS) == []


def test_voltages_that_a_planner_computes_need_no_faster_log() -> None:
    """They are smooth; those of a controller answer noise."""
    time_s = np.arange(ROWS) * PERIOD
    logs = []
    for seed in range(3):
        volts = (
            4.0
            * np.sin(2.0 * np.pi * (1.0 + 0.3 * seed) * time_s)[:, None]
            * np.minimum(time_s, 1.0)[:, None]
        )
        run = simulate(RIG, time_s, volts)
        noise = np.random.default_rng(seed).normal(0.0, NOISE, run.outputs.shape)
        logs.append(every(Recording(f"run_{seed}", time_s, volts, run.outputs + noise), 4))
    smooth, answering = (
        describe_interpolation(RIG, with_voltage_errors(RIG, data.with_updates(4)))
        for data in (prepare(logs, AXIS), slow_log(4))
    )
    assert "so smooth" in smooth
    assert "log at the rate of the controller" in answering


def test_interpolated_inputs_keep_the_rows_and_do_not_overshoot_a_jump() -> None:
    time_s = np.array([0.0, 1.0, 2.0, 3.5, 4.5, 5.5])
    inputs = np.array([0.0, 0.0, 0.0, 3.0, 3.0, 3.0])[:, None]
    between = updated_inputs(time_s, inputs, 3)
    assert between[::3] == pytest.approx(inputs)
    assert np.all((between >= -1e-12) & (between <= 3.0 + 1e-12))
    assert update_times(time_s, 3)[6:10] == pytest.approx([2.0, 2.5, 3.0, 3.5])


@pytest.mark.parametrize(
    ("updates", "parts", "means"),
    [(4, 4, [0.0, 4.0, 8.0, 12.0]), (4, 2, [2.0, 10.0]), (4, 1, [6.0]), (2, 3, [0.0, 4.0, 8.0])],
)
def test_voltages_act_by_their_means_over_the_parts_of_a_row(
    updates: int, parts: int, means: list[float]
) -> None:
    changing = {4: [0.0, 4.0, 8.0, 12.0], 2: [0.0, 8.0]}[updates]
    inputs = np.array([*changing, *np.add(changing, 100.0), 5.0])[:, None]
    expected = [*means, *np.add(means, 100.0), 5.0]
    assert mean_inputs(inputs, updates, parts)[:, 0] == pytest.approx(expected)
    both = mean_inputs(np.array([inputs, -inputs]), updates, parts)
    assert both[1, :, 0] == pytest.approx(np.negative(expected))


def test_long_steps_predict_what_short_ones_do_where_voltages_change_inside_them() -> None:
    run = slow_log(4).with_updates(16).runs[0]
    assert [run.held(step).per_row for step in (10e-3, 1e-3, 0.125e-3)] == [1, 4, 16]
    coarse, fine = (
        predict(RIG, run, SIMULATION, period=4e-3, longest_step=step).readings for step in (1e-3, 0.25e-3)
    )
    held = predict(RIG, dataclasses.replace(run, updates=1), SIMULATION, period=4e-3).readings
    assert np.abs(coarse - fine).max() < 0.02 * np.abs(held - fine).max()


def test_rows_that_a_clock_moves_or_a_logger_loses_take_no_more_steps() -> None:
    run = slow_log(4).with_updates(16).runs[0]
    late = np.where(np.arange(len(run.time_s)) > 100, 0.02, 0.0)  # s
    assert dataclasses.replace(run, time_s=run.time_s + late).held(1e-3).per_row == 4
    jitter = np.random.default_rng(0).uniform(-1e-5, 1e-5, len(run.time_s))
    jittering = dataclasses.replace(run, time_s=run.time_s + jitter).held(1e-3)
    assert jittering.per_row == 5
    assert np.mean(np.diff(jittering.time_s) <= 1e-3) > 0.94


@pytest.mark.parametrize(("true_number", "other"), [(14, False), (4, True)])
def test_a_delay_within_the_accuracy_of_the_times_is_no_other_number(true_number: int, other: bool) -> None:
    """Instead of 16 changes, 14 act later by 0.004 sampling periods, 4 by 0.09."""
    delay = 0.5 / true_number - 0.5 / 16
    assert voltages_change_at_another_rate(delay, math.hypot(0.0005, DELAY_STD)) == other


@pytest.mark.parametrize(
    ("true_number", "assumed", "expected"),
    [(4, 16, (3, 4, 5)), (4, 4, (None, 3, 5)), (12, 20, (None,))],
    ids=["clearly too many", "right", "too many by less than the times are accurate"],
)
def test_the_search_counts_the_changes_again(
    true_number: int, assumed: int, expected: tuple[int | None, ...]
) -> None:
    """The largest number is where the first count ends, and need not be close to the true one."""
    data = slow_log(true_number).with_updates(assumed)
    fitted = refitted(data)
    updates = other_updates(fitted, with_voltage_errors(fitted.machine, data), SelectionCriteria())
    assert (updates and updates.per_row) in expected


def test_a_number_that_leaves_no_less_error_is_no_other_one() -> None:
    """A drive that acts late makes changes seem fewer, but cogging is missing, and fewer leave more."""
    rig = RIG.with_effects(EFFECTS["cogging"].at("motor", A=0.5, n=40.0, p=0.0))
    logs = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        noise = rng.normal(0.0, NOISE, (ROWS, 1))
        run = controlled_run("run", rig, random_places(rng, ROWS), noise, window=30, gains=(300.0, 5.0))
        early = dataclasses.replace(run, name=f"run_{seed}", inputs=np.roll(run.inputs, -1, axis=0))
        logs.append(every(early, 4))
    data = prepare(logs, AXIS).with_updates(4)
    fitted = refitted(data)
    data = with_voltage_errors(fitted.machine, data)
    assert count_updates(fitted, data) == 2
    assert other_updates(fitted, data, SelectionCriteria()) is None


@pytest.mark.parametrize(
    ("excess", "expected"),
    [
        # Small at the largest number, where errors of the voltages pass for delays; the sign changes between
        # 4 and 5.
        ({3: -0.04, 4: -0.01, 5: 0.012, 6: 0.03, 10: 0.04, 16: 0.018}, 4),
        ({4: 0.03, 10: 0.04, 16: 0.018, 2: 0.05}, 16),  # no number explains it
        ({10: 0.02, 16: 0.001}, 16),  # by no more than chance
    ],
)
def test_the_sign_of_the_delay_leads_away_from_the_largest_number(
    excess: dict[int, float], expected: int
) -> None:
    def measured(number: int, start: ExcessDelay | None = None) -> ExcessDelay:
        nearest = min(excess, key=lambda known: abs(known - number))
        return ExcessDelay(excess[nearest], 0.003, np.zeros(0))

    assert number_with_least_excess(16, 16, measured(16), measured) == expected


class _BegunError(Exception):
    """A search begins."""


def test_a_run_with_another_gain_does_not_hide_changes_between_the_rows() -> None:
    bad = dataclasses.replace(every(controlled(3), 4), inputs=0.5 * every(controlled(3), 4).inputs)
    runs = [*(every(controlled(seed), 4) for seed in range(3)), bad]
    found: list[Dataset] = []

    def begin(plain: object, fitted: Dataset, held_out: Dataset) -> None:
        found.append(fitted)
        raise _BegunError

    with pytest.raises(_BegunError):
        find_effects(
            AXIS,
            prepare(runs, AXIS),
            [],
            may_exchange=False,
            criteria=SelectionCriteria(),
            log=lambda line: None,
            budget=Budget(),
            before_search=begin,
        )
    assert found[0].updates > 1
    assert [run.name for run in found[0].runs] == ["run_0", "run_1", "run_2", "run_3"]


@pytest.mark.parametrize("fitted_with_errors", [False, True])
def test_a_machine_that_was_fitted_with_errors_of_the_voltages_shows_them(fitted_with_errors: bool) -> None:
    """A carriage of half the mass responds to the voltages twice as much."""
    light, data = AXIS.replace({"x.mass": 0.5 * RIG.coordinates[0].mass}), slow_log(4)
    updates = VoltageUpdates(4, held=2.0, fitted=1.0)
    voltages = _Voltages(updates, light, fitted_with_errors, selected=(), rejected={})
    runs = _Runs(data, data, None, refitted(data), voltages={}, left_out=None, messages=())
    interpolated = _interpolated(voltages, runs, [run.name for run in data.runs], print)
    expected = light if fitted_with_errors else refitted(data.with_updates(4)).machine
    errors = with_voltage_errors(expected, data.with_updates(4)).runs[0].voltage_errors
    assert errors is not None
    for run in (interpolated.fitted.runs[0], interpolated.held_out.runs[0]):
        assert run.voltage_errors is not None
        np.testing.assert_allclose(
            run.voltage_errors.log_variance(SEARCH_BANDWIDTH),
            errors.log_variance(SEARCH_BANDWIDTH),
            atol=0.01,
        )


@pytest.mark.parametrize(("rows", "expected"), [(1, 1), (2, None)])
def test_voltages_that_act_as_late_as_held_ones_are_held(rows: int, expected: int | None) -> None:
    """Without an effect, voltages seemed to change twice a row; with it, the runs are judged again."""
    data = slow_log(rows).with_updates(2)
    fitted = refitted(data)
    updates = other_updates(fitted, with_voltage_errors(fitted.machine, data), SelectionCriteria())
    assert (updates and updates.per_row) == expected


def test_a_sensor_that_measures_nothing_in_a_run_leaves_the_delay_to_other_runs() -> None:
    """A laser that is beyond its range for a whole run has no measurements to smooth."""
    data = slow_log(4).with_updates(2)
    fitted, (first, *others) = refitted(data), data.runs
    silent = dataclasses.replace(
        first, outputs=np.full_like(first.outputs, np.nan), weights=np.zeros_like(first.weights)
    )
    with_silent, without = (
        excess_delay(fitted, dataclasses.replace(data, runs=tuple(runs)))
        for runs in ((silent, *others), others)
    )
    assert with_silent is not None
    assert without is not None
    assert with_silent.periods == pytest.approx(without.periods, abs=0.2 * without.deviation)


@pytest.mark.parametrize(("rows", "expected"), [(1, 1), (4, None)])
def test_smooth_set_points_are_held_if_the_effects_found_since_leave_no_other_sign(
    rows: int, expected: int | None
) -> None:
    noise, servo = 3e-5, BUILTIN_MACHINES["servo"]()  # noise in rad
    servo = servo.with_components(servo.sensors[0].with_values({"noise": noise, "resolution": 0.0}))
    moving = servo.with_effects(EFFECTS["unbalance"].at(servo.coordinate_names[0], A=0.02, p=0.3))
    period = 4e-3 / rows
    time_s, logs = np.arange(3.0 / period) * period, []
    for seed in range(3):
        command = 0.5 * np.sin(2.0 * np.pi * (2.0 + 0.3 * seed) * time_s) * np.minimum(time_s, 1.0)
        run = simulate(moving, time_s, command[:, None])
        outputs = run.outputs + np.random.default_rng(seed).normal(0.0, noise, run.outputs.shape)
        logs.append(every(Recording(f"run_{seed}", time_s, command[:, None], outputs), rows))
    data = prepare(logs, servo).with_updates(4)
    fitted = fit(moving, default_free_parameters(moving), data, SEARCH_BANDWIDTH)
    updates = _held_after_all(fitted, with_voltage_errors(fitted.machine, data), SelectionCriteria())
    assert (updates and updates.per_row) == expected
