"""Tests of what the sensors measure at rest: position, zeros, and the warning where nothing measures it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import InitialState, estimate_initial_state
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor, commanded_state
from hframe_gym.preparation.session_zeros import common_encoder_zeros
from hframe_gym.preparation.start.measured_state import settled_rows
from hframe_gym.preparation.start.rest import count_resting_rows
from hframe_gym.preparation.start.sensor_zeros import sensor_zero_error
from hframe_gym.recordings import Recording

RADIUS = 0.0194


def angles(x: float, y: float) -> np.ndarray:
    """Return the pulley angles for unstretched belts, rad."""
    return np.array([-(x + y), x - y]) / RADIUS


def recording(outputs: np.ndarray, change: int) -> Recording:
    """Return a run whose inputs change at a row."""
    inputs = np.zeros((len(outputs), 2))
    inputs[change:] = 3.0
    return Recording("run_1", np.arange(len(outputs)) * 1e-3, inputs, outputs)


def test_lasers_determine_the_position_and_encoders_get_a_zero(hframe: Machine) -> None:
    rng = np.random.default_rng(3)
    x, y = 0.11, -0.07
    outputs = np.tile([0.0, 0.0, x, y], (200, 1))
    outputs[:, 2:] += rng.normal(0, 20e-6, (200, 2))
    initial = estimate_initial_state(recording(outputs, 100), hframe)
    assert initial.resting_rows == 101
    assert initial.position_measured
    assert initial.warnings == ()
    np.testing.assert_allclose(initial.state[:2], [x, y], atol=1e-5)
    np.testing.assert_allclose(initial.state[2:4], angles(x, y), atol=1e-3)
    np.testing.assert_allclose(initial.zeros[:2], -angles(x, y), atol=1e-3)
    np.testing.assert_allclose(initial.zeros[2:], 0.0, atol=1e-9)


def test_encoders_alone_are_assumed_to_count_from_zero_with_a_warning(hframe: Machine) -> None:
    x, y = 0.05, 0.02
    outputs = np.tile([*angles(x, y), np.nan, np.nan], (20, 1))
    initial = estimate_initial_state(recording(outputs, 10), hframe)
    np.testing.assert_allclose(initial.state[:2], [x, y], atol=1e-9)
    np.testing.assert_allclose(initial.zeros, 0.0, atol=1e-9)
    assert not initial.position_measured
    assert "The initial position cannot be determined" in initial.warnings[0]


def test_a_laser_that_measures_nothing_at_rest_is_replaced_by_its_later_measurements(hframe: Machine) -> None:
    """The encoders were switched on at an unknown angle; without later rows the error would be decimeters."""
    start, zeros = np.array([0.14, -0.03]), np.array([2.0, -5.0])
    path = start + np.outer(np.linspace(0.0, 1.0, 300), [-0.2, 0.05])
    path[:50] = start
    turned = np.array([angles(x, y) for x, y in path])
    outputs = np.hstack([turned + zeros, path])
    outputs[path[:, 0] > 0.1, 2] = np.nan
    initial = estimate_initial_state(recording(outputs, 49), hframe)
    np.testing.assert_allclose(initial.state[:2], start, atol=1e-9)
    np.testing.assert_allclose(initial.zeros, [*zeros, 0.0, 0.0], atol=1e-6)
    assert not initial.position_measured
    assert "x_m measures nothing at rest" in initial.warnings[0]


def test_an_axis_with_an_encoder_only_needs_no_warning(hframe: Machine) -> None:
    """Its position counts from the encoder's zero by definition."""
    encoder = dataclasses.replace(hframe, sensors=hframe.sensors[:2])
    initial = estimate_initial_state(recording(np.zeros((20, 2)), 10), encoder)
    assert initial.warnings == ()


@pytest.mark.parametrize("name", ["servo", "printer"])
def test_without_a_sensor_of_the_position_the_machine_is_where_its_commands_hold_it(name: str) -> None:
    machine = BUILTIN_MACHINES[name]()
    axis = machine.tool_axes[0]
    machine = machine.replace(sensors=(Sensor("a", {axis: 1.0}, noise=0.1, kind="acceleration"),))
    inputs = np.full((200, len(machine.drives)), 0.3)
    initial = estimate_initial_state(
        Recording("run", np.arange(200) * 1e-3, inputs, np.zeros((200, 1))), machine
    )
    np.testing.assert_allclose(initial.state, commanded_state(machine, inputs[0]))
    assert initial.state[0] != 0.0


