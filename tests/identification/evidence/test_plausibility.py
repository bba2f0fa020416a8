"""Tests of the checks that an identified machine must pass before it is written."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.evidence.plausibility import (
    plausibility_fault,
    speeds_inside,
)
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.effects.one_of_each import CASES, Case

ON_BELTS = {name: case for name, case in CASES.items() if EFFECTS[name].tension}


@pytest.mark.parametrize("name", ["hframe", "axis"])
def test_presets_pass(name: str) -> None:
    assert plausibility_fault(BUILTIN_MACHINES[name]()) == ""


@pytest.mark.parametrize("case", ON_BELTS.values(), ids=ON_BELTS)
def test_belts_of_the_library_pass(case: Case, hframe: Machine) -> None:
    """Play and slack have a flat part, which is no fault."""
    assert plausibility_fault(hframe.with_effects(case.effect)) == ""


@pytest.mark.parametrize("site", ["belts", "left", "bottom"])
def test_softening_that_turns_over_fails(site: str, hframe: Machine) -> None:
    """The tension k s (1 + h s^2) falls from s = 1 / sqrt(-3 h) on, which is 2.6 mm here."""
    machine = hframe.with_effects(EFFECTS["belt_hardening"].at(site, h=-5e4))
    assert "diverge" in plausibility_fault(machine)


@pytest.mark.parametrize("name", ["hframe", "belt-axis", "printer"])
def test_slight_softening_passes(name: str) -> None:
    """The tension would fall from 180 mm on, where no voltage leads inside the workspace."""
    machine = BUILTIN_MACHINES[name]().with_effects(EFFECTS["belt_hardening"].at("belts", h=-10.0))
    assert plausibility_fault(machine) == ""


def test_machine_that_diverges_fails(hframe: Machine) -> None:
    """Drag that accelerates."""
    drag = hframe.with_effects(EFFECTS["quadratic_drag"].at("x", c=-500.0))
    assert "diverge" in plausibility_fault(drag)


def test_impossible_machine_without_effects_fails(hframe: Machine) -> None:
    """A negative mass needs no effect to diverge."""
    x, *others = hframe.coordinates
    impossible = dataclasses.replace(hframe, coordinates=(dataclasses.replace(x, mass=-1e-3), *others))
    assert "diverge" in plausibility_fault(impossible)


@pytest.mark.parametrize(("fast_from", "expected"), [(6, 1.0), (4, 1e6)])
def test_speeds_count_while_the_machine_without_the_effect_stays_in_its_workspace(
    hframe: Machine, fast_from: int, expected: float
) -> None:
    """Outside, belts that become too short accelerate every machine; that is no fault of the effect."""
    positions, speeds, reference = np.zeros((1, 10, 4)), np.ones((1, 10, 4)), np.ones((1, 10, 4))
    positions[:, 6:, 0] = 10.0  # m
    speeds[:, fast_from:], reference[:, 7:] = 1e6, 1e6
    assert speeds_inside(hframe, speeds, positions, reference) == (expected, 1.0)
    speeds[:, 5] = np.nan
    assert speeds_inside(hframe, speeds, positions, reference) == (np.inf, 1.0)


@pytest.mark.parametrize(
    ("stiffness", "fault"), [(2.0, ""), (-2.0, "cable_spring@x is not what its name says")]
)
def test_a_spring_to_the_frame_pulls_back(stiffness: float, fault: str) -> None:
    """Under random voltage, a weak one that pushes does not diverge."""
    spring = EFFECTS["cable_spring"].at("x", k=stiffness, q0=0.01)
    found = plausibility_fault(BUILTIN_MACHINES["axis"]().with_effects(spring))
    assert (fault in found) if fault else found == ""
