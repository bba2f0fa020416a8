"""Mutated files, options and actions: each command ends with a result or a line; the corpus stays mended."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hframe_gym.envs import HFrameEnv, HFrameVectorEnv

from .commands import run_command
from .mutations import NUMBERS, TEXTS, hostile_value
from .options import command_with_options
from .readers import FOREIGN_LOGS, READERS, Case, import_case, load_case

pytestmark = [pytest.mark.integration, pytest.mark.filterwarnings("ignore:Generating overly large repr")]

FEW, MANY = 5, 400
FUZZING = {
    "deadline": None,
    "derandomize": True,
    "database": None,
    "suppress_health_check": list(HealthCheck),
}
REFUSALS: list[str] = []  # messages about options and actions, none of which may be empty
CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())


def assert_handled(case: Case) -> None:
    """Assert that a command ends with its result or is refused with one line."""
    with tempfile.TemporaryDirectory() as temporary:
        case.write(Path(temporary))
        assert run_command(case.words, Path(temporary)).problem == ""


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("count", [FEW, pytest.param(MANY, marks=pytest.mark.slow)])
def test_a_damaged_file_is_read_or_refused(reader: str, count: int) -> None:
    @settings(max_examples=count, **FUZZING)
    @given(READERS[reader]())
    def check(case: Case) -> None:
        assert_handled(case)

    check()
    assert all(REFUSALS)


@pytest.mark.parametrize("name", FOREIGN_LOGS)
def test_the_logs_that_are_damaged_are_imported_as_they_are(name: str, tmp_path: Path) -> None:
    case = import_case(name)
    case.write(tmp_path)
    assert run_command(case.words, tmp_path).code == 0


@pytest.mark.parametrize("folder", CORPUS, ids=lambda folder: folder.name)
def test_a_failure_that_fuzzing_found_stays_mended(folder: Path) -> None:
    assert_handled(load_case(folder))


@pytest.mark.parametrize("count", [60, pytest.param(2000, marks=pytest.mark.slow)])
def test_options_of_every_command_are_accepted_or_refused(count: int) -> None:
    @settings(max_examples=count, **FUZZING)
    @given(command_with_options())
    def check(case: Case) -> None:
        assert_handled(case)

    check()
    assert all(REFUSALS)


ENV_OPTIONS: dict[str, st.SearchStrategy[Any]] = {
    "machine": st.sampled_from(("hframe", "axis", "nothing", "", 3, None)),
    "task": st.sampled_from(("reach", "track", "fly", "os:system", None, 1.0)),
    "reward": st.sampled_from((None, "dense", "progress", "sparse", "none", 1)),
    "randomize": st.sampled_from(("none", "default", "wide", "identified", "all", [], [1], None)),
    "sensors": st.sampled_from(("state", "rig", "machine", "eyes", None)),
    "drives": st.sampled_from(("ideal", "rig", "machine", "none", None)),
    **{name: st.sampled_from((True, False, None, 1, "yes")) for name in ("privileged", "normalize", "flat")},
    "ends": st.sampled_from(("stops", "terminate", "explode", None)),
    **{
        name: st.sampled_from((*NUMBERS, "0.01", None, [0.01]))
        for name in ("penalty", "period", "longest_step")
    },
}


@st.composite
def env_options(draw: st.DrawFn) -> dict[str, Any]:
    """Return a strategy for one to three keywords of an environment."""
    names = draw(st.lists(st.sampled_from(sorted(ENV_OPTIONS)), min_size=1, max_size=3, unique=True))
    return {name: draw(ENV_OPTIONS[name]) for name in names}


@pytest.mark.parametrize("count", [60, pytest.param(2000, marks=pytest.mark.slow)])
def test_options_of_environments_are_accepted_or_refused(count: int) -> None:
    @settings(max_examples=count, **FUZZING)
    @given(env_options(), st.integers(-1, 3))
    def check(options: dict[str, Any], seed: int) -> None:
        try:
            env = HFrameEnv(**options)
        except (ValueError, TypeError) as error:
            REFUSALS.append(str(error))
            return
        if seed < 0:
            return
        observation, _ = env.reset(seed=seed)
        observation, reward, *_ = env.step(env.action_space.sample())
        arrays = observation.values() if isinstance(observation, dict) else [observation]
        assert all(np.isfinite(array).all() for array in arrays)
        assert math.isfinite(reward)

    check()
    assert all(REFUSALS)


ACTIONS = st.one_of(
    st.lists(st.one_of(st.floats(width=32), st.sampled_from((0.0, 1.0, -1.0, 5.0))), max_size=3),
    st.sampled_from((None, "left", [[0.0, 0.0]], 0.0, [None, None], ["0", "0"], [0, 10**400], {"a": 1})),
)


@pytest.mark.parametrize("count", [150, pytest.param(5000, marks=pytest.mark.slow)])
def test_actions_are_applied_or_refused(count: int) -> None:
    env, envs = HFrameEnv(randomize="wide"), HFrameVectorEnv(2)

    @settings(max_examples=count, **FUZZING)
    @given(ACTIONS)
    def check(action: Any) -> None:
        env.reset(seed=1)
        envs.reset(seed=1)
        for step, shape in ((env.step, (2,)), (envs.step, (2, 2))):
            batch = action if shape == (2,) else [action, action]
            try:
                observation, reward, *_ = step(batch)
            except (ValueError, TypeError, OverflowError) as error:
                REFUSALS.append(str(error))
            else:
                assert np.asarray(batch, float).shape == shape
                assert np.isfinite(batch).all()
                assert np.isfinite(reward).all()
                assert all(np.isfinite(array).all() for array in observation.values())

    check()
    assert all(REFUSALS)


@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_options_of_a_reset_are_accepted_or_refused(count: int) -> None:
    env = HFrameEnv()
    points = st.one_of(st.lists(st.floats(), max_size=3), hostile_value())

    @settings(max_examples=count, **FUZZING)
    @given(st.dictionaries(st.sampled_from(("start", "target", "goal", *TEXTS[:4])), points, max_size=2))
    def check(options: dict[str, Any]) -> None:
        try:
            observation, _ = env.reset(seed=0, options=options)
        except (ValueError, TypeError) as error:
            REFUSALS.append(str(error))
        else:
            assert all(np.isfinite(array).all() for array in observation.values())

    check()
    assert all(REFUSALS)
