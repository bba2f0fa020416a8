"""Provide the fixtures that several packages' tests use, and mark the unit tests."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:
    # The workers of pytest-xdist occupy all cores, so that threads of the linear algebra library would wait
    # for each other. NumPy reads the variable when it is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

from hframe_gym import cli
from hframe_gym.evaluation import Scenario
from hframe_gym.machine import BUILTIN_MACHINES, Machine

HEADER = "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m"
NOT_UNIT = ("integration", "oracle", "train", "slow")

# Modules and tests live until the end. To search them for garbage while they are created takes a third of the
# time of the collection. During the tests, Python's thresholds (700, 10, 10) cause searches that take 4 % of
# the time.
gc.disable()
GC_THRESHOLDS = (20_000, 20, 20)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Exclude what exists after the collection of the tests from garbage collection, and switch it on."""
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(*GC_THRESHOLDS)
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # before pytest selects by marker
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test as `unit` that carries none of the markers in `NOT_UNIT`, and put those of JAX last.

    JAX starts threads, and a process with threads must not be forked, as the tests of interruptions do.
    """
    items.sort(key=lambda item: "jax" in item.path.name)
    for item in items:
        if not any(item.get_closest_marker(name) for name in NOT_UNIT):
            item.add_marker("unit")


@pytest.fixture
def hframe() -> Machine:
    """Return the nonlinear 8th-order H-frame as declared."""
    return BUILTIN_MACHINES["hframe"]()


@pytest.fixture
def axis() -> Machine:
    """Return the single axis, with a voltage v_V and a position x_m, as declared."""
    return BUILTIN_MACHINES["axis"]()


@pytest.fixture
def without_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave plots out of report pages, for tests of their texts: drawing takes nine tenths of the time."""
    monkeypatch.setattr("hframe_gym.web_page.page.panel_svg", lambda panel, prefix: "")
    monkeypatch.setattr(
        "hframe_gym.identification.report.plots.panels.save_panels", lambda panels, path: None
    )


@pytest.fixture
def brief_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluate agents in training on two episodes of 0.1 s, for tests of what a run writes and says."""
    monkeypatch.setattr("hframe_gym.agents.training.EVALUATION_EPISODES", 2)
    monkeypatch.setattr("hframe_gym.agents.training.Scenario", partial(Scenario, duration_s=0.1))


@pytest.fixture
def write_run(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a valid recording of 20 rows and returns its path.

    Its argument `cells` replaces cells by (row counted from 1, column name); `header` replaces the header
    line.
    """

    def write(
        name: str = "run.csv",
        cells: dict[tuple[int, str], str] | None = None,
        header: str = HEADER,
        rows: int = 20,
    ) -> Path:
        names = HEADER.split(",")
        table = np.zeros((rows, len(names)))
        table[:, 0] = 5.0 + 1e-3 * np.arange(rows)
        table[rows // 2 :, 1:3] = -4.0
        text = [[f"{value:.9g}" for value in row] for row in table]
        for (row, column), cell in (cells or {}).items():
            text[row - 1][names.index(column)] = cell
        path = tmp_path / name
        path.write_text("\n".join([header, *(",".join(row) for row in text)]) + "\n")
        return path

    return write


@pytest.fixture
def hframe_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Return a function that runs the command in this process: exit code, standard output, standard error."""

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["hframe", *map(str, words)])
        try:
            cli.main()
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 0
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run
