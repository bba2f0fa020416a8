"""Tests of the plot of an episode."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.evaluation import Episodes
from hframe_gym.evaluation.plotting import plot_episode, save_plot


def recorded(contour: bool = False) -> Episodes:
    """Return two recorded episodes of 31 samples and three control periods."""
    rng = np.random.default_rng(0)
    return Episodes(
        time_s=1e-3 * np.arange(31),
        position=rng.normal(0.0, 0.01, (2, 31, 2)),
        goal=np.zeros((2, 31, 2)),
        contour=np.abs(rng.normal(0.0, 1e-4, (2, 31))) if contour else None,
        volts=rng.uniform(-12.0, 12.0, (2, 3, 2)),
        rated=np.full(2, 12.0),
        energy_J=np.zeros(2),
        peak_belt_force_N=np.zeros(2),
    )


@pytest.mark.parametrize("contour", [False, True])
def test_plot_is_written_completely(tmp_path: Path, contour: bool) -> None:
    pytest.importorskip("matplotlib")
    save_plot(tmp_path / "run.png", recorded(contour), 1, title="idle")
    assert (tmp_path / "run.png").stat().st_size > 1000
    assert [p.name for p in tmp_path.iterdir()] == ["run.png"]


def test_curves_are_those_of_the_episode() -> None:
    pytest.importorskip("matplotlib")
    episodes = recorded(contour=True)
    path, error, _ = plot_episode(episodes, 1).axes
    np.testing.assert_allclose(path.lines[1].get_xydata(), 1e3 * episodes.position[1])
    np.testing.assert_allclose(error.lines[0].get_ydata(), 1e3 * episodes.goal_error[1])


def test_an_episode_that_does_not_exist_is_rejected() -> None:
    pytest.importorskip("matplotlib")
    with pytest.raises(IndexError, match="episode 2 of 2"):
        plot_episode(recorded(), 2)


def test_a_missing_matplotlib_is_reported_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"hframe_gym\[report\]"):
        plot_episode(recorded())
