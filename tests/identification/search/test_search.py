"""Tests of the verdict with scripted fits: each threshold from both sides. Nothing is simulated."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.effects.smooth_table import KNOTS, definition
from hframe_gym.identification import Fit, SelectedEffect, SelectionCriteria
from hframe_gym.identification.budget import Budget, BudgetEndedError, spend, stage_ends
from hframe_gym.identification.search import model_search
from hframe_gym.identification.search import search_effects as search
from hframe_gym.identification.search.outcome import SearchOutcome
from hframe_gym.machine import AppliedEffect, Machine
from hframe_gym.preparation.dataset import RunObserver
from tests.identification.scripted_fits import (
    AXIS,
    CRITERIA,
    PUSH,
    SPRING,
    fit_with,
    runs,
    selected,
)


class ScriptedSearch:
    """Replaces what the search calls: fits have chi-squared as `chi2_of` gives by effects' labels."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.before, self.after = 10.0, 10.0
        self.effects: tuple[SelectedEffect, ...] = ()
        self.tables: list[tuple[Fit, tuple[SelectedEffect, ...]]] = []
        self.pruned: tuple[SelectedEffect, ...] | None = None
        self.wide = 10.0  # chi-squared at the bandwidth of the search
        self.with_effects = 10.0  # the same of a fit with effects
        self.simulated_tables = 10.0  # chi-squared of a simulation with a table
        self.suspect: str | None = None
        self.of_all_runs = 10.0  # chi-squared of machines without effects on all four runs
        self.differences: Any = None
        self.bandwidth = 0.0  # of the observer that the machine without effects needs
        self.observers: dict[str, RunObserver] = {}  # of the runs that need another one than the others
        # Chi-squared of a fit in simulation that replaces one with an observer.
        self.simulated: float | None = None
        self.moved: tuple[AppliedEffect, ...] = ()  # effects of that fit, if their values differ
        self.ends_in = ""  # stage in which the budget ends
        self.budget = Budget()
        self.while_testing: Callable[[], None] = lambda: None
        self.compared: list[tuple[str, ...]] = []  # labels of the effects whose rivals were looked for
        script = self

        class FakeEffectSearch:
            def __init__(self, data: Any, plain: Machine, criteria: SelectionCriteria, log: Any) -> None:
                self.data, self.considered, self.reached = data, dict[str, Any](), None

            def run(self, current: Fit, chosen: tuple[SelectedEffect, ...] = ()) -> Any:
                found = script.effects or chosen
                bandwidth = script.bandwidth if script.simulated is None else 30.0
                return fit_with(*(s.effect for s in found), chi2=script.after, bandwidth=bandwidth), found

            def start_with(self, current: Fit, known: tuple[SelectedEffect, ...]) -> Any:
                return self.run(current, known)

            def with_indistinguishable(self, current: Fit, chosen: tuple[SelectedEffect, ...]) -> Any:
                script.end("rivals")
                script.compared.append(tuple(s.effect.label for s in chosen))
                return chosen

            def settle_rivals(self, current: Fit, chosen: tuple[SelectedEffect, ...]) -> Any:
                return current, chosen

            def polished(self, current: Fit) -> Fit:
                return current

            def prune(self, current: Fit, chosen: tuple[SelectedEffect, ...]) -> Any:
                script.while_testing()
                return current, chosen if script.pruned is None or current.bandwidth else script.pruned

        replaced: Mapping[str, Callable[..., Any]] = {
            "fit": lambda machine, free, data, bandwidth: fit_with(chi2=script.before),
            "continue_fit": lambda fitted, data, bandwidth: fit_with(
                *fitted.machine.effects, chi2=script.with_effects if fitted.machine.effects else script.before
            ),
            "polish": lambda fitted, data: fitted,
            "converge": lambda fitted, data, thorough: fitted,
            "fit_with_model_error": lambda fitted, data: dataclasses.replace(
                fitted, bandwidth=script.bandwidth
            ),
            "refine_dataset": lambda data, machine: data,
            # The simulation has no say: it is as bad with the effects as without.
            "prediction_cost": lambda machine, data, bandwidth: (
                data.count
                * (
                    script.simulated_tables
                    if TABLE in machine.effects and not bandwidth
                    else script.wide
                    if bandwidth and machine.effects
                    else script.of_all_runs
                    if len(data.runs) == 4
                    else 10.0
                )
            ),
            "refined_in_simulation": lambda fitted, data: (
                fitted
                if script.simulated is None
                else fit_with(*(script.moved or fitted.machine.effects), chi2=script.simulated)
            ),
            "fit_run_by_run": lambda fitted, data: dataclasses.replace(fitted, observers=script.observers),
            "add_tables": lambda start, known, data, criteria, max_tables, log: (
                script.end("tables") or (script.tables.pop(0) if script.tables else (start, known))
            ),
            "fit_with_moved_knots": lambda fitted, data, criteria: fitted,
            "contradicting_run": lambda fitted, data: script.end("runs") or script.suspect,
            "find_run_differences": lambda fitted, data, criteria: script.differences,
            "without_effect": lambda fitted, label, data, plain: fit_with(
                *(e for e in fitted.machine.effects if e.label != label), chi2=script.before
            ),
            "best_by_run": lambda fitted, data: script.differences,
            "EffectSearch": FakeEffectSearch,
        }
        for module in (search, model_search):
            for name, function in replaced.items():
                if hasattr(module, name):
                    monkeypatch.setattr(module, name, function)

    def end(self, stage: str) -> None:
        """Let the budget end if this is the stage in which it does."""
        if self.ends_in == stage:
            self.ends_in = ""
            raise BudgetEndedError

    def run(self, known: tuple[SelectedEffect, ...] = ()) -> SearchOutcome:
        """Search in four runs."""
        return search.search_effects(
            AXIS, runs("abcd"), CRITERIA, lambda line: None, known=known, budget=self.budget
        )


