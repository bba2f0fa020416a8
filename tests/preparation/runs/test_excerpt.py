"""Tests of the part of a long session in which effects are searched for."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.identification import identify
from hframe_gym.identification.budget import DEFAULT_SECONDS, Budget, stage_ends
from hframe_gym.preparation.dataset import Dataset
from hframe_gym.preparation.runs.excerpt import (
    NORMAL_SESSION,
    describe_part,
    largest_share,
    representative_part,
)
from hframe_gym.preparation.session import prepare
from hframe_gym.recordings import Recording
from tests.identification.single_axis import AXIS, limited_runs

pytestmark = pytest.mark.unit
PERIOD = 1e-3  # s


def run_of(name: str, voltages: np.ndarray) -> Recording:
    """Return a run of the axis with voltages, V, shape (n,), at 1 kHz; its encoder counts from 0.3 m."""
    time_s = np.arange(len(voltages)) * PERIOD
    outputs = simulate(AXIS, time_s, voltages[:, None]).outputs
    noise = np.random.default_rng(len(voltages)).normal(0.0, 2e-5, outputs.shape)
    return Recording(name, time_s, voltages[:, None], outputs + noise)


def sine(seconds: float, frequency: float = 2.0, volts: float = 4.0) -> np.ndarray:
    """Return a sine after 0.3 s of rest, V, shape (n,); it ends in a rest as well."""
    time_s = np.arange(round(seconds / PERIOD)) * PERIOD
    moving = (time_s > 0.3) & (time_s < seconds - 0.7)
    return np.where(moving, volts * np.sin(2.0 * np.pi * frequency * (time_s - 0.3)), 0.0)


def lengths(data: Dataset) -> dict[str, int]:
    """Return the number of rows of each run."""
    return {run.name: len(run.time_s) for run in data.runs}


def test_the_longest_of_some_lengths_is_cut() -> None:
    assert largest_share([1.0, 2.0], 10.0) == 2.0
    assert largest_share([1.0, 5.0, 9.0], 9.0) == 4.0
    assert largest_share([6.0, 6.0], 6.0) == 3.0


def test_a_normal_session_is_searched_as_it_is_and_of_a_long_one_short_runs_remain_whole() -> None:
    data = prepare([run_of("long", sine(6.0)), run_of("short", sine(2.0, 3.0))], AXIS)
    assert representative_part(data, AXIS) is data
    assert NORMAL_SESSION == 160_000
    part = representative_part(data, AXIS, size=5000)
    assert lengths(part) == {"long": 3000, "short": 2000}
    assert describe_part(part, data) == "5000 of 8000 rows, of 2 of 2 runs"
    assert part.noise is data.noise


def test_the_part_resembles_the_whole_run_and_begins_at_rest_where_it_is() -> None:
    """A slow jog precedes the moves of which the run consists."""
    jog, moves = sine(3.0, 0.5, 1.5), np.tile(sine(3.0, 4.0, 6.0), 3)
    data = prepare([run_of("run", np.concatenate([jog, moves]))], AXIS)
    (whole,), (part,) = data.runs, representative_part(data, AXIS, size=3000).runs
    start = int(np.flatnonzero(whole.time_s == part.time_s[0])[0])
    assert start >= 2000
    assert part.initial.resting_rows > 100
    np.testing.assert_array_equal(part.inputs, whole.inputs[start : start + 3000])
    # Positions are those of the whole run, so that forces that depend on them are found where they act.
    np.testing.assert_allclose(part.outputs, whole.outputs[start : start + 3000], atol=1e-12)
    assert part.initial_state(AXIS)[0] == pytest.approx(whole.outputs[start : start + 100].mean(), abs=1e-5)


def test_a_sensor_that_was_not_measured_hides_no_rest() -> None:
    machine = AXIS.replace(sensors=(*AXIS.sensors, dataclasses.replace(AXIS.sensors[0], channel="other_m")))
    run = run_of("run", np.concatenate([sine(3.0, 0.5, 1.5), np.tile(sine(3.0, 4.0, 6.0), 3)]))
    outputs = np.hstack([run.outputs, np.full_like(run.outputs, np.nan)])
    data = prepare([dataclasses.replace(run, outputs=outputs)], machine)
    assert representative_part(data, machine, size=3000).runs[0].initial.resting_rows > 100


def test_of_many_runs_those_that_differ_are_used_and_none_that_stands_still() -> None:
    runs = [run_of(f"run_{k}", sine(2.0)) for k in range(20)]
    runs[7] = run_of("run_7", sine(2.0, 20.0, 9.0))
    runs[0] = run_of("run_0", np.zeros(2000))
    data = prepare(runs, AXIS)
    part = representative_part(data, AXIS, size=8000)
    names = [run.name for run in part.runs]
    assert "run_7" in names
    assert "run_0" not in names
    assert len(names) == 8
    # Those that are alike lie far from each other in the session.
    indices = [int(name.removeprefix("run_")) for name in names]
    assert max(np.diff(indices)) <= 5
    assert set(lengths(part).values()) == {1000}
    assert len(representative_part(data, AXIS, size=8000, every_run=True).runs) == 20


def test_what_a_part_of_the_rows_shows_is_fitted_to_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hframe_gym.identification.search.checked_search.NORMAL_SESSION", 3000.0)
    runs, lines = limited_runs([3.0, 9.0, 3.0, 9.0, 9.0]), list[str]()
    result = identify(runs, AXIS, budget=math.inf, log=lines.append)
    assert any(line.startswith("effects are searched for in 3000 of 6000 rows, of 4 of 4") for line in lines)
    assert [s.effect.label for s in result.effects] == ["current_limit@motor"]
    assert all(len(run.time_s) == 1500 for run in result.fitted.runs)
    assert result.unfinished is None

    # Without time for that fit, what the part shows is the answer, and the report says so.
    ends = stage_ends(AXIS, in_part=True)

    def spent() -> float:
        return DEFAULT_SECONDS * ends.all_rows if "fitting all rows" in lines else 0.0

    lines.clear()
    early = identify(runs, AXIS, budget=Budget(DEFAULT_SECONDS, clock=spent), log=lines.append)
    assert [s.effect.label for s in early.effects] == ["current_limit@motor"]
    assert early.unfinished is not None
    assert early.unfinished.stage == "fitting all rows"
    assert sum(len(run.time_s) for run in early.fitted.runs) == 3000


def test_a_run_that_the_search_leaves_out_does_not_refute_what_it_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In one run, the encoder counted the other way."""
    monkeypatch.setattr("hframe_gym.identification.search.checked_search.NORMAL_SESSION", 2000.0)
    runs = limited_runs([3.0, 9.0, 3.0, 9.0, 9.0])
    runs[1] = dataclasses.replace(runs[1], outputs=2.0 * runs[1].outputs[0] - runs[1].outputs)
    result = identify(runs, AXIS, budget=math.inf)
    assert any(remark.startswith("run_1 is not used") for remark in result.excluded)
    assert [s.effect.label for s in result.effects] == ["current_limit@motor"]
