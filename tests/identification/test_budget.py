"""Tests of a search that ends early: the budget with a clock of its own, and what is left of the search."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.identification import SelectedEffect, default_free_parameters, fit, identify
from hframe_gym.identification.budget import (
    COMPARISON_PART,
    DEFAULT_SECONDS,
    LAST_STAGE_END,
    PLAIN_FIT_PART,
    Budget,
    BudgetEndedError,
    during_tests,
    expect_tests,
    goes_on,
    spend,
    spender,
    stage_ends,
)
from hframe_gym.identification.fit.plain_fit import plain_fit
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.search import checked_search
from hframe_gym.identification.search.model_search import ModelSearch
from hframe_gym.identification.search.outcome import SearchOutcome
from hframe_gym.identification.validate.evaluation import HeldOutTests
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.preparation.session import prepare_session
from tests.identification.scripted_fits import CRITERIA
from tests.identification.single_axis import AXIS, axis_recordings, axis_runs, limited_runs

pytestmark = pytest.mark.unit


class Clock:
    """A clock that advances by one second at each look."""

    def __init__(self) -> None:
        self.seconds = -1.0

    def __call__(self) -> float:
        self.seconds += 1.0
        return self.seconds


def test_the_search_ends_after_its_part_of_the_budget() -> None:
    steps: list[tuple[str, float, float]] = []
    budget = Budget(16.0, clock=Clock(), progress=lambda *step: steps.append(step))
    with budget.limiting(0.5):
        for doing in ("trial fit 1", "", "trial fit 2", ""):
            spend(doing)  # the clock advances at the check and at the report
        with pytest.raises(BudgetEndedError):
            spend()
    assert steps == [
        ("trial fit 1", 2.0, budget.seconds),
        ("trial fit 1", 4.0, budget.seconds),
        ("trial fit 2", 6.0, budget.seconds),
        ("trial fit 2", 8.0, budget.seconds),
    ]
    assert budget.spent >= 8.0
    assert "the budget of 16 s of processor time ended" in budget.reason


def test_outside_a_search_nothing_is_limited() -> None:
    budget = Budget(0.0, clock=Clock())
    spend("a fit")
    with budget.limiting():
        assert budget.searching
        with pytest.raises(BudgetEndedError):
            spender()()
    assert not budget.searching
    spend("a fit")
    spender()()


def test_an_interrupted_search_ends_at_its_next_step() -> None:
    budget = Budget(clock=Clock())
    with budget.limiting():
        spend("screening")
        budget.stop()
        with pytest.raises(BudgetEndedError):
            spend()
    assert budget.doing == "screening"
    assert budget.reason.startswith("interrupted after")


@pytest.mark.parametrize("seconds", [-1.0, math.nan])
def test_a_budget_is_a_number_of_seconds(seconds: float) -> None:
    with pytest.raises(InputError, match="must be a number of seconds of processor time, 0 or more"):
        Budget(seconds)


def test_by_default_an_identification_takes_two_minutes_of_processor_time() -> None:
    """Neither the number of cores nor the length of the session changes this."""
    lines: list[str] = []

    def log(line: str) -> None:
        lines.append(line)
        raise BudgetEndedError  # the identification itself is not of interest

    with pytest.raises(BudgetEndedError):
        identify(limited_runs([3.0, 3.0, 9.0]), AXIS, log=log)
    assert DEFAULT_SECONDS == 120.0
    assert lines == ["3 runs, 4500 rows: at most about 120 s of processor time"]


def test_the_page_states_when_each_stage_ends() -> None:
    page = (Path(__file__).parents[2] / "docs" / "identification_steps.md").read_text(encoding="utf-8")
    cases = [
        stage_ends(m, in_part=in_part)
        for m in (BUILTIN_MACHINES["hframe"](), AXIS)
        for in_part in (False, True)
    ]
    rows = {
        "search": [p.search for p in cases],
        "tests of what a search that ended early found": [p.tests for p in cases],
        "last fit of the machine without effects, where the tests took all of their time": [
            p.last_fit for p in cases
        ],
        "fit of what was found to all rows": [p.all_rows if k % 2 else None for k, p in enumerate(cases)],
        "description of the remaining error": [None, None, LAST_STAGE_END, LAST_STAGE_END],
    }
    for stage, parts in rows.items():
        columns = ("" if part is None else f" {100 * part:.0f} %" for part in parts)
        assert f"| {stage} |{' |'.join(columns)} |" in page
    assert f"begins after {100 * COMPARISON_PART:.0f} % of the budget" in page


def test_a_stage_has_a_budget_of_its_own() -> None:
    """It ends with its part of the budget or after the longest time; interrupting the search does not."""
    spent = [0.0]
    budget = Budget(100.0, clock=lambda: spent[0])
    spent[0] = 40.0
    budget.stop()
    assert budget.until(0.5).seconds == pytest.approx(10.0)
    assert budget.until(0.5, 3.0).seconds == pytest.approx(3.0)
    assert budget.until(0.3).seconds == 0.0
    assert budget.until(0.5).has_time(1.0)


def test_a_stage_may_end_after_another_part_of_the_budget() -> None:
    budget = Budget(100.0, clock=Clock())
    with budget.limiting(0.02):
        spend("a search in a part of the rows")
        with pytest.raises(BudgetEndedError):
            spend()
    assert budget.has_time(0.5)
    with budget.limiting():
        spend("a search in all rows")
    assert not budget.has_time(0.05)
    budget.stop()
    assert not budget.has_time(1.0)


@pytest.mark.parametrize(("seconds", "end"), [(1.0, 0.75), (2.5, 0.65), (9.0, 0.4)], ids=str)
def test_a_search_ends_early_enough_for_the_tests_of_what_it_found(seconds: float, end: float) -> None:
    """Tests end at 90 % of 10 s; half of the budget is kept for them at most."""
    spent = [0.0]
    budget = Budget(10.0, clock=lambda: spent[0])
    with budget.limiting(0.75, tests=0.9):
        expect_tests(seconds)
        spent[0] = 10.0 * end - 0.01
        spend()
        spent[0] = 10.0 * end + 0.01
        with pytest.raises(BudgetEndedError):
            spend()
    with budget.limiting(0.9):
        spend()


@pytest.mark.parametrize(("tests", "end"), [(0.9, 0.9), (math.inf, 0.75)], ids=["kept", "none kept"])
def test_tests_that_have_begun_use_the_time_that_is_kept_for_them(tests: float, end: float) -> None:
    """After them, the search has ended."""
    spent = [0.0]
    budget = Budget(10.0, clock=lambda: spent[0])
    with budget.limiting(0.75, tests=tests):
        expect_tests(2.5)
        with during_tests():
            spent[0] = 10.0 * end - 0.01
            spend()
            spent[0] = 10.0 * end + 0.01
            with pytest.raises(BudgetEndedError):
                spend()
        spent[0] = 7.6
        with pytest.raises(BudgetEndedError):
            spend()


def test_without_time_to_search_the_machine_has_no_effects() -> None:
    """The drives' current is limited to 5 A, which no refit explains: the file predicts better."""
    lines: list[str] = []
    result = identify(limited_runs([3.0, 3.0, 9.0, 9.0, 3.0]), AXIS, log=lines.append, budget=0.0)
    assert (result.verdict, result.effects) == ("unexplained", ())
    assert result.unfinished is not None
    assert result.as_json()["unfinished"] == {
        "stage": result.unfinished.stage,
        "reason": "the budget of 0 s of processor time ended",
    }
    assert result.before.machine.parameters != AXIS.parameters
    assert result.after.machine.parameters == AXIS.parameters
    assert not any("reduces chi-squared" in line for line in lines)