@pytest.fixture
def scripted_search(monkeypatch: pytest.MonkeyPatch) -> ScriptedSearch:
    """Return a script of fits, effects and tables."""
    return ScriptedSearch(monkeypatch)


def test_without_effects_a_machine_that_explains_the_data_is_right(scripted_search: ScriptedSearch) -> None:
    scripted_search.before = scripted_search.after = 1.2
    outcome = scripted_search.run()
    assert (outcome.verdict, outcome.before_explains, outcome.after) == ("no_effect", True, outcome.before)


@pytest.mark.parametrize(
    ("chi2", "simulated", "examined"),
    [(1.2, 1.4, True), (1.2, 9.0, False), (3.0, 9.0, True), (3.0, 1.4, True)],
)
def test_effects_are_examined_in_simulation_unless_it_is_worse(
    scripted_search: ScriptedSearch, chi2: float, simulated: float, examined: bool
) -> None:
    """Where small errors grow without limit, simulation says nothing about effects an observer confirms."""
    scripted_search.effects, scripted_search.after, scripted_search.simulated = (
        (selected(PUSH),),
        chi2,
        simulated,
    )
    scripted_search.pruned = ()
    outcome = scripted_search.run()
    assert (outcome.selected == ()) == examined


@pytest.mark.parametrize("ends_in", ["", "rivals", "tables"])
def test_effects_that_fail_a_test_are_not_named_wherever_the_budget_ends(
    scripted_search: ScriptedSearch, ends_in: str
) -> None:
    """The spring passes the tests with an observer, but not those in simulation."""
    scripted_search.effects = (selected(PUSH), selected(SPRING))
    scripted_search.after = scripted_search.with_effects = scripted_search.wide = 2.0
    scripted_search.simulated, scripted_search.pruned = 9.0, (selected(PUSH),)
    scripted_search.ends_in = ends_in
    outcome = scripted_search.run()
    assert bool(outcome.unfinished) == bool(ends_in)
    assert [s.effect for s in outcome.selected] == [PUSH]


@pytest.mark.parametrize(
    ("chi2", "pruned", "compared"),
    [
        (9.0, None, False),  # most of the error is left: not named
        (9.0, (), False),  # nothing passes the tests
        (2.0, None, True),
        (1.2, None, True),
    ],
)
def test_rivals_are_compared_where_effects_are_named(
    scripted_search: ScriptedSearch, chi2: float, pruned: tuple[()] | None, compared: bool
) -> None:
    """On the log of a geared motor, rivals of 5 effects took half of the budget; none of these was named."""
    scripted_search.effects, scripted_search.pruned = (selected(PUSH),), pruned
    scripted_search.after = scripted_search.with_effects = scripted_search.wide = chi2
    outcome = scripted_search.run()
    assert bool(scripted_search.compared) == compared
    assert bool(outcome.selected) == compared


def test_a_search_that_ends_before_it_begins_tests_the_effects_of_the_one_before(
    scripted_search: ScriptedSearch,
) -> None:
    """A search with another number of voltages between rows began after its time, and lost two effects."""
    scripted_search.after = scripted_search.with_effects = scripted_search.wide = 1.0
    scripted_search.ends_in = "runs"
    outcome = scripted_search.run(known=(selected(PUSH), selected(SPRING)))
    assert outcome.unfinished
    assert [s.effect for s in outcome.selected] == [PUSH, SPRING]