@pytest.mark.parametrize("first", [0, 4])
def test_a_slow_encoder_need_not_measure_in_the_last_rows_at_rest(first: int) -> None:
    """Repeated values that the log holds are empty; a sensor's only one may precede or follow the rest."""
    axis = BUILTIN_MACHINES["axis"]()
    axis = axis.replace(sensors=(dataclasses.replace(axis.sensors[0], kind="encoder"),))
    outputs = np.full((20, 1), np.nan)
    outputs[first::4] = 3.2
    run = Recording("run", np.arange(20) * 1e-3, (np.arange(20) > 1)[:, None] * 1.0, outputs)
    assert estimate_initial_state(run, axis).zeros == pytest.approx(0.0)
    assert estimate_initial_state(run, axis).position == pytest.approx(3.2)


def test_a_run_that_is_driven_from_its_first_row_rests_one_row(hframe: Machine) -> None:
    outputs = np.zeros((30, 4))
    assert count_resting_rows(recording(outputs, 0), hframe) == 1
    assert count_resting_rows(recording(outputs, 12), hframe) == 13
    assert count_resting_rows(recording(outputs, 30), hframe) == 30
    assert settled_rows(13) == slice(6, 13)


def initial_states(true_zeros: np.ndarray, measured: bool = True) -> list[InitialState]:
    """Return initial states with given zeros (runs, sensors)."""
    return [
        InitialState(np.zeros(8), z, 50, zero_spread=np.zeros(4), position_measured=measured)
        for z in true_zeros
    ]


def test_encoders_that_kept_their_zero_are_found_and_others_are_not(hframe: Machine) -> None:
    rng = np.random.default_rng(0)
    quanta = np.array([5.2e-4, 5.2e-4, 0.0, 0.0])
    true_zeros = np.zeros((6, 4))
    true_zeros[:, 0] = 1.5 + rng.uniform(-5e-4, 5e-4, 6)
    true_zeros[:, 1] = rng.uniform(-3.0, 3.0, 6)
    zeros = common_encoder_zeros(initial_states(true_zeros), hframe, quanta)
    assert zeros.values[0] == pytest.approx(1.5, abs=5e-4)
    assert np.isnan(zeros.values[1:]).all()
    assert np.isnan(common_encoder_zeros(initial_states(true_zeros[:2]), hframe, quanta).values).all()


def test_encoders_resolve_the_stretch_although_most_runs_start_without_one(hframe: Machine) -> None:
    """Five of eight runs start at the center; the position of the others must come from the lasers alone."""
    true_zeros = np.zeros((8, 4))
    true_zeros[:3, 1] = 0.03, -0.01, 0.02
    zeros = common_encoder_zeros(initial_states(true_zeros), hframe, np.array([5.2e-4, 5.2e-4, 0.0, 0.0]))
    np.testing.assert_array_equal(zeros.values[:2], [0.0, 0.0])
    np.testing.assert_array_equal(zeros.resolves_stretch[:2], [False, True])
    assert zeros.spread[1] == pytest.approx(np.sqrt((0.03**2 + 0.01**2 + 0.02**2) / 8))


def test_runs_without_a_measured_position_do_not_count_for_the_zeros(hframe: Machine) -> None:
    true_zeros = np.tile([1.5, -0.5, 0.0, 0.0], (4, 1))
    assumed = initial_states(np.zeros((5, 4)), measured=False)
    zeros = common_encoder_zeros(initial_states(true_zeros) + assumed, hframe, np.full(4, 5.2e-4))
    np.testing.assert_allclose(zeros.values[:2], [1.5, -0.5])


def test_the_zero_error_is_the_mean_at_rest_and_a_limited_part_of_the_mean() -> None:
    error = np.full((1, 100, 2), 3.0)
    error[:, 20:] += 0.5
    measured = np.ones((100, 2), np.bool_)
    zero = sensor_zero_error(error, measured, 20, np.array([np.inf, 0.1]), np.array([0.2, 0.2]))
    np.testing.assert_allclose(zero, [[[3.4, 3.1]]])


def test_a_frame_on_an_axis_without_belts_rests_at_zero() -> None:
    """The only laser measures the sum of both positions; the spring of the frame holds its part at zero."""
    frame = EFFECTS["frame_resonance"].at("x", f0=10.0, zeta=0.05, r=0.1, s=0.5)
    machine = BUILTIN_MACHINES["axis"]().with_effects(frame)
    time_s = np.arange(200) * 1e-3
    run = Recording("run_1", time_s, np.where(time_s > 0.1, 1.0, 0.0)[:, None], np.full((200, 1), 0.1))
    np.testing.assert_allclose(estimate_initial_state(run, machine).state, [0.1, 0.0, 0.0, 0.0], atol=1e-9)
