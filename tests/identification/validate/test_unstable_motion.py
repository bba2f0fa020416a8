"""Where a motion is unstable, a simulation enlarges an error as small as noise, at any moment of a run."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.identification import SelectionCriteria, prepare
from hframe_gym.identification.predict.voltage_errors import with_voltage_errors
from hframe_gym.identification.report.words.remainder import reason_of_remainder
from hframe_gym.identification.validate.evaluation import HeldOutTest, describe_unstable_motion
from hframe_gym.identification.validate.unstable_motion import enlargement
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.preparation.session import prepare_session
from hframe_gym.recordings import Recording
from tests.identification.single_axis import AXIS, limited_runs

PENDULUM = BUILTIN_MACHINES["pendulum"]()


@cache
def swung(angle: float) -> Recording:
    """Return a run of a pendulum that a controller swings to an angle, where it keeps it."""
    time_s, state, voltages, measured = np.arange(700) * 5e-3, np.zeros(2), [], []
    for time in time_s:
        target = angle * float(np.clip(time - 0.3, 0.0, 1.0))
        voltages.append(np.clip(20.0 * (target - state[0]) - 1.5 * state[1], -12.0, 12.0))
        measured.append(state[0])
        step = simulate(PENDULUM, [0.0, 5e-3], [[voltages[-1]], [0.0]], state)
        state = np.array([step.positions[1, 0], step.velocities[1, 0]])
    return Recording("run", time_s, np.array(voltages)[:, None], np.array(measured)[:, None])


@pytest.mark.parametrize(("angle", "low", "high"), [(1.0, 0.0, 1.1), (2.9, 20.0, np.inf)])
def test_a_pendulum_near_its_top_enlarges_an_error(angle: float, low: float, high: float) -> None:
    """The error of the start shrinks before."""
    assert low <= enlargement(PENDULUM, prepare([swung(angle)], PENDULUM), 15.0) <= high


def test_an_axis_enlarges_no_error() -> None:
    assert enlargement(AXIS, prepare(limited_runs([4.0]), AXIS), 15.0) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(
    ("angle", "left", "voltages_known", "machine", "said"),
    [
        (2.9, 31.7, True, PENDULUM, True),
        (2.9, 31.7, True, PENDULUM.replace({"arm.mass": 0.5 * PENDULUM.parameters["arm.mass"]}), False),
        (1.0, 31.7, True, PENDULUM, False),
        (2.9, 1.9, True, PENDULUM, False),
        (2.9, 31.7, False, PENDULUM, False),  # unknown voltages may be the cause
    ],
    ids=["exact", "something is missing", "stable", "only noise is left", "unknown voltages"],
)
def test_a_note_says_that_simulations_say_nothing(
    angle: float, left: float, voltages_known: bool, machine: Machine, said: bool
) -> None:
    session = prepare_session([swung(angle)], PENDULUM, lambda line: None)
    held_out = session.data
    if not voltages_known:
        held_out = with_voltage_errors(PENDULUM, held_out.with_updates(4))
    test = HeldOutTest(session, held_out, SelectionCriteria())
    after = SimpleNamespace(held_out=SimpleNamespace(noise_ratio=left), machine=machine)
    evaluated: Any = SimpleNamespace(outcome=SimpleNamespace(data=session.data), test=test, after=after)
    sentence = describe_unstable_motion(evaluated)
    assert bool(sentence) == said
    factor = f"grows by a factor of {enlargement(machine, held_out, 15.0):.3g}"
    assert (factor in sentence) == said


@pytest.mark.parametrize(("unstable", "clause"), [(True, "motion is unstable"), (False, "not found")])
@pytest.mark.parametrize("verdict", ["no_effect", "effect_found"])
def test_the_report_says_why_so_much_is_left(verdict: str, unstable: bool, clause: str) -> None:
    report: Any = SimpleNamespace(
        verdict=verdict,
        left=31.7,
        effects=(),
        proposed_formulas=(),
        unknown_voltages=None,
        unstable=unstable,
        rounded_stamps=False,
    )
    assert clause in reason_of_remainder(report)