def test_tests_go_on_where_the_time_for_the_search_ends_meanwhile(scripted_search: ScriptedSearch) -> None:
    """They began again, did not end in the time that was left, and three right effects were lost."""
    ends, spent, begun = stage_ends(AXIS), [0.0], list[float]()

    def while_testing() -> None:
        spent[0] = 0.5 * (ends.search + ends.tests)
        begun.append(spent[0])
        spend()

    scripted_search.budget = Budget(1.0, clock=lambda: spent[0])
    scripted_search.while_testing = while_testing
    scripted_search.effects = (selected(PUSH), selected(SPRING))
    scripted_search.after = scripted_search.with_effects = scripted_search.wide = 1.0
    outcome = scripted_search.run()
    assert [s.effect for s in outcome.selected] == [PUSH, SPRING]
    assert len(begun) == 1


@pytest.mark.parametrize(("chi2", "expected"), [(1.4, {"a": (3.0, 1.0)}), (1.6, {})])
def test_a_machine_that_explains_the_data_is_fitted_run_by_run(
    scripted_search: ScriptedSearch, chi2: float, expected: dict[str, tuple[float, float]]
) -> None:
    scripted_search.before, scripted_search.after, scripted_search.observers = (
        chi2,
        chi2,
        {"a": RunObserver(3.0)},
    )
    assert scripted_search.run().after.observers == expected


def test_held_out_runs_judge_with_the_observer_of_the_search(scripted_search: ScriptedSearch) -> None:
    """Also where the final fit is in simulation, which shows chance gains of effects the observer denies."""
    scripted_search.effects, scripted_search.after = (selected(PUSH),), 1.2
    scripted_search.simulated = 1.1
    outcome = scripted_search.run()
    assert (outcome.after.bandwidth, outcome.bandwidth) == (0.0, 30.0)


@pytest.mark.parametrize(("speed", "removed"), [(999.0, True), (980.0, False)])
def test_an_effect_that_the_final_fit_moves_to_a_limit_is_removed(
    scripted_search: ScriptedSearch, speed: float, removed: bool
) -> None:
    brake = EFFECTS["eddy_brake"].at("x", c=1.0, v0=0.5)
    scripted_search.effects, scripted_search.after = (selected(brake),), 1.2
    scripted_search.simulated, scripted_search.moved = 1.1, (EFFECTS["eddy_brake"].at("x", c=1.0, v0=speed),)
    outcome = scripted_search.run()
    assert (outcome.selected == ()) == removed
    assert [c.effect for c in outcome.considered] == [brake] * removed
    assert outcome.verdict == ("unexplained" if removed else "effect_found")


COGGING = EFFECTS["cogging"].at("motor", A=0.8, n=40.0, p=0.5)
TABLE = definition("smooth_force[position of x]").at(
    "x", **{f"{k}{i:02d}": i for k in "kf" for i in range(KNOTS)}
)


@pytest.mark.parametrize(("table", "names"), [(4.9, [TABLE]), (5.1, [SPRING, COGGING])])
def test_effects_of_one_variable_give_way_to_a_table_that_simulates_clearly_better(
    scripted_search: ScriptedSearch, table: float, names: list[AppliedEffect]
) -> None:
    """A spring and cogging explain the data with an observer, but leave ten times the noise in simulation."""
    scripted_search.effects, scripted_search.after = (selected(SPRING), selected(COGGING)), 1.2
    scripted_search.tables = [(fit_with(TABLE, chi2=1.1), (selected(TABLE),))]
    scripted_search.simulated_tables = table
    outcome = scripted_search.run()
    assert (outcome.verdict, [s.effect for s in outcome.selected]) == ("effect_found", names)


WARM_UP = EFFECTS["friction_warm_up"].at("machine", a=0.5, tau=30.0)


def differences(**changes: Any) -> SimpleNamespace:
    """Return runs that differ in the payload."""
    fields = {
        "quantity": SimpleNamespace(name="the payload"),
        "drifts": False,
        "different_run": None,
        "chi2": 1.0,
    }
    return SimpleNamespace(**(fields | changes))


@pytest.mark.parametrize("changes", [{"drifts": True}, {"different_run": "c"}])
def test_effects_are_found_beside_a_drift_or_a_single_run_that_differs(
    scripted_search: ScriptedSearch, changes: dict[str, Any]
) -> None:
    scripted_search.effects = (selected(SPRING),)
    scripted_search.after = scripted_search.with_effects = scripted_search.wide = 2.0
    scripted_search.differences = differences(**changes)
    assert scripted_search.run().verdict == "effect_found"


def test_runs_that_differ_in_a_parameter_have_neither_effects_nor_tables(
    scripted_search: ScriptedSearch,
) -> None:
    scripted_search.effects = (selected(SPRING),)
    scripted_search.after = scripted_search.with_effects = scripted_search.wide = 2.0
    scripted_search.tables = [(fit_with(PUSH, chi2=1.1), (selected(PUSH),))]
    scripted_search.differences = differences()
    outcome = scripted_search.run()
    assert outcome.verdict == "unexplained"
    assert not outcome.selected
    assert len(scripted_search.tables) == 1  # none was tried


