from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import ModelBasedController
from hframe_gym.controllers.input_inversion import InputInversion
from hframe_gym.effects import EFFECTS
from hframe_gym.evaluation import Scenario, rollout
from hframe_gym.machine import Machine


def banded(machine: Machine, drop: float = 1.0) -> Machine:
    return machine.with_effects(
        EFFECTS["dead_band"].at("motor1", Vd=0.4, drop=drop), EFFECTS["voltage_offset"].at("motor2", V0=0.5)
    )


def test_motors_get_what_is_wanted(hframe: Machine) -> None:
    """By the effects' formulas: 0.4 V more where the band swallows them, 0.5 V less where the offset adds them."""
    wanted = np.array([[1.0, 1.0], [-0.05, -2.0], [0.0, 0.5]])
    amplifiers = InputInversion(banded(hframe))
    asked = amplifiers.asked(wanted)
    np.testing.assert_allclose(asked, [[1.4, 0.5], [-0.45, -2.5], [0.0, 0.0]], atol=5e-3)
    np.testing.assert_allclose(amplifiers.given(asked), wanted, atol=1e-6)


def test_nothing_beyond_the_rated_voltage_is_asked_for(hframe: Machine) -> None:
    asked = InputInversion(banded(hframe)).asked(np.array([[11.9, 12.0], [-30.0, -12.0]]))
    np.testing.assert_allclose(asked, [[12.0, 11.5], [-12.0, -12.0]])


def test_an_amplifier_without_effects_is_left_alone(hframe: Machine) -> None:
    volts = np.random.default_rng(0).uniform(-12.0, 12.0, (5, 2))
    assert np.array_equal(InputInversion(hframe).asked(volts), volts)


@pytest.mark.parametrize(("drop", "share"), [(0.0, 0.75), (1.0, 0.3)], ids=["switch", "dead zone"])
def test_keeps_closer_to_its_path_with_its_dead_band_known(hframe: Machine, drop: float, share: float) -> None:
    machine = banded(hframe, drop)
    trial = Scenario(machine, "track", randomize="none", episodes=8, seed=3)
    off = []
    for model in (hframe, machine):
        contour = rollout(ModelBasedController(model), trial).contour
        assert contour is not None
        off.append(np.sqrt(np.mean(contour**2)))
    assert off[1] < share * off[0]
