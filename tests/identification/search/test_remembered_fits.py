"""Tests of what a search of effects remembers, so that nothing is fitted or screened twice: real fits."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import default_free_parameters, fit
from hframe_gym.identification.budget import Budget
from hframe_gym.identification.fit.estimation import Fit
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, SIMULATION
from hframe_gym.identification.search.forward_selection import EffectSearch
from hframe_gym.machine import AppliedEffect
from tests.identification.scripted_fits import AXIS, CRITERIA, DRAG, STRIBECK, selected
from tests.identification.single_axis import axis_runs

PUSH, OFFSET = EFFECTS["constant_force"].at("x", size=2.0), EFFECTS["voltage_offset"].at("motor", V0=0.1)


class PushedAxis:
    """Search in runs of an axis with a constant force, and what it does, as it tells the budget."""

    def __init__(self) -> None:
        self.data = axis_runs(AXIS.with_effects(PUSH), rows=300, volts=6.0)
        self.search = EffectSearch(self.data, AXIS, CRITERIA, lambda line: None)
        self.doing: list[str] = []
        self.budget = Budget(progress=lambda doing, *seconds: self.doing.append(doing))

    def fitted(self, *effects: AppliedEffect, bandwidth: float = SEARCH_BANDWIDTH) -> Fit:
        """Fit the axis with effects."""
        machine = AXIS.with_effects(*effects)
        return fit(machine, default_free_parameters(machine), self.data, bandwidth, iterations=4)

    def steps(self, function: Callable[[], Any]) -> tuple[Any, list[str]]:
        """Return the result of a function, and what the search told the budget meanwhile."""
        self.doing.clear()
        with self.budget.limiting():
            return function(), [*self.doing]


def test_a_rival_is_compared_once_beside_the_same_machine() -> None:
    """The search settles rivals after each effect and at its end, when comparisons add some."""
    rig = PushedAxis()
    current = rig.fitted(PUSH)

    def settled(fitted: Fit, *rivals: AppliedEffect) -> tuple[list[str], list[str]]:
        push = dataclasses.replace(selected(PUSH), rival_effects=rivals)
        (_, (push,)), steps = rig.steps(lambda: rig.search.settle_rivals(fitted, (push,)))
        return [rival.label for rival in push.rival_effects], steps

    remaining, steps = settled(current, OFFSET, DRAG)
    assert remaining == [OFFSET.label]
    assert steps
    assert settled(current, OFFSET, DRAG) == (remaining, [])
    more, of_another = settled(current, OFFSET, DRAG, STRIBECK)
    assert more == remaining
    again = settled(dataclasses.replace(current), OFFSET, DRAG, STRIBECK)  # another fit
    assert again[0] == remaining
    assert 0 < len(of_another) < len(again[1])


def test_the_most_likely_fit_of_a_machine_is_found_once() -> None:
    """Each effect may have a rival, more are compared later; without an observer, it is the polished fit."""
    rig = PushedAxis()
    current = rig.fitted(PUSH, bandwidth=SIMULATION)
    polished, steps = rig.steps(lambda: rig.search.polished(current))
    assert steps
    push = dataclasses.replace(selected(PUSH), rival_effects=(OFFSET,))
    rig.search.settle_rivals(current, (push,))
    assert rig.search.polished(current) is polished
    assert rig.search.polished(dataclasses.replace(current)) is not polished


def test_a_comparison_of_rivals_finds_the_most_likely_fit_that_is_polished_later() -> None:
    rig = PushedAxis()
    current = rig.fitted(PUSH, bandwidth=SIMULATION)
    push = dataclasses.replace(selected(PUSH), rival_effects=(OFFSET,))
    rig.search.settle_rivals(current, (push,))
    assert rig.steps(lambda: rig.search.polished(current))[1] == []


@pytest.mark.parametrize(("effects", "screened"), [((PUSH,), 0), ((PUSH, DRAG), 1)])
def test_selected_effects_are_compared_with_the_candidates_of_the_last_step(
    effects: tuple[AppliedEffect, ...], screened: int
) -> None:
    """A refit of the same effects resembles the same candidates; beside another, they are screened again."""
    rig = PushedAxis()
    current = rig.fitted(PUSH)
    for count in (1, 0):  # the same fit has the same candidates
        _, steps = rig.steps(lambda: rig.search._passing(current, 0.1))
        assert sum("screening" in step for step in steps) == count
    refitted = rig.fitted(*effects)
    ((push,), steps) = rig.steps(lambda: rig.search.with_indistinguishable(refitted, (selected(PUSH),)))
    assert push.rivals[0] == OFFSET.label
    assert sum("screening" in step for step in steps) == screened