def test_only_effects_that_may_differ_by_run_give_way_to_a_parameter_that_does(
    scripted_search: ScriptedSearch,
) -> None:
    """Of a servo, a spring and a friction were lost with a swinging load that was not there."""
    scripted_search.effects = (selected(SPRING), selected(WARM_UP))
    scripted_search.after = scripted_search.with_effects = scripted_search.wide = 2.0
    scripted_search.before = 1.2
    scripted_search.differences = differences(drifts=True)
    outcome = scripted_search.run()
    assert [s.effect for s in outcome.selected] == [SPRING]
    assert [c.effect for c in outcome.considered] == [WARM_UP]


@pytest.mark.parametrize("drifts", [True, False])
def test_a_table_over_time_may_take_the_place_of_an_effect_that_imitates_a_drift(
    scripted_search: ScriptedSearch, drifts: bool
) -> None:
    """A guide that rubs more while cold was `unexplained`: the library's effect warms all of the machine."""
    scripted_search.effects = (selected(WARM_UP),)
    scripted_search.after = scripted_search.with_effects = scripted_search.wide = 5.0
    scripted_search.tables = [(fit_with(TABLE, chi2=1.1), (selected(TABLE),))]
    scripted_search.simulated_tables = 1.2
    scripted_search.differences = differences(drifts=drifts)
    outcome = scripted_search.run()
    assert [c.effect for c in outcome.considered] == [WARM_UP]
    assert [s.effect for s in outcome.selected] == ([TABLE] if drifts else [])


def test_effects_that_explain_the_data_are_found_although_runs_differ(
    scripted_search: ScriptedSearch,
) -> None:
    scripted_search.effects = (selected(SPRING),)
    scripted_search.after = 1.1
    scripted_search.differences = differences()
    assert scripted_search.run().verdict == "effect_found"


def test_a_table_beside_an_effect_must_add_to_it(scripted_search: ScriptedSearch) -> None:
    """The first table explains nothing; the second search, beside the effect, finds none."""
    scripted_search.effects, scripted_search.after = (selected(PUSH),), 3.0
    scripted_search.tables = [(fit_with(chi2=10.0), ()), (fit_with(PUSH, chi2=1.0), (selected(PUSH),))]
    assert scripted_search.run().verdict == "unexplained"
    scripted_search.tables = [
        (fit_with(chi2=10.0), ()),
        (fit_with(PUSH, SPRING, chi2=1.0), (selected(PUSH), selected(SPRING))),
    ]
    outcome = scripted_search.run()
    assert (outcome.verdict, [s.effect for s in outcome.selected]) == ("effect_found", [PUSH, SPRING])
    assert scripted_search.compared == [(PUSH.label, SPRING.label)]  # not before the table


def test_a_suspect_run_is_used_if_the_others_are_not_explained_either(
    scripted_search: ScriptedSearch,
) -> None:
    scripted_search.suspect = "c"
    outcome = scripted_search.run()
    assert (outcome.contradiction, outcome.verdict, len(outcome.data.runs)) == (None, "unexplained", 4)


@pytest.mark.parametrize("confirmed", [True, False])
def test_a_run_is_not_left_out_where_the_budget_ends_and_held_out_runs_contradict_the_others(
    scripted_search: ScriptedSearch, confirmed: bool
) -> None:
    """A log of a motor that warms was called wrong, beside a held-out one that showed the same."""
    scripted_search.suspect, scripted_search.effects = "c", (selected(PUSH),)
    scripted_search.after = scripted_search.wide = 1.2
    scripted_search.ends_in = "rivals"
    outcome = search.search_effects(
        AXIS, runs("abcd"), CRITERIA, lambda line: None, confirmed=lambda outcome: confirmed
    )
    assert outcome.unfinished
    assert outcome.contradiction == ("c" if confirmed else None)
    assert len(outcome.data.runs) == (3 if confirmed else 4)


@pytest.mark.parametrize("confirmed", [True, False])
def test_all_runs_are_used_if_held_out_runs_do_not_confirm_that_one_is_wrong(
    scripted_search: ScriptedSearch, confirmed: bool
) -> None:
    """With the suspect, the error is more than ten times that of the others, 10."""
    scripted_search.suspect, scripted_search.of_all_runs = "c", 101.0
    shown: list[str | None] = []

    def confirms(outcome: SearchOutcome) -> bool:
        shown.append(outcome.contradiction)
        return confirmed

    outcome = search.search_effects(AXIS, runs("abcd"), CRITERIA, lambda line: None, confirmed=confirms)
    assert shown == ["c"]
    assert outcome.contradiction == ("c" if confirmed else None)
    assert len(outcome.data.runs) == (3 if confirmed else 4)
