"""Tests of the search for a delay that the observer hides, in runs of an axis with a slow unnamed force."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from hframe_gym.dynamics import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, SelectedEffect, default_free_parameters, fit, prepare
from hframe_gym.identification.fit.model_error import continue_fit
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.propose.trial_fits import converge
from hframe_gym.identification.search import input_timing
from hframe_gym.identification.search.input_timing import with_input_timing
from hframe_gym.identification.search.outcome import SearchOutcome
from hframe_gym.machine import AppliedEffect
from hframe_gym.recordings import Recording
from tests.identification.scripted_fits import CRITERIA
from tests.identification.single_axis import AXIS

PUSH = EFFECTS["constant_force"].at("x", size=0.5)
SLOW = 0.1  # N, amplitude of the force without a name
PERIOD = 1e-3  # s


def delay(seconds: float) -> AppliedEffect:
    return EFFECTS["input_delay"].at("drives", d=seconds)


def lag(seconds: float) -> AppliedEffect:
    return EFFECTS["electrical_lag"].at("motor", tau=seconds)


@cache
def recorded(
    delay_s: float = 0.0,
    lag_s: float = 0.0,
    *,
    seeds: tuple[int, ...] = (0, 1, 2),
    slow: float = SLOW,
    noise: float = 1e-6,
    every: int = 1,
) -> Dataset:
    """Return runs with a constant force, a slow one, and a delay or a lag of the drives.

    Args:
        delay_s: Delay, s.
        lag_s: Time constant of the lag, s.
        slow: Amplitude of the slow force, N.
        noise: Of the sensor, m.
        every: Which rows are logged.
    """
    timing = [*([delay(delay_s)] if delay_s else []), *([lag(lag_s)] if lag_s else [])]
    runs, truth = [], AXIS.with_effects(PUSH, *timing)
    for seed in seeds:
        rng, time_s = np.random.default_rng(seed), np.arange(1000) * PERIOD
        inputs = np.repeat(rng.uniform(-6.0, 6.0, (20, 1)), 50, axis=0)
        inputs[:100] = 0.0
        force = slow * np.sin(7.0 * time_s + seed) * (time_s > 0.1)
        motion = simulate_batch(
            truth, time_s, inputs, extra_force=force[None, :, None], longest_step=0.125e-3
        )
        outputs = motion.readings[0] + rng.normal(0.0, noise, motion.readings[0].shape)
        runs.append(Recording(f"run_{seed}", time_s[::every], inputs[::every], outputs[::every]))
    return prepare(runs, AXIS)


def outcome_of(data: Dataset) -> SearchOutcome:
    """Return the outcome of a search that found the constant force alone."""
    machine = AXIS.with_effects(PUSH)
    after = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    selected = (SelectedEffect(PUSH, 1.0, AXIS),)
    return SearchOutcome(after, False, False, "effect_found", after, selected, (), data)


def test_a_delay_that_the_observer_hides_is_added() -> None:
    lines: list[str] = []
    before = outcome_of(recorded(1e-3))
    outcome = with_input_timing(before, recorded(1e-3, seeds=(7,)), CRITERIA, lines.append)
    assert [s.effect.label for s in outcome.selected] == ["constant_force@x", "input_delay@drives"]
    added = outcome.selected[1]
    assert added.effect.parameters["d"] == pytest.approx(1e-3, rel=0.02)
    assert added.machine_without is before.after.machine
    assert outcome.after.bandwidth == SEARCH_BANDWIDTH
    assert added.gain == pytest.approx(before.after.chi2 - outcome.after.chi2)
    assert "300 rad/s" in lines[-1]  # 0.3 rad a sampling period


def test_delays_and_lags_of_the_library() -> None:
    """Not what changes the current slowly, such as heat."""
    timing = {name for name, effect in EFFECTS.items() if input_timing.is_timing(effect)}
    assert timing == {"input_delay", "electrical_lag"}


@pytest.mark.parametrize(
    ("true", "selected", "rivals"),
    [
        ({"delay_s": 1e-3}, "input_delay@drives", ["electrical_lag@motor"]),
        ({"delay_s": 3e-3}, "input_delay@drives", []),
        ({"lag_s": 1e-3}, "electrical_lag@motor", ["input_delay@drives"]),
    ],
)
def test_complete_fits_decide_between_a_delay_and_a_lag(
    true: dict[str, float], selected: str, rivals: list[str]
) -> None:
    """An equally good one is a rival of the other; a long delay has none."""
    before, held_out = outcome_of(recorded(**true)), recorded(**true, seeds=(7,))
    added = with_input_timing(before, held_out, CRITERIA, lambda line: None).selected[1]
    assert added.effect.label == selected
    assert [rival.label for rival in added.rival_effects] == rivals


def test_trials_are_complete() -> None:
    """Few iterations leave the lag 2 % above its cost."""
    before = outcome_of(recorded(3e-3))
    trials = [*input_timing._complete_trials(continue_fit(before.after, before.data, 300.0), before.data)]
    assert {trial.machine.effects[-1].name for trial in trials} == {"input_delay", "electrical_lag"}
    for trial in trials:
        assert trial.cost == pytest.approx(converge(trial, before.data, thorough=False).cost, rel=1e-3)


@pytest.mark.parametrize(
    ("delay_s", "slow", "held_out_delay_s", "reason"),
    [(1e-3, 0.2 * SLOW, 1e-3, "a slow error"), (3e-3, SLOW, 0.0, "held-out runs")],
)
def test_a_delay_that_fails_a_test_is_only_considered(
    delay_s: float, slow: float, held_out_delay_s: float, reason: str
) -> None:
    """`judge.effect.doubt_about_timing` decides."""
    lines: list[str] = []
    before, held_out = outcome_of(recorded(delay_s, slow=slow)), recorded(held_out_delay_s, seeds=(7,))
    outcome = with_input_timing(before, held_out, CRITERIA, lines.append)
    assert len(outcome.selected) == 1
    assert [entry.effect.label for entry in outcome.considered] == ["input_delay@drives"]
    assert reason in outcome.considered[0].reason
    assert reason in lines[-1]


@pytest.mark.parametrize(
    "changed",
    [
        lambda outcome: outcome._replace(selected=()),
        lambda outcome: outcome._replace(explained=True),
        lambda outcome: outcome._replace(after=dataclasses.replace(outcome.after, bandwidth=30.0)),
        lambda outcome: outcome._replace(
            after=dataclasses.replace(outcome.after, machine=outcome.after.machine.with_effects(lag(1e-3)))
        ),
        lambda outcome: outcome_of(recorded(1e-3, every=5)),
        lambda outcome: outcome_of(recorded(1e-3, noise=1e-3)),
    ],
    ids=["no effect", "explained", "narrow observer", "lag known", "slow sampling", "noisy sensors"],
)
def test_it_is_not_tried_where_nothing_is_hidden(changed: Callable[[SearchOutcome], SearchOutcome]) -> None:
    lines: list[str] = []
    other = changed(outcome_of(recorded(1e-3)))
    assert with_input_timing(other, recorded(1e-3, seeds=(7,)), CRITERIA, lines.append) is other
    assert lines == []


def test_an_axis_whose_drives_act_at_once_has_none() -> None:
    outcome = outcome_of(recorded())
    found = with_input_timing(outcome, recorded(seeds=(7,)), CRITERIA, lambda line: None)
    assert (found.selected, found.after) == (outcome.selected, outcome.after)
