"""Tests of screening: it ranks the effect that is missing first and predicts what a fit would save."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, Fit, default_free_parameters, fit, prepare, screen
from hframe_gym.identification.fit.typical_scales import typical_scales
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, SIMULATION, predict
from hframe_gym.identification.propose.candidates import Candidate
from hframe_gym.identification.propose.screening import (
    Screening,
    Unperturbed,
    candidate_perturbations,
    perturbed_machines,
    screen_structures,
)
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording

NOISE = 20e-6


def recorded(machine: Machine) -> Recording:
    """Return a noisy recording of an axis that moves back and forth."""
    time_s = np.arange(2000) * 1e-3
    inputs = np.where(time_s > 0.1, 1.5 * np.sin(9 * time_s) + 0.7 * np.sin(31 * time_s), 0.0)[:, None]
    noise = np.random.default_rng(0).normal(0.0, NOISE, (2000, 1))
    return Recording("run", time_s, inputs, machine.simulate(time_s, inputs).outputs + noise)


def candidate(name: str, site: str, **column: float) -> Candidate:
    """Return a candidate with one column."""
    return Candidate(EFFECTS[name], site, (column,), {})


CANDIDATES = [
    candidate("constant_force", "x", size=0.1),
    candidate("asymmetric_viscous", "x", a=0.1),
    candidate("cable_spring", "x", k=10.0, q0=0.0),
]


def fit_without_effect(axis: Machine, effect_size: float) -> tuple[Fit, Dataset]:
    """Return a fit of the axis to a recording of the same axis with a constant force, N."""
    data = prepare([recorded(axis.with_effects(EFFECTS["constant_force"].at("x", size=effect_size)))], axis)
    return fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH), data


def test_missing_effect_ranks_first_with_its_size(axis: Machine) -> None:
    fitted, data = fit_without_effect(axis, 0.3)
    best = screen(fitted, CANDIDATES, data)[0]
    assert best.candidate.label == "constant_force@x"
    assert best.candidate.applied(best.amounts).parameters["size"] == pytest.approx(0.3, rel=0.1)
    machine = fitted.machine.with_effects(best.candidate.applied(best.amounts))
    with_effect = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    assert best.gain == pytest.approx(fitted.cost - with_effect.cost, rel=0.3)


def test_candidates_save_next_to_nothing_where_no_effect_is_missing(axis: Machine) -> None:
    fitted, data = fit_without_effect(axis, 0.0)
    assert max(s.gain for s in screen(fitted, CANDIDATES, data)) < 0.02 * data.count


def test_amount_stays_within_the_bounds_of_the_parameter(axis: Machine) -> None:
    """A sensor delay cannot be negative: a sensor that leads saves nothing."""
    data = prepare([recorded(axis)], axis)
    early = dataclasses.replace(data.runs[0], outputs=np.roll(data.runs[0].outputs, -2, axis=0))
    late = dataclasses.replace(data.runs[0], outputs=np.roll(data.runs[0].outputs, 2, axis=0))
    gains = []
    for run in (early, late):
        shifted = dataclasses.replace(data, runs=(run,))
        fitted = fit(axis, default_free_parameters(axis)[:1], shifted, SIMULATION)
        gains.append(screen(fitted, [candidate("sensor_delay", "x_m", d=1e-3)], shifted)[0].gain)
    assert gains[0] == 0.0
    assert gains[1] > 0.5 * data.count


@pytest.mark.parametrize(
    ("name", "site", "column", "amplitude"),
    [
        ("cogging", "motor", {"A": 0.2, "n": 90.0, "p": 0.4}, "A"),
        ("position_friction", "x", {"A": 5.0, "L": 0.02, "p": 0.4}, "A"),  # five times the Coulomb friction
        ("sensor_delay", "x_m", {"d": 1e-3}, "d"),
    ],
)
def test_response_predicts_the_simulation_with_a_small_effect(
    axis: Machine, name: str, site: str, column: dict[str, float], amplitude: str
) -> None:
    data = prepare([recorded(axis)], axis)
    run, fraction = data.runs[0], 1e-3
    motion = predict(axis, run, SIMULATION, period=data.period, states=True)
    candidates = [candidate(name, site, **column)]
    perturbation = candidate_perturbations(
        Unperturbed(axis, run, motion), perturbed_machines(axis, candidates)
    )
    perturbed = predict(
        axis,
        run,
        SIMULATION,
        period=data.period,
        extra_force=fraction * perturbation.force,
        extra_measurement=fraction * perturbation.measurement,
    )
    machine = axis.with_effects(EFFECTS[name].at(site, **{**column, amplitude: fraction * column[amplitude]}))
    exact = predict(machine, run, SIMULATION, period=data.period)
    change = exact.readings - motion.readings
    error = perturbed.readings - exact.readings
    assert np.abs(change).max() > 1e-7
    assert np.abs(error).max() < 0.03 * np.abs(change).max()


def test_another_effect_in_place_of_one_saves_what_a_fit_would(axis: Machine) -> None:
    """A cable explains a part of what the constant force does; a force that falls with speed explains less."""
    wrong = EFFECTS["constant_force"].at("x", size=0.1)
    data = prepare([recorded(axis.with_effects(EFFECTS["cable_spring"].at("x", k=20.0, q0=0.0)))], axis)
    machine = axis.with_effects(wrong)
    free = default_free_parameters(machine)
    fitted = fit(machine, free, data, SEARCH_BANDWIDTH)
    bare = fitted.machine.replace(effects=())
    others = CANDIDATES[1:]
    ranked, gain = Screening.of(fitted, others, data, without={wrong.label: bare}).in_place_of(wrong.label)
    without = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    assert gain == pytest.approx(without.cost - fitted.cost, rel=0.1, abs=0.02 * without.cost)
    assert ranked[0].candidate.label == "cable_spring@x"
    cable = axis.with_effects(ranked[0].candidate.applied(ranked[0].amounts))
    found = fit(cable, default_free_parameters(cable), data, SEARCH_BANDWIDTH)
    assert ranked[0].gain == pytest.approx(without.cost - found.cost, rel=0.1)


def test_a_machine_that_diverges_without_an_effect_keeps_it(axis: Machine) -> None:
    fitted, data = fit_without_effect(axis, 0.3)
    diverging = axis.with_effects(EFFECTS["cable_spring"].at("x", k=-1e6, q0=0.01))
    screening = Screening.of(fitted, CANDIDATES, data, without={"constant_force@x": diverging})
    assert screening.in_place_of("constant_force@x") == ([], np.inf)
    assert screening.ranked()[0].candidate.label == "constant_force@x"


def test_columns_of_several_candidates_keep_their_order(axis: Machine) -> None:
    data = prepare([recorded(axis)], axis)
    motion = predict(axis, data.runs[0], SEARCH_BANDWIDTH, period=data.period, states=True)
    perturbed = perturbed_machines(axis, CANDIDATES)
    perturbation = candidate_perturbations(Unperturbed(axis, data.runs[0], motion), perturbed)
    np.testing.assert_allclose(perturbation.force[0], 0.1)
    viscous = axis.coordinates[0].viscous
    np.testing.assert_allclose(
        perturbation.force[1], -0.1 * viscous * np.abs(motion.velocities[0]), atol=1e-12
    )
    np.testing.assert_allclose(perturbation.force[2], -10.0 * motion.positions[0], atol=1e-12)
    assert not perturbation.measurement.any()


def test_no_candidates_give_no_scores(axis: Machine) -> None:
    fitted, data = fit_without_effect(axis, 0.0)
    assert screen(fitted, [], data) == []


def test_a_clock_whose_rate_changes_ranks_first(axis: Machine) -> None:
    """Its actual samples are later than its stamps, by a t^2/2."""
    plain, a = recorded(axis), 0.01
    actual_s = plain.time_s + 0.5 * a * plain.time_s**2
    noise = plain.outputs - axis.simulate(plain.time_s, plain.inputs).outputs
    drifting = dataclasses.replace(plain, outputs=axis.simulate(actual_s, plain.inputs).outputs + noise)
    data = prepare([drifting], axis)
    current = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    best, *_ = screen_structures(current, data, typical_scales(current, data), 0.0)
    assert best.effects[-1].label == "clock_drift@machine"
    assert best.effects[-1].parameters["a"] > 0.0


def test_which_effects_replace_a_part_of_the_model() -> None:
    replacing = {name for name, effect in EFFECTS.items() if effect.replaces_model_part}
    assert replacing == {
        "bridge_yaw",
        "frame_resonance",
        "gear_backlash",
        "idler_inertia",
        "payload_swing",
        "presliding",
    }