def test_a_budget_that_does_not_end_changes_nothing_and_one_that_ends_keeps_what_was_found() -> None:
    """The clock counts the steps of the search, so that the test does not depend on the processor."""
    runs = limited_runs([3.0, 9.0, 9.0, 3.0])
    clock, steps = Clock(), []
    complete = identify(
        runs, AXIS, budget=Budget(1e9, clock=clock, progress=lambda *step: steps.append(step))
    )
    unlimited = identify(runs, AXIS, budget=math.inf)
    assert complete.unfinished is None
    assert complete.as_json() | {"seconds": 0} == unlimited.as_json() | {"seconds": 0}
    assert [s.effect.label for s in complete.effects] == ["current_limit@motor"]
    last = next(
        step for step in steps if step[0] in ("comparing rivals", "testing each effect beside the others")
    )
    early = identify(
        runs,
        AXIS,
        budget=Budget((last[1] + 0.5) / stage_ends(AXIS).search, clock=Clock(), progress=lambda *step: None),
    )
    assert early.unfinished is not None
    assert [s.effect.label for s in early.effects] == ["current_limit@motor"]
    assert early.verdict == "effect_found"


def test_what_there_is_no_time_to_test_is_not_named() -> None:
    """The time for search and tests ends after an effect has been selected."""
    stages: list[str] = []

    def spent() -> float:
        return stage_ends(AXIS).tests if "comparing rivals" in stages else 0.0

    budget = Budget(1.0, clock=spent, progress=lambda doing, *time: stages.append(doing))
    result = identify(limited_runs([3.0, 3.0, 9.0]), AXIS, budget=budget)
    assert result.effects == ()
    (entry,) = (entry for entry in result.considered if entry.effect.label == "current_limit@motor")
    assert entry.reason == "was not tested before the budget ended"


