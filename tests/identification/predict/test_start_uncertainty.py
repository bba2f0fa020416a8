"""Tests of the initial state: projection of what it leaves open, and the most probable start of a run."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, SelectionCriteria, prepare, simulate_recording
from hframe_gym.identification.fit.estimation import fit, prediction_cost
from hframe_gym.identification.fit.start_estimation import (
    most_probable_start,
    refine_dataset,
    with_probable_starts,
    with_zeros_of_motion,
)
from hframe_gym.identification.predict.free_parameters import default_free_parameters
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, SIMULATION, predict, residuals
from hframe_gym.identification.predict.start_uncertainty import (
    InitialStateProjection,
    predict_with_displaced_starts,
    projected,
    start_displacements,
    uncertain_starts,
)
from hframe_gym.machine import Machine, rest_state
from hframe_gym.recordings import Recording


def moving_run(machine: Machine, state: np.ndarray) -> Recording:
    """Return a noise-free run of 0.6 s in which each drive in turn gets 5 V after 50 ms of rest."""
    time_s = np.arange(600) * 1e-3
    inputs = np.zeros((600, len(machine.drives)))
    for j in range(len(machine.drives)):
        inputs[50 + 200 * j : 250 + 200 * j, j] = 5.0
    motion = simulate(machine, time_s, inputs, state, longest_step=0.125e-3)
    return Recording("run", time_s, inputs, motion.outputs)


def simulation_projection(machine: Machine, data: Dataset) -> InitialStateProjection | None:
    """Return what removes an uncertain start's influence from residuals of the first run's simulation."""
    run = data.runs[0]
    start = uncertain_starts(machine, data.runs)[run.name]
    motion = predict_with_displaced_starts(machine, run, SIMULATION, start, period=data.period)
    return projected(residuals(run, data, motion.readings), start.differences)[1]


def test_initial_stretch_is_projected_out_of_a_simulation(hframe: Machine) -> None:
    """The projection shrinks the directions of the two initial motor angles by their weights."""
    data = prepare([moving_run(hframe, rest_state(hframe))], hframe)
    projection = simulation_projection(hframe, data)
    assert projection is not None
    np.testing.assert_allclose(projection.directions.T @ projection.directions, np.eye(2), atol=1e-9)
    assert np.all((projection.weights > 0) & (projection.weights < 1))
    direction = projection.directions[:, :1].T
    np.testing.assert_allclose(projection(direction), direction * (1 - projection.weights[0]), atol=1e-9)
    several = np.vstack([direction, np.random.default_rng(0).normal(size=(3, direction.size))])
    np.testing.assert_allclose(projection.costs(several), np.sum(projection(several) ** 2, axis=1), rtol=1e-9)


def test_projection_of_a_machine_close_to_divergence_does_not_overflow(hframe: Machine) -> None:
    """Fits try unstable parameters, with which a start's error grows by over 150 orders of magnitude."""
    data = prepare([moving_run(hframe, rest_state(hframe))], hframe)
    unstable = hframe.replace({"x.viscous": -650.0 * hframe.coordinate("x").mass})
    with np.errstate(over="raise"):
        projection = simulation_projection(unstable, data)
    assert projection is not None
    np.testing.assert_array_equal(projection.weights, 1.0)


def test_the_cost_of_a_prediction_close_to_divergence_is_infinite(hframe: Machine) -> None:
    """Its square is no number any more; the others of its batch keep theirs, and nothing warns."""
    data = prepare([moving_run(hframe, rest_state(hframe))], hframe)
    projection = simulation_projection(hframe, data)
    assert projection is not None
    rows = len(projection.directions)
    costs = projection.costs(np.vstack([np.full(rows, 1e200), np.ones(rows)]))
    assert costs[0] == np.inf
    assert costs[1] == pytest.approx(np.sum(projection(np.ones((1, rows))) ** 2))


def test_no_projection_without_belts(axis: Machine) -> None:
    data = prepare([moving_run(axis, rest_state(axis))], axis)
    assert simulation_projection(axis, data) is None


