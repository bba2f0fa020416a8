"""Tests of the variables on which the formulas of effects depend."""

from __future__ import annotations

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.evidence.effect_variables import (
    curves_of_one_variable,
    depend_on_same_variable,
    describes_one_run,
)
from hframe_gym.machine import AppliedEffect
from tests.identification.scripted_fits import (
    CLOCK,
    DRAG,
    FRAME,
    HFRAME,
    SPRING,
    STRIBECK,
)


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (STRIBECK, DRAG, True),
        (STRIBECK, SPRING, False),
        (FRAME, SPRING, False),  # the frame's own position and speed
        (FRAME, STRIBECK, False),
        (STRIBECK, EFFECTS["quadratic_drag"].at("y", c=4.0), False),
        (
            EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5),
            EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0),
            False,
        ),
        (EFFECTS["friction_slope"].at("x", s=1.0), SPRING, True),
        (
            EFFECTS["friction_slope"].at("phi1", s=0.1),
            EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0),
            True,
        ),
        (
            CLOCK,
            EFFECTS["winding_heat"].at("motor1", a=0.03, tau=10.0),
            True,
        ),  # memories that drift, of all parts
        (CLOCK, EFFECTS["winding_heat"].at("motor1", a=0.03, tau=0.1), False),
        (CLOCK, EFFECTS["friction_warm_up"].at("x", a=0.3, tau=30.0), True),
        (CLOCK, EFFECTS["electrical_lag"].at("motor1", tau=1e-3), False),
        (CLOCK, STRIBECK, False),
    ],
)
def test_which_effects_depend_on_the_same_variable(
    first: AppliedEffect, second: AppliedEffect, same: bool
) -> None:
    """Periodic ones only on that of other periodic ones."""
    assert depend_on_same_variable(first, second, HFRAME) == same
    assert depend_on_same_variable(second, first, HFRAME) == same


def test_curves_of_one_variable_are_functions_of_it_alone_at_one_coordinate() -> None:
    """A motor turns with its coordinate; what remembers, or depends on a voltage, is no curve."""
    cogging = EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5)
    spring = EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0)
    others = [
        SPRING,
        STRIBECK,
        EFFECTS["dahl_hysteresis"].at("phi1", F=0.1, L=0.02),
        EFFECTS["dead_band"].at("drives", Vd=0.1, drop=0.0),
        EFFECTS["gain_mismatch"].at("motor1", g=0.1),
    ]
    assert curves_of_one_variable([spring, *others, cogging], HFRAME) == [spring, cogging]
    assert curves_of_one_variable([spring, *others], HFRAME) == []


@pytest.mark.parametrize(
    ("name", "one_run"),
    [
        ("dead_band", False),
        ("dahl_hysteresis", False),  # motion soon replaces the unknown deflection at the start
        ("winding_heat", True),
        ("friction_warm_up", True),
        ("clock_drift", True),
    ],
)
def test_what_may_describe_a_run_whatever_it_is_in_the_others(name: str, one_run: bool) -> None:
    assert describes_one_run(EFFECTS[name]) == one_run