@pytest.mark.parametrize(("part", "told"), [(stage_ends(AXIS).search, True), (COMPARISON_PART, False)])
def test_a_search_that_ends_early_leaves_time_to_compare_the_runs(part: float, told: bool) -> None:
    """The drive has another gain in each run, which no effect of the library explains."""
    stages: list[str] = []
    budget = Budget(
        1.0,
        clock=lambda: part if any("screening" in stage for stage in stages) else 0.0,
        progress=lambda doing, *time: stages.append(doing),
    )
    runs = [
        dataclasses.replace(run, inputs=run.inputs / gain)
        for run, gain in zip(limited_runs([2.0] * 5), (1.0, 0.8, 1.1, 0.7, 0.9), strict=True)
    ]
    result = identify(runs, AXIS, budget=budget)
    assert result.unfinished is not None
    assert any("The runs differ" in warning for warning in result.run_warnings) == told


def searched_for_drag() -> ModelSearch:
    """Return a search that has found quadratic drag, with the rival Tustin friction, and tested nothing."""
    data = axis_runs(AXIS.with_effects(EFFECTS["quadratic_drag"].at("x", c=60.0)), rows=500, volts=6.0)
    search = ModelSearch(AXIS, data, CRITERIA, lambda line: None)
    (drag,) = search.selection[1]
    assert (drag.effect.label, drag.rivals) == ("quadratic_drag@x", ("tustin_friction@x",))
    return search


@pytest.mark.parametrize("remaining", [True, False])
def test_what_was_found_is_compared_with_other_effects_in_the_remaining_time(remaining: bool) -> None:
    """A name without rivals would say that nothing else is possible; tests and last fits come first."""
    spent = [0.0]
    tests = Budget(1.0, clock=lambda: spent[0])

    def at_last_fit() -> float:
        spent[0] = 0.0 if remaining else tests.seconds
        return 0.0

    last_fit = Budget(clock=at_last_fit)
    spent[0] = 0.0  # the budget has asked its clock
    (found,) = searched_for_drag().finished_early(tests, last_fit).selected
    assert found.effect.label == "quadratic_drag@x"
    assert ("stribeck_friction@x" in found.rivals) == remaining


def test_the_judgment_of_a_search_that_ended_early_is_part_of_its_tests() -> None:
    """Where the time for the tests ends before the last look at it, in the judgment, nothing is named."""
    looks, of_tests = Clock(), list[float]()

    def at_last_fit() -> float:
        of_tests.append(looks.seconds)
        return 0.0

    last_fit = Budget(clock=at_last_fit)
    of_tests.clear()  # the budget has asked its clock
    assert searched_for_drag().finished_early(Budget(clock=looks), last_fit).selected
    outcome = searched_for_drag().finished_early(Budget(of_tests[0], clock=Clock()), Budget())
    assert outcome.selected == ()
    assert outcome.after is outcome.before
    assert [entry.reason for entry in outcome.considered] == ["was not tested before the budget ended"]


@pytest.mark.parametrize(
    ("seconds", "unfinished"), [(0.5, ""), (0.95, "searching for a delay or lag of the drives")]
)
def test_the_search_for_a_delay_of_the_drives_ends_with_the_budget(seconds: float, unfinished: str) -> None:
    """The last stage ends at 90 %."""
    push, spent, lines = EFFECTS["constant_force"].at("x", size=0.5), [0.0], list[str]()
    delay = EFFECTS["input_delay"].at("drives", d=2e-3)
    pushed, data = AXIS.with_effects(push), axis_runs(AXIS.with_effects(push, delay), rows=300, volts=6.0)
    after = fit(pushed, default_free_parameters(pushed), data, SEARCH_BANDWIDTH)
    selected = (SelectedEffect(push, 1.0, AXIS),)
    outcome = SearchOutcome(after, False, False, "effect_found", after, selected, (), data)
    budget = Budget(1.0, clock=lambda: spent[0])
    spent[0] = seconds
    found = checked_search._with_input_timing(outcome, data, CRITERIA, lines.append, budget)
    assert found.unfinished == unfinished
    assert bool(lines) == (not unfinished)  # a delay was searched for


def test_each_iteration_of_a_fit_asks_the_budget() -> None:
    """A fit that needs several iterations ends within a budget of one look at the clock."""
    data = axis_runs(AXIS, rows=500, volts=3.0)
    free = default_free_parameters(AXIS)
    far = np.ones(len(free))  # each parameter is off by the standard deviation of its prior
    steps: list[str] = []
    with Budget(clock=Clock(), progress=lambda doing, *time: steps.append(doing)).limiting():
        fit(AXIS, free, data, 60.0, theta=far)
    assert len(steps) > 1
    with Budget(1.0, clock=Clock()).limiting(), pytest.raises(BudgetEndedError):
        fit(AXIS, free, data, 60.0, theta=far)


