"""Tests of the trial fits of candidates: strong effects, and starts from the declared parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import default_free_parameters, fit, identify, prepare
from hframe_gym.identification.fit.estimation import Fit
from hframe_gym.identification.judge.criteria import SelectionCriteria
from hframe_gym.identification.predict.free_parameters import values_at
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.propose import trial_fits
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording


def recordings(machine: Machine, count: int) -> list[Recording]:
    """Return noisy runs of 1.5 s under random steps of up to 6 V."""
    rng, time_s, runs = np.random.default_rng(0), np.arange(1500) * 1e-3, []
    for i in range(count):
        inputs = np.repeat(rng.uniform(-6.0, 6.0, (15, len(machine.drives))), 100, axis=0)
        inputs[:100] = 0.0
        outputs = simulate(machine, time_s, inputs).outputs
        runs.append(Recording(f"run_{i}", time_s, inputs, outputs + rng.normal(0.0, 2e-5, outputs.shape)))
    return runs


def test_a_spring_stronger_than_the_drive_is_found(axis: Machine) -> None:
    """It stops the carriage after millimeters; the refit without it ends at the limit of the mass."""
    rig = axis.with_effects(EFFECTS["cable_spring"].at("x", k=3000.0, q0=0.0))
    result = identify(recordings(rig, 4), axis)
    assert [s.effect.label for s in result.effects] == ["cable_spring@x"]
    assert result.effects[0].effect.parameters["k"] == pytest.approx(3000.0, rel=0.01)


def test_a_force_that_exceeds_friction_is_found(axis: Machine) -> None:
    """The voltage holds a tilted axis; without the force, a fit makes friction and masses stand in for it."""
    force = -3.0 * axis.parameters["x.coulomb"]
    rig = axis.with_effects(EFFECTS["constant_force"].at("x", size=force))
    drive = axis.drives[0]
    hold = -force * axis.travel_per_unit[0] * drive.resistance / (drive.Kt * drive.gear_ratio)
    runs = [
        dataclasses.replace(run, inputs=run.inputs + hold, outputs=outputs)
        for run in recordings(axis, 4)
        for outputs in [simulate(rig, run.time_s, run.inputs + hold).outputs]
    ]
    result = identify(runs, axis)
    assert [s.effect.label for s in result.effects] in (["constant_force@x"], ["voltage_offset@motor"])


def test_the_better_one_of_two_shapes_is_kept(axis: Machine) -> None:
    """Linearization may rank a wrong period first, from which a fit does not find the right one."""
    data = prepare(recordings(axis, 1), axis)
    fits = [
        dataclasses.replace(
            fit(axis.with_effects(effect), (), data, SEARCH_BANDWIDTH, iterations=1), cost=cost
        )
        for effect, cost in (
            (EFFECTS["position_friction"].at("x", A=0.2, L=0.04, p=0.0), 3.0),
            (EFFECTS["constant_force"].at("x", size=0.1), 9.0),
            (EFFECTS["position_friction"].at("x", A=0.2, L=0.1, p=0.0), 2.0),
            (EFFECTS["position_friction"].at("x", A=0.2, L=0.3, p=0.0), 5.0),
        )
    ]
    trials: list[Fit] = []
    for trial in fits:
        trials = trial_fits._with_better_shape(trials, trial)
    assert sorted(t.cost for t in trials) == [2.0, 9.0]


def test_two_shapes_of_an_effect_are_fitted(axis: Machine) -> None:
    """A periodic friction whose period the search does not know: two of its starting values are tried."""
    rig = axis.with_effects(EFFECTS["position_friction"].at("x", A=0.5, L=0.03, p=0.0))
    data = prepare(recordings(rig, 2), axis)
    current = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    ranked = trial_fits.screened_fit(current, data).screening.ranked()
    promising = trial_fits._promising(current, ranked, data, 1e-6, SelectionCriteria(min_promise=0.0))
    labels = [scored.candidate.label for scored in promising]
    assert max(labels.count(label) for label in labels) == 2
    assert [s.gain for s in promising] == sorted((s.gain for s in promising), reverse=True)


def test_the_larger_of_two_periodic_torques_takes_the_place_of_the_one_that_it_requires(
    axis: Machine,
) -> None:
    """A search may find the smaller torque first; the larger, its companion, must not depend on it."""
    larger = EFFECTS["cogging"].at("motor", A=0.4, n=200.0, p=0.3)
    small = EFFECTS["cogging"].at("motor", A=1e-4, n=520.0, p=0.0)
    companion = EFFECTS["second_cogging"].at("motor", **larger.parameters)
    data = prepare(recordings(axis.with_effects(larger), 2), axis)
    both = fit(
        axis.with_effects(small, companion),
        default_free_parameters(axis.with_effects(small, companion)),
        data,
        SEARCH_BANDWIDTH,
    )
    reduced = trial_fits.without_effect(both, companion.label, data, axis)
    assert reduced is not None
    (only,) = reduced.machine.effects
    assert only.label == larger.label
    assert only.parameters == pytest.approx(larger.parameters, rel=0.02)
    assert reduced.chi2 == pytest.approx(both.chi2, rel=0.02)
    assert trial_fits.without_effect(both, small.label, data, axis) is None


def test_a_belt_that_a_known_effect_divides_has_its_declared_length(hframe: Machine) -> None:
    """Its length is not free any more, and a fit without the effect has changed it."""
    free = default_free_parameters(hframe)
    theta = np.full(len(free), 0.1)
    machine = hframe.replace(values_at(free, theta))
    refitted = Fit(machine, free, theta, 1.0, 1, SEARCH_BANDWIDTH, np.eye(len(free)))
    idlers = EFFECTS["idler_inertia"].at("machine", J_left=5e-5, J_right=5e-5, B_left=1e-3, B_right=1e-3)
    push = EFFECTS["constant_force"].at("x", size=0.3)
    for effects, expected in (([push], machine), ([push, idlers], hframe)):
        start = trial_fits.start_with_effects(refitted, effects)
        assert [e.label for e in start.effects] == [e.label for e in effects]
        assert (
            start.parameters["left.rest_length"]
            == expected.with_effects(*effects).parameters["left.rest_length"]
        )


def test_each_effect_that_explains_the_runs_is_fitted_at_its_other_sites() -> None:
    """A delay of drive 2 stands for its lag; a delay of drive 1 explains most of the rest, both lags all.

    The lags promise half of what the delay does, because the delay of drive 2 has its optimum without them.
    """
    delay, lag = EFFECTS["input_delay"], EFFECTS["electrical_lag"]
    hframe = BUILTIN_MACHINES["hframe"]()
    rig = hframe.with_effects(delay.at("motor2", d=1.46e-3), lag.at("drives", tau=1.1e-3))
    data = prepare(recordings(rig, 2), hframe)
    found = hframe.with_effects(delay.at("motor2", d=2.3e-3))
    current = fit(found, default_free_parameters(found), data, SEARCH_BANDWIDTH)
    trials = trial_fits.trial_fits(current, data, 0.1 * current.chi2, SelectionCriteria())
    best = min(trials, key=lambda trial: trial.cost)
    assert best.machine.effects[-1].label == "electrical_lag@drives"
