"""Strategies that propose effects: one function that registers itself is all that the search needs."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.identification import STRATEGIES, Candidate, SearchState, default_free_parameters, fit
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.propose.candidates import candidates
from hframe_gym.identification.propose.trial_fits import screened_fit
from hframe_gym.machine import Machine
from tests.identification.single_axis import AXIS, axis_runs

PERIOD = 0.0137  # m
FRICTION = EFFECTS["position_friction"]
RIG = AXIS.with_effects(FRICTION.at("x", A=0.4, L=PERIOD, p=0.3))


@pytest.fixture(scope="module")
def state() -> SearchState:
    """Return what the search knows of an axis with friction that repeats over the position."""
    data = axis_runs(RIG, rows=2000, volts=5.0)
    return SearchState.of(fit(AXIS, default_free_parameters(AXIS), data, SEARCH_BANDWIDTH), data)


@pytest.fixture
def known_period() -> Iterator[None]:
    """Register a strategy that knows the period of a rail, and proposes nonsense too."""

    @STRATEGIES.register("rail")
    def rail(state: SearchState) -> Iterator[Candidate]:
        for site in state.sites(FRICTION):
            yield state.candidate(FRICTION, site, {"L": PERIOD})
            yield state.candidate(FRICTION, site, {"L": 1e3 * state.sizes(FRICTION, site)["position"]})

    yield
    STRATEGIES.unregister("rail")


def test_the_search_ranks_what_a_strategy_proposes(state: SearchState, known_period: None) -> None:
    """The known period comes first; a period longer than the travel is left out."""
    proposed = [candidate for candidate in candidates(state) if candidate.effect is FRICTION]
    lengths = [candidate.columns[0]["L"] for candidate in proposed]
    assert PERIOD in lengths
    assert max(lengths) <= state.sizes(FRICTION, "x")["position"]
    assert {candidate.site for candidate in proposed} == {"x"}
    current = fit(AXIS, default_free_parameters(AXIS), state.data, SEARCH_BANDWIDTH)
    best = screened_fit(current, state.data).screening.ranked()[0]
    assert best.candidate.columns[0]["L"] == PERIOD


@pytest.mark.parametrize("proposed", [None, [("position_friction", "x", {"L": PERIOD})]])
def test_a_strategy_that_proposes_something_else_is_named(state: SearchState, proposed: Any) -> None:
    STRATEGIES.register("rail")(lambda state: proposed)
    try:
        with pytest.raises(TypeError, match=r"strategy rail: proposes .*; it must yield state\.candidate"):
            candidates(state)
    finally:
        STRATEGIES.unregister("rail")


@pytest.mark.parametrize(
    ("site", "period", "message"),
    [
        ("z", PERIOD, r"strategy rail: position_friction cannot act at 'z'; its sites are x\."),
        ("x", np.nan, r"strategy rail: position_friction@x starts from L = nan, which must be finite"),
    ],
)
@pytest.mark.parametrize("direct", [False, True])
def test_a_strategy_that_proposes_an_impossible_candidate_is_named(
    site: str, period: float, message: str, direct: bool, state: SearchState
) -> None:
    def rail(state: SearchState) -> Iterator[Candidate]:
        if direct:
            yield Candidate(FRICTION, site, ({"A": 1.0, "L": period, "p": 0.0},), {})
        else:
            yield state.candidate(FRICTION, site, {"L": period})

    STRATEGIES.register("rail")(rail)
    try:
        with pytest.raises(InputError, match=message):
            candidates(state)
    finally:
        STRATEGIES.unregister("rail")


def test_nothing_is_proposed_that_the_machine_has(state: SearchState) -> None:
    """Nor what a refit can represent, or what replaces a part of the model."""
    assert state.sites(FRICTION) == ("x",)
    assert SearchState(RIG, state.data, state.scales, state.missing_force).sites(FRICTION) == ()
    assert state.sites(EFFECTS["presliding"]) == ()
    assert all(state.sites(effect) == () for effect in EFFECTS.values() if effect.refitted)


@pytest.mark.parametrize(("band", "sites"), [("drives", ("motor1", "motor2")), ("motor1", ()), ("", ())])
def test_a_gain_is_proposed_before_a_dead_band_that_all_drives_share(
    hframe: Machine, state: SearchState, band: str, sites: tuple[str, ...]
) -> None:
    """Otherwise it is a torque constant, and another dead band at one of the drives."""
    banded = hframe.with_effects(*([EFFECTS["dead_band"].at(band, Vd=0.2, drop=1.0)] if band else []))
    of_stage = dataclasses.replace(state, machine=banded)
    assert of_stage.sites(EFFECTS["gain_mismatch"]) == sites


@pytest.mark.parametrize("values", [{}, {"L": 0.01, "A": 0.1}])
def test_starting_values_are_those_of_the_shape(state: SearchState, values: dict[str, float]) -> None:
    """The amplitude follows from the linearized residual."""
    with pytest.raises(InputError, match="position_friction starts from L, not from"):
        state.candidate(FRICTION, "x", values)


def test_amplitude_and_phase_are_added(state: SearchState) -> None:
    """A sine and a cosine of typical size."""
    sine, cosine = state.candidate(FRICTION, "x", {"L": PERIOD}).columns
    assert sine["L"] == cosine["L"] == PERIOD
    assert sine["A"] == cosine["A"] > 0.0
    assert cosine["p"] - sine["p"] == pytest.approx(np.pi / 2)
