from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import ModelBasedController
from hframe_gym.controllers import DeadTime
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.evaluation import Scenario, rollout, scores
from hframe_gym.machine import BUILTIN_MACHINES, Machine

PERIOD = 0.01


def late(d: float) -> Machine:
    return BUILTIN_MACHINES["hframe"]().with_effects(EFFECTS["input_delay"].at("drives", d=d))


@pytest.mark.parametrize("d", [0.004, 0.01, 0.013, 0.03])
def test_looks_ahead_to_where_the_late_machine_will_be(d: float) -> None:
    """Against a finely sampled simulation of the late machine: its state d later, whatever is sent from now on."""
    machine = late(d)
    volts = np.random.default_rng(0).uniform(-8.0, 8.0, (12, 2))
    dead = DeadTime(machine, PERIOD)
    dead.begin(np.ones(1, np.bool_))
    for row in volts:
        dead.send(row[None])
    fine = 1e-3 * np.arange(200)
    held = np.vstack([np.repeat(volts, 10, axis=0), np.zeros((80, 2))])
    run = simulate(machine, fine, held)
    states = np.hstack([run.positions, run.velocities]) * np.tile(machine.radii, 2)
    ahead = dead.ahead(states[120:121])
    later = states[120 + round(d / 1e-3)]
    np.testing.assert_allclose(ahead[0, :4], later[:4], atol=2e-6)
    np.testing.assert_allclose(ahead[0, 4:], later[4:], atol=1e-3)


def test_arrived_is_the_mean_of_what_reached_the_motors() -> None:
    dead = DeadTime(late(0.013), PERIOD)
    dead.begin(np.ones(1, np.bool_))
    for value in (1.0, 2.0, 4.0, 8.0):
        dead.send(np.full((1, 2), value))
    # The last period, 30 to 40 ms, saw what was sent at 10 ms (until 33 ms) and at 20 ms... 13 ms late.
    np.testing.assert_allclose(dead.arrived(), 0.3 * 2.0 + 0.7 * 4.0)
    times, volts = dead.course()
    np.testing.assert_allclose(times, [0.0, 0.003, 0.01])
    np.testing.assert_allclose(volts[0], [[2.0, 2.0], [4.0, 4.0], [4.0, 4.0]])


def test_without_a_dead_time_what_is_sent_arrives() -> None:
    dead = DeadTime(BUILTIN_MACHINES["hframe"](), PERIOD)
    dead.begin(np.ones(1, np.bool_))
    dead.send(np.array([[3.0, -1.0]]))
    times, volts = dead.course()
    np.testing.assert_allclose(times, [0.0, 0.01])
    np.testing.assert_allclose(volts, [[[3.0, -1.0], [3.0, -1.0]]])


def test_skips_goals_by_the_dead_time() -> None:
    goals = np.stack([np.linspace(0.0, 1.0, 11), np.linspace(2.0, 3.0, 11)], axis=1)[None]
    skipped = DeadTime(late(0.015), PERIOD).skip(goals)
    np.testing.assert_allclose(skipped[0, :, 0], np.arange(0.15, 1.0, 0.1))
    with pytest.raises(ValueError, match="ends within the dead time"):
        DeadTime(late(0.015), PERIOD).skip(goals[:, :3])


def test_a_controller_that_knows_its_dead_time_settles_where_one_that_does_not_swings() -> None:
    machine = late(0.01)
    trial = Scenario(machine, randomize="none", episodes=16, duration_s=1.0)
    aware = scores(rollout(ModelBasedController(machine), trial))
    blind = scores(rollout(ModelBasedController(BUILTIN_MACHINES["hframe"]()), trial))
    assert aware["success"]["0.2mm"] == 1.0
    assert blind["success"]["0.2mm"] < 0.5