def test_the_influence_of_a_rest_of_unknown_length_is_removed(axis: Machine) -> None:
    """Friction after a rest is known to six e-folds only; over all, it moves the axis nonlinearly."""
    machine = axis.with_effects(EFFECTS["dwell_friction"].at("x", dF=0.5, tau=0.02, D=1e-4))
    state = np.append(rest_state(axis), np.log(1.0 + 2.0 / 0.02))  # after a rest of 2 s
    time_s = np.arange(600) * 1e-3
    inputs = np.where(time_s < 0.05, 0.0, 2.0)[:, None]
    outputs = simulate(machine, time_s, inputs, state, longest_step=0.125e-3).outputs
    noise = np.random.default_rng(0).normal(0.0, 2e-5, outputs.shape)
    data = prepare([Recording("run", time_s, inputs, outputs + noise)], machine)
    states = data.runs[0].initial.with_start(machine, state).effect_states
    initial = dataclasses.replace(data.runs[0].initial, effect_states=states)
    run = dataclasses.replace(data.runs[0], initial=initial)
    start = uncertain_starts(machine, [run])[run.name]
    motion = predict_with_displaced_starts(machine, run, SIMULATION, start, period=data.period)
    projection = projected(residuals(run, data, motion.readings), start.differences)[1]
    assert projection is not None
    longer = start.state + 0.05 * start.displacements[-1]
    both = np.vstack([start.state, longer])
    motion = predict(machine, run, SIMULATION, period=data.period, initial_state=both)
    here, there = residuals(run, data, motion.readings)
    left = projection((there - here)[None])[0]
    assert np.sum(left**2) < 0.01 * np.sum((there - here) ** 2)


def test_a_run_that_began_with_stretched_belts_is_simulated_from_that_stretch(hframe: Machine) -> None:
    """Encoders that count from 0 at the start do not measure the stretch; the motion shows it."""
    started = rest_state(hframe)
    stretch = np.array([0.8e-3, -0.5e-3])  # rad, less than friction holds
    started[2:4] += stretch
    run = moving_run(hframe, started)
    run.outputs[:, :2] -= run.outputs[0, :2]
    simulated = simulate_recording(hframe, run)
    np.testing.assert_allclose(simulated.initial.state[2:4] - rest_state(hframe)[2:4], stretch, atol=3e-5)
    assert np.abs(simulated.error).max() < 2e-5


def test_a_start_behind_another_minimum_of_the_error_is_found(hframe: Machine) -> None:
    """The error of 600 rows has a minimum of 3 beside the measured start, and 0.4 two deviations away."""
    run = prepare([moving_run(hframe, rest_state(hframe))], hframe).runs[0]
    (displacements,) = start_displacements(hframe, [run.initial])
    state = run.initial_state(hframe)

    def errors(states: np.ndarray, rows: int) -> np.ndarray:
        # (displacements, batch)
        amounts = np.linalg.lstsq(displacements.T, (states - state).T, rcond=None)[0]
        distance = np.hypot(*(amounts - [[2.0], [0.0]]))
        return np.repeat(
            3.0 * np.minimum(distance, 1.0)[:, None] + 0.1 * amounts[0][:, None] ** 2, rows, axis=1
        )

    start = most_probable_start(hframe, run.initial, state, errors, run.time_s)
    expected = state + np.array([2.0, 0.0]) @ displacements
    np.testing.assert_allclose(start, expected, atol=0.1 * np.abs(displacements).max())


def test_the_start_of_a_long_run_follows_from_all_of_it(hframe: Machine) -> None:
    """The first 10 s have their minimum at the measured start, the 10 s after them one deviation away."""
    run = prepare([moving_run(hframe, rest_state(hframe))], hframe).runs[0]
    (displacements,) = start_displacements(hframe, [run.initial])
    state, time_s = run.initial_state(hframe), np.arange(20_000) * 1e-3
    simulated: list[int] = []

    def errors(states: np.ndarray, rows: int) -> np.ndarray:
        simulated.append(rows)
        amounts = np.linalg.lstsq(displacements.T, (states - state).T, rcond=None)[0]
        later = np.arange(rows) >= 0.55 * len(time_s)
        return amounts[0][:, None] - np.where(later, 1.0, 0.0)

    start = most_probable_start(hframe, run.initial, state, errors, time_s)
    amount = np.linalg.lstsq(displacements.T, start - state, rcond=None)[0][0]
    assert amount == pytest.approx(0.45, abs=1e-3)  # of all rows, with a prior of one row
    assert simulated.count(len(time_s)) < len(simulated)


def test_starts_that_explain_the_error_are_adopted(hframe: Machine) -> None:
    """Three runs that began with different stretches; their encoders were switched on anew."""
    recordings = []
    for name, size in (("a", 2e-3), ("b", -1.5e-3), ("c", 1e-3)):
        started = rest_state(hframe)
        started[2:4] += [size, -0.7 * size]
        run = moving_run(hframe, started)
        recordings.append(
            dataclasses.replace(run, name=name, outputs=run.outputs - [*run.outputs[0, :2], 0.0, 0.0])
        )
    data = prepare(recordings, hframe)
    fitted = fit(hframe, default_free_parameters(hframe)[:2], data, SIMULATION)
    better, refined = with_probable_starts(fitted, data, SelectionCriteria())
    assert refined is not data
    assert better.cost < 0.5 * fitted.cost
    kept, same = with_probable_starts(
        dataclasses.replace(better, cost=better.count), refined, SelectionCriteria()
    )
    assert same is refined
    assert kept.cost == better.count


