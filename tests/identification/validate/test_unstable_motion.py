"""Where a motion is unstable, a simulation enlarges an error as small as the noise, at any moment of a run."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.identification import SelectionCriteria, prepare
from hframe_gym.identification.report.remainder import reason_of_remainder
from hframe_gym.identification.validate import evaluation
from hframe_gym.identification.validate.unstable_motion import enlargement
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording
from tests.identification.single_axis import AXIS, limited_runs


@pytest.mark.parametrize(("angle", "low", "high"), [(1.0, 0.0, 1.1), (2.9, 20.0, np.inf)])
def test_a_pendulum_near_its_top_enlarges_an_error(angle: float, low: float, high: float) -> None:
    """A controller swings it to an angle, where it keeps it; the error of the start shrinks before."""
    pendulum = BUILTIN_MACHINES["pendulum"]()
    time_s, state, voltages, measured = np.arange(700) * 5e-3, np.zeros(2), [], []
    for time in time_s:
        target = angle * float(np.clip(time - 0.3, 0.0, 1.0))
        voltages.append(np.clip(20.0 * (target - state[0]) - 1.5 * state[1], -12.0, 12.0))
        measured.append(state[0])
        step = simulate(pendulum, [0.0, 5e-3], [[voltages[-1]], [0.0]], state)
        state = np.array([step.positions[1, 0], step.velocities[1, 0]])
    run = Recording("run", time_s, np.array(voltages)[:, None], np.array(measured)[:, None])
    assert low <= enlargement(pendulum, prepare([run], pendulum), 15.0) <= high


def test_an_axis_enlarges_no_error() -> None:
    assert enlargement(AXIS, prepare(limited_runs([4.0]), AXIS), 15.0) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(
    ("verdict", "left", "enlarged", "said"),
    [
        ("no_effect", 31.7, 161.0, True),
        ("no_effect", 31.7, 1.0, False),
        ("no_effect", 1.9, 161.0, False),
        ("unexplained", 31.7, 161.0, False),  # the plain fit may be better
    ],
)
def test_a_note_says_that_simulations_say_nothing(
    verdict: str, left: float, enlarged: float, said: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: Any = (SimpleNamespace(name="run"),)
    test = SimpleNamespace(
        criteria=SelectionCriteria(),
        validation=SimpleNamespace(has_voltage_errors=False, runs=runs),
        enlargement=lambda machine, names: enlarged,
    )
    after = SimpleNamespace(held_out=SimpleNamespace(noise_ratio=left), machine=AXIS)
    evaluated: Any = SimpleNamespace(outcome=SimpleNamespace(verdict=verdict), test=test, after=after)
    monkeypatch.setattr(evaluation, "_quiet", lambda evaluated, runs: None)
    monkeypatch.setattr(evaluation, "_predicted_like_exact", lambda evaluated, data: 0.97)
    sentence = evaluation.unstable_motion(evaluated, ())
    assert bool(sentence) == said
    assert ("grows by a factor of 161" in sentence) == said


@pytest.mark.parametrize(
    ("verdict", "clause"), [("no_effect", "motion is unstable"), ("unexplained", "not found")]
)
def test_the_report_says_why_so_much_is_left(verdict: str, clause: str) -> None:
    report: Any = SimpleNamespace(
        verdict=verdict, left=31.7, effects=(), proposed_formulas=(), unknown_voltages=None
    )
    assert clause in reason_of_remainder(report)
