"""Estimates against numbers that are known: those of an independent simulator's rig, and those of drawn stages."""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop import PERIOD, circles, closed_loop, random_stages

from hframe_gym.controllers import AdaptivePID
from hframe_gym.controllers.momentum_filter import MomentumFilter
from hframe_gym.controllers.motion_model import MotionModel
from hframe_gym.machine import Machine
from tests.reference_simulator import Rig, Stage

FRICTION_X, FRICTION_PHI1, FRICTION_PHI2, MASS_X, BELTS = 0, 2, 3, 4, 8


def watched(machine: Machine, rig: Rig, periods: int) -> MomentumFilter:
    """A filter that saw a rig of the independent simulator shaken by voltages that no controller chose."""
    model = MotionModel(machine)
    found, stage = MomentumFilter(model, PERIOD), Stage(rig, np.zeros(2), rtol=1e-7, atol=1e-10)

    def state() -> np.ndarray:
        return model.state({"observation": np.concatenate([stage.position, stage.velocity])[None]})

    before, fresh = state(), np.ones(1, np.bool_)
    found.learn(before, before, np.zeros((1, 2)), np.zeros((1, 4)), fresh)
    for k in range(periods):
        t = k * PERIOD
        volts = np.array([4.0 * np.sin(19.0 * t) + 3.0 * np.sin(41.0 * t), 4.0 * np.sin(26.0 * t + 1.0)])
        stage.step(volts, t + PERIOD)
        after = state()
        found.learn(before, after, volts[None], np.zeros((1, 4)), ~fresh)
        before = after
    return found


def test_approaches_the_numbers_of_an_independent_simulator(hframe: Machine) -> None:
    declared = Rig()
    rig = Rig(
        coulomb=(1.5 * declared.coulomb[0], declared.coulomb[1], 1.3 * declared.coulomb[2], 0.7 * declared.coulomb[3]),
        mass=(1.1 * declared.mass[0], *declared.mass[1:]),
        belt_EA_N=tuple(0.8 * EA for EA in declared.belt_EA_N),
    )
    found = watched(hframe, rig, 150).estimates[0]
    true = {FRICTION_X: 0.5, FRICTION_PHI1: 0.3, FRICTION_PHI2: -0.3, MASS_X: 0.1, BELTS: -0.2}
    for column, value in true.items():
        assert found[column] == pytest.approx(value, abs=0.25 * abs(value)), column


def test_finds_nothing_where_the_stage_is_as_declared(hframe: Machine) -> None:
    found = watched(hframe, Rig(), 150)
    assert np.abs(found.estimates[0, [FRICTION_X, FRICTION_PHI1, FRICTION_PHI2, MASS_X, BELTS]]).max() < 0.1
    np.testing.assert_allclose(found.masses, 1.0, atol=0.05)


def test_drawn_stages_are_known_after_a_circle(hframe: Machine) -> None:
    count = 48
    goals, changes = circles(count, 6, periods=150), random_stages(hframe, count, 7)
    adaptive = AdaptivePID(hframe, PERIOD)
    closed_loop(adaptive, hframe, goals[:, 0], goals, changes=changes, periods=150)
    names = {0: "x.coulomb", 2: "phi1.coulomb", 3: "phi2.coulomb", 4: "x.mass", 8: f"{hframe.belts[0].name}.EA"}
    # Of the spread of the draws.
    for (column, name), most in zip(names.items(), (0.4, 0.3, 0.3, 0.6, 0.8), strict=True):
        off = changes[name] / hframe.parameters[name] - 1.0
        wrong = np.sqrt(np.mean((adaptive.learnt[:, column] - off) ** 2))
        assert wrong < most * off.std(), name


def test_forgets_where_an_episode_begins(hframe: Machine) -> None:
    found = watched(hframe, Rig(), 20)
    rest = found.model.goal_state(np.zeros((1, 2)))
    assert np.abs(found.estimates).max() > 0.0
    found.learn(rest, rest, np.zeros((1, 2)), np.zeros((1, 4)), np.ones(1, np.bool_))
    assert np.all(found.estimates == 0.0)
