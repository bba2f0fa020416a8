"""Tests of rivals (effects that explain the data about equally well) with scripted fits: order, margin, replacement."""

from __future__ import annotations

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.evidence import rivals
from tests.identification.scripted_fits import CRITERIA, DATA, DRAG, HFRAME, PUSH, SPRING, fit_with

pytestmark = pytest.mark.unit
VOLTAGE_OFFSET = EFFECTS["voltage_offset"]


def test_of_trials_as_good_as_the_best_the_simplest_comes_first() -> None:
    current = fit_with(chi2=2.0)
    best, simple, poor = (
        fit_with(effect, chi2=chi2, free=free)
        for effect, chi2, free in ((PUSH, 1.0, 5), (DRAG, 1.029, 3), (SPRING, 1.031, 1))
    )
    order = rivals.simplest_first([poor, best, simple], current, CRITERIA)
    assert order == [simple, best, poor]
    assert rivals.simplest_first([], current, CRITERIA) == []


def test_rivals_are_other_effects_within_the_margin() -> None:
    current, best = fit_with(chi2=2.0), fit_with(PUSH, chi2=1.0)
    close, same, far = fit_with(DRAG, chi2=1.029), fit_with(PUSH, chi2=1.001), fit_with(SPRING, chi2=1.031)
    assert rivals.close_rivals([best, same, close, close, far], current, CRITERIA) == (DRAG,)


@pytest.mark.parametrize(("bandwidth", "polished"), [(30.0, [30.0, 0.0]), (0.0, [0.0])])
def test_a_fit_is_polished_at_its_bandwidth_and_in_simulation(
    monkeypatch: pytest.MonkeyPatch, bandwidth: float, polished: list[float]
) -> None:
    bandwidths = []
    losses = {30.0: 2.0, 0.0: 1.5}
    monkeypatch.setattr(rivals, "polish", lambda fitted, data: bandwidths.append(fitted.bandwidth) or fitted)
    monkeypatch.setattr(
        rivals, "continue_fit", lambda fitted, data, bandwidth: fit_with(chi2=1.0, bandwidth=bandwidth)
    )
    monkeypatch.setattr(rivals, "likelihood_loss", lambda fitted, data: losses[fitted.bandwidth])
    assert rivals._polished(fit_with(chi2=1.0, bandwidth=bandwidth), DATA).bandwidth == 0.0
    assert bandwidths == polished


def test_two_constant_forces_may_be_two_others() -> None:
    """They are tried at the coordinates without one; a voltage offset of a drive acts on its pulley."""
    force = EFFECTS["constant_force"]
    on_y, on_pulley, offset = (
        force.at("y", size=0.5),
        force.at("phi2", size=0.01),
        VOLTAGE_OFFSET.at("motor2", V0=0.1),
    )
    machine = HFRAME.with_effects(on_y, offset)
    of_force = rivals.rivals_in_combination(on_y, (), [offset, on_pulley], machine)
    assert {r.label for r in of_force} == {"constant_force@x", "constant_force@phi1"}
    of_offset = rivals.rivals_in_combination(offset, (on_pulley,), [on_y], machine)
    assert {r.label for r in of_offset} == {"constant_force@x", "voltage_offset@motor1"}
    assert all(value == 0.0 for r in (*of_force, *of_offset) for value in r.parameters.values())


def test_an_effect_without_a_companion_of_its_kind_has_no_further_rivals() -> None:
    spring = EFFECTS["cable_spring"].at("x", k=6.0, q0=0.05)
    push = EFFECTS["constant_force"].at("y", size=0.5)
    assert rivals.rivals_in_combination(push, (), [spring], HFRAME.with_effects(push, spring)) == ()
    # A spring has two parameters: no fit can start from its absence.
    springs = spring, EFFECTS["cable_spring"].at("y", k=6.0, q0=0.05)
    assert rivals.rivals_in_combination(springs[0], (), [springs[1]], HFRAME.with_effects(*springs)) == ()