def test_a_stage_that_must_deliver_ends_its_fits_instead_of_unwinding() -> None:
    spent = [0.0]
    budget = Budget(100.0, clock=lambda: spent[0])
    with budget.limiting(0.5, delivers=True):
        spent[0] = 40.0
        assert goes_on()
        spent[0] = 60.0
        assert not goes_on()
        spend("another trial")
        spender()()
    with budget.limiting(0.5), pytest.raises(BudgetEndedError):
        goes_on()
    assert goes_on()


def test_a_plain_fit_without_time_is_delivered_and_says_so() -> None:
    """Its clock exceeds the budget at once: one iteration of one fit is left, which is better than no fit."""
    data = axis_runs(AXIS, rows=1000, volts=6.0)
    complete = plain_fit(AXIS, data)
    hurried = plain_fit(AXIS, data, Budget(1.0, clock=Clock()))
    assert complete is not None
    assert hurried is not None
    assert complete.seconds is None
    assert hurried.seconds is not None
    assert hurried.seconds > PLAIN_FIT_PART
    assert complete.simulated.cost <= hurried.simulated.cost < math.inf
    assert hurried.terms == ()


def test_what_follows_the_last_stage_lets_the_stages_end_earlier() -> None:
    """A tenth of the budget is always left for it, and half at most; a later estimate replaces the first."""
    spent = [0.0]
    budget = Budget(100.0, clock=lambda: spent[0])
    budget.reserve(8.0)
    assert budget.until(LAST_STAGE_END).seconds == pytest.approx(90.0)
    budget.reserve(40.0)
    assert budget.until(LAST_STAGE_END).seconds == pytest.approx(60.0)
    assert budget.until(0.45).seconds == pytest.approx(30.0)
    budget.reserve(1000.0)
    assert budget.until(LAST_STAGE_END).seconds == pytest.approx(50.0)
    budget.reserve(20.0)
    assert budget.until(LAST_STAGE_END).seconds == pytest.approx(80.0)
    spent[0] = 81.0
    assert not budget.has_time(LAST_STAGE_END)


def test_a_budget_counts_what_comes_before_and_after_the_identification() -> None:
    budget = Budget(20.0, spent=4.0, afterwards=5.0, clock=lambda: 7.0)
    assert budget.spent == 4.0
    assert budget.until(LAST_STAGE_END).seconds == pytest.approx(15.0 - 4.0)
    budget.reserve(1.0)
    assert budget.until(LAST_STAGE_END).seconds == pytest.approx(14.0 - 4.0)


def test_no_machine_is_evaluated_twice() -> None:
    """Its name does not matter."""
    session = prepare_session(axis_recordings(AXIS, rows=200, volts=6.0), AXIS, lambda line: None)
    fitted, held_out = session.data.with_runs(["run_0"]), session.data.with_runs(["run_1", "run_2"])
    tests = HeldOutTests(session, CRITERIA)
    first = tests.of(held_out).errors(AXIS, fitted)
    again = tests.of(held_out).errors(AXIS.replace(name="other"), fitted, "again")
    assert again.machine.name == "again"
    assert again.errors is first.errors
    heavy = AXIS.replace({"x.mass": 2.0 * AXIS.coordinates[0].mass})
    assert tests.of(held_out).errors(heavy, fitted).errors is not first.errors


class ReservingBudget(Budget):
    """A budget that tells when time was reserved."""

    def __init__(self, seconds: float) -> None:
        self.reservations: list[float] = []
        super().__init__(seconds)

    def reserve(self, seconds: float) -> None:
        """Reserve time, and write down how much."""
        self.reservations.append(seconds)
        super().reserve(seconds)


@pytest.mark.parametrize(("rows", "known"), [(20_010, True), (1000, False)])
def test_before_a_search_known_machines_are_evaluated_if_a_held_out_run_is_long(
    rows: int, known: bool
) -> None:
    """The time that this takes is reserved for what follows the search."""
    truth = AXIS.replace({"x.mass": 2.0 * AXIS.coordinates[0].mass})
    *short, _ = axis_recordings(truth, rows=1000, volts=6.0)
    *_, held_out = axis_recordings(truth, rows=rows, volts=2.0)
    budget, before_search = ReservingBudget(0.0), list[float]()

    def log(line: str) -> None:
        if line.startswith("refitted machine"):
            before_search[:] = before_search or budget.reservations

    identify([*short, held_out], AXIS, held_out=[held_out.name], budget=budget, log=log)
    assert (max(before_search) > 0.0) == known


@pytest.mark.parametrize(("seconds", "part"), [(0.0, 1.0), (10.0, 0.25), (60.0, 0.5), (math.inf, 1.0)])
def test_a_smaller_budget_fits_fewer_rows_of_a_long_session(seconds: float, part: float) -> None:
    assert Budget(seconds).session_part == part
