"""Tests of the significance of an effect: the doubts about it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import default_free_parameters, fit, prepare
from hframe_gym.identification.evidence import significance
from hframe_gym.identification.evidence.significance import (
    TestedFit,
    doubt_about_candidate,
    doubt_beside_others,
    effect_evidence,
)
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.machine import AppliedEffect, rest_state
from hframe_gym.recordings import Recording
from tests.identification.scripted_fits import (
    AXIS,
    CLOCK,
    CRITERIA,
    DATA,
    FRAME,
    HFRAME,
    PUSH,
    Scripted,
    fit_with,
)
from tests.identification.single_axis import axis_runs


@pytest.mark.parametrize(
    ("residue", "heat_force", "reason"),
    [
        (0.3, 20.0, "adds 2 % to the force of winding_heat@motor, which depends on the same variable"),
        (0.3, 1.0, ""),
        (0.4, 1.0, "explains a force of 0.3 N, where 0.4 N remain unexplained"),
    ],
)
def test_a_clock_has_the_size_of_the_force_that_it_explains(
    scripted: Scripted, residue: float, heat_force: float, reason: str
) -> None:
    """A winding that warms up otherwise than by the formula leaves what a drifting clock partly explains."""
    heat = EFFECTS["winding_heat"].at("motor", a=0.03, tau=10.0)
    scripted.residue, scripted.force = {1.3: 0.5, 1.1: residue}, {heat.label: heat_force}
    both = fit_with(heat, CLOCK, chi2=1.1)
    doubt = doubt_about_candidate(TestedFit(fit_with(heat, chi2=1.3), DATA), both, CRITERIA)
    assert doubt.startswith(reason) if reason else doubt == ""


def test_noise_of_the_motion_does_not_remain_unexplained(scripted: Scripted) -> None:
    """Of the force that is left beside a structure, most may be noise that the rows at rest do not show."""
    scripted.residue, scripted.residue_beyond_noise = {1.4: 0.5, 1.1: 0.4}, {1.1: 0.2}
    without, both = fit_with(chi2=1.4), fit_with(FRAME, chi2=1.1)
    assert doubt_about_candidate(TestedFit(without, DATA), both, CRITERIA) == ""
    scripted.residue_beyond_noise = {}
    doubt = doubt_about_candidate(TestedFit(without, DATA), both, CRITERIA)
    assert doubt == "explains a force of 0.3 N, where 0.4 N remain unexplained"


def test_no_effect_corrects_a_clock(scripted: Scripted) -> None:
    """It has no force, of which another effect could be a small part."""
    heat = EFFECTS["winding_heat"].at("motor", a=0.03, tau=10.0)
    scripted.force = {CLOCK.label: np.inf}
    both = fit_with(heat, CLOCK, chi2=1.1)
    assert doubt_beside_others(fit_with(CLOCK, chi2=1.3), TestedFit(both, DATA), heat, CRITERIA) == ""


def test_a_fit_has_its_other_observers_and_voltages_once() -> None:
    data = axis_runs(AXIS, rows=200, volts=3.0).with_updates(4)
    alone = TestedFit(fit(AXIS, default_free_parameters(AXIS), data, SEARCH_BANDWIDTH, iterations=1), data)
    assert alone.narrower.bandwidth < SEARCH_BANDWIDTH
    assert alone.narrower is alone.narrower
    assert alone.cost_beside_voltages < alone.fitted.cost
    assert alone.cost_beside_voltages is alone.cost_beside_voltages  # the same object, not an equal number


def test_candidates_are_compared_with_what_is_known_of_the_machine_without_them(scripted: Scripted) -> None:
    """All have it in common: the fit with the narrower observer, and what is left beside unknown voltages."""
    data = SimpleNamespace(**vars(DATA) | {"updates": 4})
    alone = TestedFit(fit_with(chi2=1.3, bandwidth=60.0), data)
    alone.narrower, alone.cost_beside_voltages = fit_with(chi2=1.7, bandwidth=30.0), 900.0
    for chi2 in (1.1, 1.2):
        candidate = TestedFit(fit_with(PUSH, chi2=chi2, bandwidth=60.0), data)
        candidate.narrower, candidate.cost_beside_voltages = fit_with(PUSH, chi2=chi2 + 0.2), 500.0
        evidence = effect_evidence(alone, candidate, PUSH)
        assert evidence.beside_voltages is not None
        assert evidence.beside_voltages() == 400.0
        assert evidence.chance_narrower is not None
        assert evidence.chance_narrower().gain == alone.narrower.cost - candidate.narrower.cost


SKEW = EFFECTS["sensor_skew"].at("x_m", a=2e-3)


@pytest.mark.parametrize(("hidden", "agree"), [(SKEW, True), (PUSH, False)])
def test_an_error_of_a_laser_explains_what_encoders_say_otherwise(hidden: AppliedEffect, agree: bool) -> None:
    """A force moves the pulleys as well; a skew in its place makes laser and encoders disagree."""
    time_s = np.arange(1500) * 1e-3
    waves = np.sin(2 * np.pi * np.outer(time_s - 0.1, [1.3, 1.7]))
    inputs = np.where(time_s[:, None] > 0.1, 5.0 * waves, 0.0)
    motion = simulate(HFRAME.with_effects(hidden), time_s, inputs).outputs
    noise = np.random.default_rng(0).normal(0.0, 1.0, motion.shape) * [1e-3, 1e-3, 1e-5, 1e-5]
    data = prepare([Recording("run", time_s, inputs, motion + noise)], HFRAME)
    without, with_skew = (SimpleNamespace(machine=m) for m in (HFRAME, HFRAME.with_effects(SKEW)))
    measured = significance._disagreement_of_sensors(without, with_skew, SKEW, data)
    assert measured is not None
    assert (measured().with_effect < measured().without) == agree
    assert significance._disagreement_of_sensors(without, with_skew, PUSH, data) is None


def test_where_runs_start_follows_from_an_error_of_a_laser() -> None:
    """Belts rest stretched, as the encoders show; their zeros follow from the lasers with this error."""
    skew, rng = EFFECTS["sensor_skew"].at("y_m", a=3e-4), np.random.default_rng(0)
    time_s = np.arange(600) * 1e-3
    inputs = np.where(
        time_s[:, None] > 0.1, 5.0 * np.sin(2 * np.pi * np.outer(time_s - 0.1, [1.3, 1.7])), 0.0
    )
    runs = []
    for k, x in enumerate((-0.2, 0.0, 0.2)):
        start = rest_state(HFRAME, (x, 0.1 * x))
        start[2:4] += rng.normal(0.0, 0.02, 2)
        motion = simulate(HFRAME.with_effects(skew), time_s, inputs, start).outputs
        noise = rng.normal(0.0, 1.0, motion.shape) * [1e-4, 1e-4, 1e-5, 1e-5]
        runs.append(Recording(f"run_{k}", time_s, inputs, motion + noise))
    data = prepare(runs, HFRAME)
    without, with_skew = (SimpleNamespace(machine=m) for m in (HFRAME, HFRAME.with_effects(skew)))
    measured = significance._disagreement_of_sensors(without, with_skew, skew, data)
    assert measured is not None
    assert measured().with_effect < 0.9 * measured().without