@pytest.mark.parametrize("name", ["dahl_hysteresis", "bouc_wen_hysteresis"])
def test_a_hysteresis_remembers_motion_before_the_recording(axis: Machine, name: str) -> None:
    machine = axis.with_effects(EFFECTS[name].at("x", F=1.5, L=0.01))
    run = moving_run(machine, np.array([*rest_state(machine), -0.8]))
    simulated = simulate_recording(machine, run)
    assert simulated.initial.effect_states == {(f"{name}@x", "x"): pytest.approx(-0.8, abs=0.05)}
    assert np.abs(simulated.error).max() < 2e-6
    data = prepare([run], machine)
    refined = refine_dataset(data, machine)
    assert refined.runs[0].initial_state(machine)[2] == pytest.approx(-0.8, abs=0.05)
    assert prediction_cost(machine, refined, SIMULATION) < 0.1 * prediction_cost(machine, data, SIMULATION)


def test_a_winding_is_warm_from_motion_before_the_recording(axis: Machine) -> None:
    machine = axis.with_effects(EFFECTS["winding_heat"].at("motor", a=0.02, tau=1.0))
    run = moving_run(machine, np.array([*rest_state(machine), 6.0]))
    simulated = simulate_recording(machine, run)
    assert simulated.initial.effect_states == {("winding_heat@motor", "motor"): pytest.approx(6.0, abs=0.3)}
    assert np.abs(simulated.error).max() < 1e-5


def test_a_contact_aged_before_the_recording(axis: Machine) -> None:
    machine = axis.with_effects(EFFECTS["dwell_friction"].at("x", dF=0.3, tau=0.02, D=1e-3))
    aged = np.log1p(8.0 / 0.02)  # 8 s of rest
    run = moving_run(machine, np.array([*rest_state(machine), aged]))
    simulated = simulate_recording(machine, run)
    assert simulated.initial.effect_states == {("dwell_friction@x", "x"): pytest.approx(aged, abs=0.05)}
    assert np.abs(simulated.error).max() < 1e-5


def test_nothing_to_refine_without_hysteresis(axis: Machine) -> None:
    data = prepare([moving_run(axis, rest_state(axis))], axis)
    assert refine_dataset(data, axis) is data


def test_the_motion_shows_the_zeros_that_a_torque_at_rest_falsifies(hframe: Machine) -> None:
    """An amplifier's offset stretches the belts before each run; the rows at rest take this for the zeros."""
    machine = hframe.with_effects(EFFECTS["voltage_offset"].at("motor1", V0=0.27))
    rng, time_s = np.random.default_rng(1), np.arange(1500) * 1e-3
    inputs = np.zeros((1500, 2))
    inputs[100:700], inputs[700:1300] = (3.0, -2.0), (-2.0, 3.0)
    runs = []
    for k in range(4):
        settled = rest_state(machine, rng.uniform(-0.05, 0.05, 2))
        settled[2:4] += rng.normal(0.0, 1e-3, 2)
        before = simulate(machine, time_s, np.zeros((1500, 2)), settled, longest_step=0.125e-3)
        settled[:4] = before.positions[-1]
        ideal = simulate(machine, time_s, inputs, settled, longest_step=0.125e-3).outputs
        encoders = np.round(ideal[:, :2] / 0.1e-3) * 0.1e-3
        lasers = ideal[:, 2:] + rng.normal(0.0, 20e-6, (1500, 2))
        runs.append(Recording(f"run_{k}", time_s, inputs, np.hstack([encoders, lasers])))
    data = prepare(runs, hframe)
    assert np.all(np.abs(data.zeros.values[:2]) > 0.4e-3)  # rad; they are 0
    fitted = fit(machine, default_free_parameters(machine, effects=False)[:1], data, SEARCH_BANDWIDTH)
    found = with_zeros_of_motion(fitted, data)
    assert np.all(np.abs(found.zeros.values[:2]) < 0.2e-3)
    assert prediction_cost(machine, found, SEARCH_BANDWIDTH) < prediction_cost(
        machine, data, SEARCH_BANDWIDTH
    )
    for run, before in zip(found.runs, data.runs, strict=True):
        moved = found.zeros.values[:2] - data.zeros.values[:2]
        np.testing.assert_allclose(
            before.outputs[:, :2] - run.outputs[:, :2], moved[None] + np.zeros((1500, 1))
        )
    # The same zeros hold in other runs of the session, whatever the machine predicts at rest.
    others = refine_dataset(data.with_runs(["run_0"]), machine, found)
    np.testing.assert_array_equal(others.zeros.values, found.zeros.values)
    assert refine_dataset(found, machine) is found
    # Without effects, or in a simulation, there is no reason to doubt the zeros.
    assert with_zeros_of_motion(dataclasses.replace(fitted, machine=hframe), data) is data
    assert with_zeros_of_motion(dataclasses.replace(fitted, bandwidth=SIMULATION), data) is data
