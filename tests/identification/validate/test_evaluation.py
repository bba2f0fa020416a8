"""Tests of what held-out runs say about a verdict: each threshold from both sides."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from hframe_gym.dynamics import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import SelectionCriteria, identify, prepare
from hframe_gym.identification.fit.long_run_variance import variance_of_change
from hframe_gym.identification.judge.unstable_motion import UnstableMotion
from hframe_gym.identification.judge.verdict import (
    VerdictEvidence,
    contradiction_of_names,
    contradiction_of_no_effect,
    remaining,
    rounding_counts,
)
from hframe_gym.identification.propose.dependences import Dependence, agree_with_causes
from hframe_gym.identification.search.outcome import SearchOutcome
from hframe_gym.identification.validate.evaluation import (
    Evaluated,
    _Removal,
    _with_fast_error,
    judged,
)
from hframe_gym.machine import AppliedEffect, Machine
from hframe_gym.recordings import Recording
from tests.identification.single_axis import AXIS, limited_runs

CRITERIA = SelectionCriteria()
EXACT = VerdictEvidence(left=1.0, left_before=1.0, motion=1e-4, lacking=1e-6, remaining_prediction=1.0)


@pytest.mark.parametrize("left", [142.0, 588.0, 23_839.0, 2.01, math.inf])
def test_no_effect_is_not_said_above_twice_the_noise(left: float) -> None:
    """A sensor that repeated its measurements was taken for jitter of the clock, and that for all error."""
    reason = contradiction_of_no_effect(dataclasses.replace(EXACT, left=left), CRITERIA)
    expected = f"{left:.3g} times the noise of the sensors" if math.isfinite(left) else "diverges"
    assert expected in reason
    assert contradiction_of_no_effect(dataclasses.replace(EXACT, left=1.99), CRITERIA) == ""


@pytest.mark.parametrize(
    ("unknown", "left", "predicted", "contradiction"),
    [
        ("voltages_known", 1.2, 1.05, ""),
        ("voltages_known", 2.2, 1.39, ""),  # an exact machine, five changes a row
        # a slow force, which predictions hide
        ("voltages_known", 4.1, 1.1, "4.1 times what noise and the unknown voltages"),
        ("voltages_known", 2.0, 1.66, "1.66 times what noise and the unknown voltages"),
        ("voltages_known", math.nan, 1.0, "diverges"),
        ("stamps_known", 1.9, 1.2, ""),
        ("stamps_known", 2.1, 1.2, "2.1 times what noise and the rounding of the time stamps cause"),
        ("stamps_known", 1.0, 1.6, "1.6 times what noise and the rounding of the time stamps cause"),
    ],
)
def test_unknown_voltages_or_stamps_may_explain_an_error_that_predictions_do_not_have(
    unknown: str, left: float, predicted: float, contradiction: str
) -> None:
    changes: dict[str, Any] = {"left": left, "predicted": predicted, unknown: False}
    evidence = dataclasses.replace(EXACT, **changes)
    reason = contradiction_of_no_effect(evidence, CRITERIA)
    assert contradiction in reason
    assert bool(contradiction) == bool(reason)


@pytest.mark.parametrize(("changes", "counts"), [(0.99, False), (1.01, True), (math.inf, False)])
def test_rounding_counts_if_it_causes_more_than_noise(changes: float, counts: bool) -> None:
    assert rounding_counts(changes) == counts


@pytest.mark.parametrize(
    ("left", "enlarged", "predicted", "contradiction"),
    [
        (111.0, 2.3e4, 0.97, ""),  # an exact pendulum, swung above its axis
        (111.0, 2.3e4, 1.22, "predictions is 1.22 times that of an exact machine"),  # an effect is missing
        (111.0, 50.0, 0.97, "111 times the noise"),  # more than the instability explains
        (2.1, None, 1.0, "2.1 times the noise"),  # a machine that is stable
        (math.inf, 2.3e4, 1.0, "diverges"),
    ],
)
def test_predictions_judge_where_simulations_enlarge_small_errors(
    left: float, enlarged: float | None, predicted: float, contradiction: str
) -> None:
    unstable = None if enlarged is None else UnstableMotion(enlarged, predicted)
    evidence = dataclasses.replace(EXACT, left=left, motion=0.3, unstable=unstable)
    reason = contradiction_of_no_effect(evidence, CRITERIA)
    assert contradiction in reason
    assert bool(contradiction) == bool(reason)


@pytest.mark.parametrize(
    ("motion", "left", "hidden"),
    [
        (0.09, 1.99, None),
        (0.22, 1.0, None),  # an accelerometer: the mean over its samples shows less than the noise of each
        (0.22, 1.15, "11 %"),
        (0.3, 1.0, "12 %"),
        (0.15, 1.9, "13 %"),
        (0.3, 0.5, "12 %"),  # noise that is declared too large hides no more
    ],
)
def test_no_effect_is_not_said_if_the_noise_may_hide_a_part_of_the_motion(
    motion: float, left: float, hidden: str | None
) -> None:
    reason = contradiction_of_no_effect(dataclasses.replace(EXACT, motion=motion, left=left), CRITERIA)
    assert reason == "" if hidden is None else f"may hide {hidden} of the motion" in reason


@pytest.mark.parametrize(
    ("explained", "prediction", "left", "named"),
    [
        (False, 0.10, 687.0, False),  # a torque constant that falls with the current: three wrong names
        (False, 0.067, 408.0, False),  # friction that rises with the time at rest: two
        (False, 0.0097, 66.8, True),  # Stribeck friction, rightly
        (True, 0.49, 50.0, True),
        (True, 0.51, 900.0, False),  # the noise of the fit was too large
        (True, 0.9, 2.5, True),  # an observer hides what the simulation shows
        (False, 0.9, 1.9, True),  # only noise is left
    ],
)
def test_effects_are_named_if_little_is_left(
    explained: bool, prediction: float, left: float, named: bool
) -> None:
    evidence = VerdictEvidence(left, 1000.0, 0.01, 0.02, prediction)
    reason = contradiction_of_names(evidence, explained, CRITERIA)
    assert (reason == "") == named
    assert (
        named or f"{left:.3g} times the noise of the sensors and 2 % of the drives' force are left" in reason
    )


@pytest.mark.parametrize(("unstable", "named"), [(None, True), (UnstableMotion(2.3e4, 1.1), False)])
def test_along_an_unstable_motion_names_do_not_hold_by_a_simulation(
    unstable: UnstableMotion | None, named: bool
) -> None:
    """The simulation errs half as much by chance, the predictions as much as before."""
    evidence = dataclasses.replace(
        EXACT, left=500.0, left_before=1000.0, remaining_prediction=0.9, unstable=unstable
    )
    assert (contradiction_of_names(evidence, True, CRITERIA) == "") == named


def test_the_fraction_that_remains_counts_beyond_an_exact_machine() -> None:
    assert remaining(2.0, 11.0, 1.0) == pytest.approx(0.1)
    assert remaining(0.9, 0.9, 1.0) == 0.0
    assert remaining(2.0, 1.0, 1.0) == math.inf
    assert remaining(math.inf, math.inf, 1.0) == math.inf


def test_a_fit_that_explains_everything_does_not_lead_to_no_effect() -> None:
    """As with a noise that was estimated far too large, the search takes any error for explained."""
    blind = SelectionCriteria(explained_chi2=1e9)
    result = identify(limited_runs([4.0] * 4), AXIS, budget=0.0, criteria=blind)
    assert result.left > 2.0
    assert result.verdict == "unexplained"
    refitted = result.before.held_out.noise_ratio  # judged before the plain fit may take its place
    assert f"{refitted:.3g} times the noise of the sensors" in result.reason
    assert result.as_json()["reason"] == result.reason


@pytest.mark.parametrize(("remaining_fraction", "named"), [(0.11, True), (0.26, False)])
def test_effects_that_are_the_main_causes_may_leave_more(remaining_fraction: float, named: bool) -> None:
    """Of a real axis, 11 % of the squared error remained beside friction confirmed on another record."""
    evidence = VerdictEvidence(3e5, 1e6, 0.01, 0.02, remaining_fraction, causes_named=True)
    assert (contradiction_of_names(evidence, False, CRITERIA) == "") == named


@pytest.mark.parametrize(
    ("causes", "fast", "reduction", "named"),
    [
        (True, 0.07, 1.2, True),  # backlash of both gears beside a slow force
        (True, 0.26, 1.2, False),
        (True, 0.07, 0.8, False),  # it removes less than it should: it imitates something
        (False, 0.07, 1.2, False),
    ],
)
def test_fast_effects_are_named_beside_a_slow_force(
    causes: bool, fast: float, reduction: float, named: bool
) -> None:
    evidence = VerdictEvidence(
        50.0, 50.0, 0.01, 3e-4, 0.46, causes_named=causes, remaining_fast=fast, reduction=reduction
    )
    assert (contradiction_of_names(evidence, False, CRITERIA) == "") == named


@pytest.mark.parametrize(
    ("known", "reduction", "named"),
    [
        (False, 1.05, True),  # play of belts and friction by load; the true machine leaves as much
        (False, 0.8, False),  # it removes less than it should: it imitates something
        (True, 1.05, False),  # more than noise has another cause
    ],
)
def test_effects_are_named_beside_what_unknown_voltages_leave(
    known: bool, reduction: float, named: bool
) -> None:
    evidence = VerdictEvidence(2.33, 2.53, 0.007, 2e-3, 0.505, voltages_known=known, reduction=reduction)
    assert (contradiction_of_names(evidence, True, CRITERIA) == "") == named


@pytest.mark.parametrize(
    ("reduction", "std", "by_chance", "named"),
    [
        (0.80, 0.22, 0.50, True),  # friction by load that six fitted runs confirm
        (0.80, 0.02, 0.50, False),  # it imitates something
        (0.69, 0.30, 1.92, False),  # chance reaches as much
        (0.60, 0.22, 0.50, False),
        (0.85, 0.00, 1.92, True),  # what removes enough need not exceed chance: the fitted runs have said so
    ],
)
def test_effects_of_slow_logs_may_fall_short_by_their_deviation(
    reduction: float, std: float, by_chance: float, named: bool
) -> None:
    evidence = VerdictEvidence(
        2.61,
        2.73,
        0.01,
        1.5e-3,
        0.78,
        voltages_known=False,
        reduction=reduction,
        reduction_std=std,
        reduction_by_chance=by_chance,
    )
    assert (contradiction_of_names(evidence, True, CRITERIA) == "") == named


def test_the_deviation_of_the_reduction_is_that_of_repeated_logs() -> None:
    """Noise of a sensor lasts 20 ms; the reductions scatter six times as much as with white noise."""
    rng, samples = np.random.default_rng(1), 20_000
    data: Any = SimpleNamespace(period=0.001)
    change = np.sin(1e-3 * np.arange(samples)) / 5.0
    reductions, deviations = [], []
    for _ in range(60):
        noise = lfilter([math.sqrt(1.0 - 0.95**2)], [1.0, -0.95], rng.normal(size=samples))
        removed = float(np.sum((change + noise) ** 2) - np.sum(noise**2))
        removal = _Removal(
            removed, float(np.sum(change**2)), variance_of_change([(change, noise)], AXIS, data)
        )
        reductions.append(removal.reduction)
        deviations.append(removal.std)
    assert np.mean(reductions) == pytest.approx(1.0, abs=0.3)
    assert np.median(deviations) == pytest.approx(np.std(reductions), rel=0.4)


@pytest.mark.parametrize(("size", "reduction", "fast"), [(0.3, 1.0, 0.0), (0.6, 0.0, 1.0)])
def test_right_effects_remove_the_square_of_what_they_change(
    size: float, reduction: float, fast: float
) -> None:
    """Of an effect of double the true size nothing remains; a slow force beside both changes little."""
    cogging = EFFECTS["cogging"]
    rng, time_s = np.random.default_rng(0), np.arange(1500) * 1e-3
    volts = np.where(time_s > 0.1, 4.0 * np.sin(9.0 * time_s) + 2.0 * np.sin(23.0 * time_s), 0.0)[:, None]
    slow = 0.05 * np.sin(1.5 * time_s)[None, :, None]
    true = AXIS.with_effects(cogging.at("motor", A=0.3, n=40.0, p=0.0))
    readings = simulate_batch(true, time_s, volts, extra_force=slow, longest_step=0.125e-3).readings[0]
    data = prepare([Recording("run", time_s, volts, readings + rng.normal(0.0, 2e-6, readings.shape))], AXIS)
    named = AXIS.with_effects(cogging.at("motor", A=size, n=40.0, p=0.0))
    evaluated: Any = SimpleNamespace(
        test=SimpleNamespace(complete_runs=data),
        held_out=data,
        before=SimpleNamespace(machine=AXIS),
        after=SimpleNamespace(machine=named),
    )
    found = _with_fast_error(EXACT, evaluated, ())
    assert found.reduction == pytest.approx(reduction, abs=0.15)
    assert found.remaining_fast == pytest.approx(fast, abs=0.15)


@pytest.mark.parametrize(
    ("refitted_explains", "contradicted", "verdict"),
    [
        (True, False, "no_effect"),  # a constant force had described what the voltages between the rows cause
        (True, True, "unexplained"),
        (False, False, "unexplained"),
    ],
)
def test_without_its_names_the_refitted_machine_is_judged(
    refitted_explains: bool, contradicted: bool, verdict: str
) -> None:
    """The reasons against the names say nothing about a machine without effects."""
    axis: Any = SimpleNamespace(machine=AXIS)
    force: Any = SimpleNamespace(effect=EFFECTS["constant_force"].at("x", size=0.1))
    nothing: Any = None
    outcome = SearchOutcome(axis, refitted_explains, True, "effect_found", axis, (force,), (), nothing)

    class HeldOutRuns:
        def contradiction(self, evaluated: Evaluated, differing: Sequence[str]) -> str:
            return "too much remains" if evaluated.outcome.selected or contradicted else ""

        def evaluate(self, outcome: SearchOutcome) -> Evaluated:
            test: Any = self
            return Evaluated(outcome, outcome.selected, nothing, nothing, nothing, test)

    found, withdrawn = judged(HeldOutRuns().evaluate(outcome), (), lambda line: None)
    assert (found.outcome.verdict, found.selected) == (verdict, ())
    assert found.reason == ("" if verdict == "no_effect" else "too much remains")
    assert [c.reason for c in found.outcome.considered] == ["is not named: too much remains"]
    assert withdrawn is not None  # the machine with the effects may still describe the runs
    assert withdrawn.selected == (force,)


@pytest.mark.parametrize(
    ("labels", "causes", "expected"),
    [
        (
            ["electrical_lag@motor1", "electrical_lag@motor2"],
            [("drives", "load of drives"), ("motor1", "v1_V")],
            True,
        ),  # each drive has it
        (["electrical_lag@motor1"], [("drives", "load of drives"), ("motor1", "v1_V")], False),
        (["stribeck_friction@x"], [("x", "velocity of x"), ("x", "position of x")], True),
        (
            ["stribeck_friction@x"],
            [("x", "dwell of x"), ("x", "velocity of x")],
            False,
        ),  # another variable leads
        (
            ["stribeck_friction@x"],
            [("y", "velocity of y"), ("x", "velocity of x")],
            False,
        ),  # another component leads
        (
            ["stribeck_friction@x", "electrical_lag@motor1"],
            [("x", "velocity of x"), ("motor1", "v1_V")],
            True,
        ),
        (
            ["stribeck_friction@x", "electrical_lag@motor1"],
            [("x", "velocity of x"), ("motor2", "v2_V")],
            False,
        ),
        (["current_limit@drives"], [("drives", "current of drives")], True),
        (["current_limit@drives", "load_friction@motor1"], [("drives", "current of drives")], False),
        (["cogging@motor1"], [("phi1", "position of phi1")], True),
        (["constant_force@x"], [("x", "constant")], True),
        (["constant_force@x"], [("x", "position of x")], False),
        (["constant_force@x"], [("phi1", "constant")], False),
        (["cogging@motor1"], [("phi1", "constant")], False),
        (["cogging@motor1", "constant_force@x"], [("phi1", "position of phi1"), ("x", "constant")], True),
        (["sensor_scale@phi1_rad"], [("phi1_rad", "position of phi1")], False),  # belts that slip imitate it
        (["stribeck_friction@x"], [], False),
        ([], [("x", "velocity of x")], False),
    ],
)
def test_effects_agree_with_causes(
    labels: list[str], causes: list[tuple[str, str]], expected: bool, hframe: Machine
) -> None:
    def applied(label: str) -> AppliedEffect:
        name, _, site = label.partition("@")
        return EFFECTS[name].at(site, **{p.name: max(p.lower, 0.01) for p in EFFECTS[name].parameters})

    effects = [applied(label) for label in labels]
    ranked = [Dependence(variable, "x", 0.5, component) for component, variable in causes]
    assert agree_with_causes(effects, ranked, hframe) == expected
