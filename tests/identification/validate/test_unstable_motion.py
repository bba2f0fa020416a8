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
    ("left", "enlarged", "voltages_known", "predicted", "said"),
    [
        (31.7, 161.0, True, 0.97, True),
        (31.7, 161.0, True, 1.5, False),  # something is missing
        (31.7, 1.0, True, 0.97, False),
        (1.9, 161.0, True, 0.97, False),
        (31.7, 161.0, False, 0.97, False),  # unknown voltages may be the cause
    ],
)
def test_a_note_says_that_simulations_say_nothing(
    left: float,
    enlarged: float,
    voltages_known: bool,
    predicted: float,
    said: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    held_out: Any = SimpleNamespace(
        has_voltage_errors=not voltages_known,
        runs=(SimpleNamespace(name="run"),),
        with_runs=lambda names: None,
    )
    session: Any = SimpleNamespace(usable=None)
    monkeypatch.setattr(evaluation, "with_all_measurements", lambda data, usable: held_out)
    monkeypatch.setattr(evaluation, "enlargement", lambda machine, data, bandwidth: enlarged)
    monkeypatch.setattr(evaluation, "predictions_by_run", lambda *_: np.array([[predicted]]))
    test = evaluation.HeldOutTest(session, held_out, SelectionCriteria())
    after = SimpleNamespace(held_out=SimpleNamespace(noise_ratio=left), machine=AXIS)
    evaluated: Any = SimpleNamespace(outcome=SimpleNamespace(data=None), test=test, after=after)
    sentence = evaluation.describe_unstable_motion(evaluated)
    assert bool(sentence) == said
    assert ("grows by a factor of 161" in sentence) == said


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
    )
    assert clause in reason_of_remainder(report)
