"""An effect that is defined outside the library works like those of the library."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from hframe_gym.dynamics import effect_forces, simulate
from hframe_gym.dynamics.elementwise import maximum
from hframe_gym.effects import EFFECTS, effect_sites, get_effect, register_effect, unregister_effect
from hframe_gym.machine import Effect, EffectParameter, Machine

pytestmark = pytest.mark.unit

EXPONENT = 3


def _cubed(v):  # type: ignore[no-untyped-def]
    return v**EXPONENT


def drag(v, c):  # type: ignore[no-untyped-def]
    """Return -c v^3 in forward direction; a formula with a constant and a helper function of its module."""
    return -c * maximum(_cubed(v), 0.0)


TOY = Effect(
    name="toy_drag",
    family="toy_drag",
    site="coordinate",
    formula="f = -c max(v, 0)^3",
    source="this test",
    force=drag,
    parameters=(EffectParameter("c", "1", 0.0, 1e6, scale=1.0, role="amplitude"),),
)


@pytest.fixture
def toy() -> Iterator[Effect]:
    """Register the effect for one test."""
    yield register_effect(TOY)
    unregister_effect(TOY.name)


def test_registered_effect_is_listed(toy: Effect, hframe: Machine) -> None:
    """The library's mapping, look-up by name, and sites."""
    assert EFFECTS["toy_drag"] is get_effect("toy_drag") is toy
    assert effect_sites(toy, hframe) == hframe.coordinate_names


def test_registered_effect_acts_in_the_kernel(toy: Effect, hframe: Machine) -> None:
    """The kernel slows the carriage down, and the equations give the formula's force."""
    time_s, inputs = np.arange(200) * 1e-3, np.full((200, 2), (6.0, -6.0))
    machine = hframe.with_effects(toy.at("x", c=500.0))
    motion, plain = simulate(machine, time_s, inputs), simulate(hframe, time_s, inputs)
    speed = motion.velocities[:, 0]
    assert abs(speed[-1]) > 0.1
    force = effect_forces(machine, time_s, motion.positions, motion.velocities, inputs)[:, 0]
    np.testing.assert_allclose(force, -500.0 * np.maximum(speed**3, 0.0), atol=1e-9)
    assert (speed[-1] < 0.0) == (np.abs(force).max() == 0.0)
    difference = np.abs(motion.positions - plain.positions).max()
    assert (difference == 0.0) if speed[-1] < 0.0 else (difference > 1e-3)


def test_name_can_be_registered_once(toy: Effect) -> None:
    """A second definition of the same name is an error, the same definition is not."""
    assert register_effect(toy) is toy
    with pytest.raises(ValueError, match="registered already"):
        register_effect(dataclasses.replace(toy, formula="f = 0"))


def test_library_cannot_be_changed_by_assignment() -> None:
    """Registration is the only way in."""
    with pytest.raises(TypeError):
        EFFECTS["toy_drag"] = TOY  # type: ignore[index]
