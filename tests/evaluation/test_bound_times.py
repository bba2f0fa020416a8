from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import ModelBasedController
from hframe_gym.effects import EFFECTS
from hframe_gym.evaluation import BANDS, Scenario, evaluate, known_bounds, rollout
from hframe_gym.evaluation.bound_times import digests, drawn
from hframe_gym.evaluation.metrics import settling
from hframe_gym.machine import BUILTIN_MACHINES

HFRAME = BUILTIN_MACHINES["hframe"]()
SEED = 1000  # of the draws that the package has bounds of


@pytest.mark.parametrize("changes", [{"sensors": "rig"}, {"period": 0.002}, {"duration_s": 0.5}])
def test_draws_are_the_same_whatever_the_controller_has(changes: dict[str, object]) -> None:
    trial, other = Scenario(episodes=9, seed=4), Scenario(episodes=9, seed=4, **changes)  # type: ignore[arg-type]
    assert digests(drawn(trial)) == digests(drawn(other))


def test_draws_are_those_of_the_episodes() -> None:
    trial = Scenario(HFRAME, episodes=3, seed=4, duration_s=0.02)
    run, draws = rollout(ModelBasedController(HFRAME), trial), drawn(trial)
    np.testing.assert_array_equal(run.position[:, 0], draws.start)
    np.testing.assert_array_equal(run.goal[:, 0], draws.goal)


def test_a_digest_is_of_all_that_matters() -> None:
    draws = drawn(Scenario(episodes=2, seed=4))
    moved = [
        draws._replace(start=draws.start + 1e-6),
        draws._replace(goal=draws.goal + 1e-6),
        draws._replace(parameters=draws.parameters * (1.0 + 1e-6)),
        draws._replace(machine=BUILTIN_MACHINES["hframe-linear"]()),
    ]
    everything = [digest for d in (draws, *moved) for digest in digests(d)]
    assert len(set(everything)) == len(everything)


def test_bounds_follow_the_draw_and_not_its_place() -> None:
    times = known_bounds(Scenario(episodes=6, seed=SEED))
    later = known_bounds(Scenario(HFRAME, sensors="rig", period=0.002, episodes=3, seed=SEED + 3))
    assert times is not None
    assert later is not None
    np.testing.assert_array_equal(later, times[3:])
    assert np.all((times > 0.02) & (times < 1.0))


def test_no_controller_beats_its_bound() -> None:
    trial = Scenario(HFRAME, period=0.002, episodes=24, seed=SEED)
    answer, runs = evaluate({"pid": ModelBasedController(HFRAME, 0.002)}, trial)
    run, bound = runs["pid"], known_bounds(trial)
    times, success = settling(np.linalg.norm(run.position - run.goal, axis=2), run.time_s, BANDS["0.2mm"])
    assert bound is not None
    assert success.all()
    assert np.all(times > bound)
    over = answer["controllers"]["pid"]["over_bound"]["0.2mm"]
    assert over["mean"] == pytest.approx(np.mean(times / bound))
    assert over["episodes"] == 24
    assert over["mean"] < 1.12


def test_unknown_draws_have_no_bound() -> None:
    assert known_bounds(Scenario(randomize="none", episodes=2, seed=SEED)) is None
    assert known_bounds(Scenario(task="track", episodes=2, seed=SEED)) is None
    pushed = HFRAME.with_effects(EFFECTS["constant_force"].at("x", size=1.0))
    assert known_bounds(Scenario(pushed, episodes=2, seed=SEED)) is None
