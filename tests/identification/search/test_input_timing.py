"""Tests of the search for a delay that the observer hides, with scripted fits: each condition from both sides."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Fit
from hframe_gym.identification.judge.chance import LongRunVariance
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.search import input_timing
from hframe_gym.identification.search.input_timing import with_input_timing
from hframe_gym.identification.search.outcome import SearchOutcome
from tests.identification.scripted_fits import COUNT, CRITERIA, PUSH, fit_with, runs, selected

DELAY = EFFECTS["input_delay"].at("drives", d=2e-4)
LAG = EFFECTS["electrical_lag"].at("motor", tau=2e-4)
WIDE = 300.0  # rad/s; 0.3 rad per sampling period of 1 ms


class Script:
    """Costs by observer bandwidth, without and with the delay, and the results of the tests of its benefit."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.chi2 = {SEARCH_BANDWIDTH: (100.0, 97.0), WIDE: (10.0, 9.0)}
        self.variance, self.confirmed, self.fault = 1.0, 1.0, ""
        self.held_out_gain = 0.2
        self.lag: float | None = None  # chi-squared with a lag instead of the delay
        self.converged: dict[str, Fit] = {}  # what the fit of a trial ends with, by the effect's label
        self.lines: list[str] = []
        replaced = {
            "refine_dataset": lambda data, machine, reference=None: data,
            "continue_fit": self.fitted,
            "polish": lambda fitted, data: fitted,
            "converge": lambda trial, data, thorough: self.converged.get(
                trial.machine.effects[-1].label, trial
            ),
            "likelihood_loss": lambda fitted, data: fitted.chi2,
            "long_run_variance": lambda fitted, label, data: LongRunVariance(self.variance),
            "leave_one_out_gain": lambda a, b, data: self.confirmed * (a.cost - b.cost),
            "refitted_leave_one_out_gain": lambda a, b, data, least: self.confirmed * (a.cost - b.cost),
            "plausibility_fault": lambda machine: self.fault,
            "error_reduction": lambda *arguments: self.held_out_gain,
            "_trials": self.trials,
        }
        for name, function in replaced.items():
            monkeypatch.setattr(input_timing, name, function)

    def fitted(self, fitted: Fit, data: Any, bandwidth: float) -> Fit:
        """Return the scripted fit of the same machine at another bandwidth."""
        effects = fitted.machine.effects
        return fit_with(*effects, chi2=self.chi2[bandwidth][len(effects) - 1], bandwidth=bandwidth)

    def trials(self, current: Fit, data: Any) -> list[Fit]:
        """Return the trial fit of the delay, and that of a lag if there is one."""
        lags = [] if self.lag is None else [fit_with(PUSH, LAG, chi2=self.lag, bandwidth=WIDE)]
        return [fit_with(PUSH, DELAY, chi2=self.chi2[WIDE][1], bandwidth=WIDE), *lags]

    def outcome(self, period: float = 1e-3, bandwidth: float = SEARCH_BANDWIDTH) -> SearchOutcome:
        """Return an outcome with a constant force that leaves forces of unknown size."""
        data: Any = SimpleNamespace(count=COUNT, period=period)
        after = fit_with(PUSH, chi2=self.chi2[SEARCH_BANDWIDTH][0], bandwidth=bandwidth)
        return SearchOutcome(after, False, False, "effect_found", after, (selected(PUSH),), (), data)

    def run(self, outcome: SearchOutcome | None = None) -> SearchOutcome:
        """Search for a delay."""
        return with_input_timing(outcome or self.outcome(), runs("a"), CRITERIA, self.lines.append)


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Script:
    """Return a script in which a delay passes all tests."""
    return Script(monkeypatch)


def test_a_delay_that_the_observer_hides_is_added(script: Script) -> None:
    """It removes 3 % of the error with the observer of the search and 10 % with the wider one."""
    outcome = script.run()
    assert [s.effect.label for s in outcome.selected] == ["constant_force@x", "input_delay@drives"]
    assert outcome.after.bandwidth == SEARCH_BANDWIDTH
    assert outcome.selected[1].gain == pytest.approx(3.0)
    assert outcome.selected[1].rivals == ()
    assert "300 rad/s" in script.lines[-1]


def test_delays_and_lags_of_the_library() -> None:
    """Not what changes the current slowly, such as heat."""
    timing = {name for name, effect in EFFECTS.items() if input_timing.is_timing(effect)}
    assert timing == {"input_delay", "electrical_lag"}


def test_an_equally_good_lag_is_its_rival(script: Script) -> None:
    script.lag = 9.01
    assert script.run().selected[1].rivals == ("electrical_lag@motor",)


@pytest.mark.parametrize(
    ("lag", "selected_one", "rivals"),
    [
        (9.01, "input_delay@drives", ("electrical_lag@motor",)),
        (9.5, "input_delay@drives", ()),
        (7.9, "electrical_lag@motor", ()),
        (
            8.5,
            "electrical_lag@motor",
            ("input_delay@drives",),
        ),  # it removes two thirds as much, and most is left
    ],
)
def test_complete_fits_decide_between_a_delay_and_a_lag(
    script: Script, lag: float, selected_one: str, rivals: tuple[str, ...]
) -> None:
    """Few iterations had left the lag at 9.9, or at 8.99."""
    for incomplete in (9.9, 8.99):
        script.lag = incomplete
        script.converged = {"electrical_lag@motor": fit_with(PUSH, LAG, chi2=lag, bandwidth=WIDE)}
        chosen = script.run().selected[1]
        assert (chosen.effect.label, chosen.rivals) == (selected_one, rivals)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"chi2": {SEARCH_BANDWIDTH: (100.0, 90.0), WIDE: (10.0, 9.0)}}, "a slow error"),
        ({"variance": 420.0}, "no more than chance"),  # the gain is 10,000, 24 times 418
        ({"confirmed": 0.29}, "not confirmed"),
        ({"fault": "diverges"}, "diverges"),
        ({"held_out_gain": 0.0}, "held-out runs"),
    ],
)
def test_a_delay_that_fails_a_test_is_only_considered(
    script: Script, changes: dict[str, Any], reason: str
) -> None:
    for name, value in changes.items():
        setattr(script, name, value)
    outcome = script.run()
    assert len(outcome.selected) == 1
    assert [entry.effect.label for entry in outcome.considered] == ["input_delay@drives"]
    assert reason in outcome.considered[0].reason


def test_it_is_not_tried_where_nothing_is_hidden(script: Script) -> None:
    """Not without effects or without a remaining error, with a narrow observer, slow sampling or noisy sensors."""
    outcome = script.outcome()
    for other in (
        outcome._replace(selected=()),
        outcome._replace(explained=True),
        script.outcome(bandwidth=30.0),
        script.outcome(period=5e-3),
        outcome._replace(
            after=dataclasses.replace(outcome.after, machine=outcome.after.machine.with_effects(LAG))
        ),
    ):
        assert script.run(other) is other
    script.chi2[WIDE] = (100.0, 90.0)  # as likely as the observer of the search
    assert script.run(outcome) is outcome
    assert script.lines == []
