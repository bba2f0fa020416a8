"""Tests of the window in which a user drives a stage; SDL draws it without a display."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.cli import app
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario

pytestmark = pytest.mark.integration
pygame = pytest.importorskip("pygame")
START, TARGET = (-0.05, 0.02), (0.06, -0.03)  # m


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(os.environ, "SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


def game_of(**options: Any) -> Any:
    from hframe_gym.envs import Reach
    from hframe_gym.evaluation.play import Game

    return Game(
        Scenario(task=Reach(start=START, target=TARGET), randomize="none"), **({"speed": 0.5} | options)
    )


def press(key: int, *, down: bool = True) -> None:
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN if down else pygame.KEYUP, key=key))


@pytest.mark.parametrize(
    ("key", "direction"),
    [(pygame.K_RIGHT, (1, 0)), (pygame.K_LEFT, (-1, 0)), (pygame.K_UP, (0, 1)), (pygame.K_DOWN, (0, -1))],
)
def test_an_arrow_key_pushes_the_tool_in_its_direction_while_it_is_held(
    key: int, direction: tuple[int, int]
) -> None:
    game = game_of()
    press(key)
    game.run(frames=12)
    moved = np.subtract(game.stages[0].position, START)
    assert moved @ direction > 0.01
    assert abs(moved @ direction[::-1]) < 0.2 * (moved @ direction)
    press(key, down=False)
    game.run(frames=2)
    np.testing.assert_array_equal(game.stages[0].volts, 0.0)


def test_shift_applies_the_rated_voltage() -> None:
    game = game_of()
    press(pygame.K_RIGHT)
    game.run(frames=2)
    gentle = np.abs(game.stages[0].volts).max()
    press(pygame.K_LSHIFT)
    game.run(frames=2)
    assert np.abs(game.stages[0].volts).max() == pytest.approx(12.0)
    assert gentle == pytest.approx(0.4 * 12.0)


def test_the_mouse_pulls_the_tool_to_the_pointer() -> None:
    game = game_of()
    view = game.stages[0].view
    pixel = view._pixel(TARGET)
    assert view.point(pixel) == pytest.approx(TARGET, abs=1e-3)
    pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, button=1, pos=pixel))
    distance = game.stages[0].distance
    game.run(frames=60)
    assert game.stages[0].distance < 0.3 * distance


def test_a_controller_beside_has_the_same_start_and_goal_and_settles() -> None:
    game = game_of(beside="pid")
    you, pid = game.stages
    assert (you.name, pid.name) == ("you", "pid")
    assert you.position == pid.position == pytest.approx(START)
    game.run(frames=80)
    assert you.position == pytest.approx(START)  # nobody drives it
    assert you.settled_s is None
    assert pid.settled_s is not None
    assert 0.05 < pid.settled_s < 0.5
    assert game.window.get_width() > 1.4 * game.window.get_height()


def test_the_stage_has_the_drives_of_the_scenario() -> None:
    from hframe_gym.evaluation.play import PlayedStage

    scenario, positions = Scenario(randomize="none"), []
    for drives in ("ideal", "rig"):
        stage = PlayedStage(replace(scenario, drives=drives), None)
        stage.reset(0)
        stage.step(np.array([0.1234, 0.05678]))  # the rig's converters round these voltages
        positions.append(stage.position)
    assert positions[0] != positions[1]


def test_pause_new_episode_target_and_quit() -> None:
    game = game_of()
    press(pygame.K_SPACE)
    game.run(frames=5)
    assert game.paused
    assert game.stages[0].elapsed_s == 0.0
    press(pygame.K_SPACE)
    press(pygame.K_RIGHT)
    game.run(frames=20)
    before = game.stages[0].position
    pygame.event.post(
        pygame.event.Event(pygame.MOUSEBUTTONDOWN, button=3, pos=game.stages[0].view._pixel((0.0, 0.0)))
    )
    press(pygame.K_RIGHT, down=False)
    game.run(frames=1)
    assert game.stages[0].position == pytest.approx(before, abs=1e-6)
    assert game.stages[0].distance == pytest.approx(np.hypot(*before), abs=2e-3)
    press(pygame.K_n)
    game.run(frames=1)
    assert game.seed == 1
    press(pygame.K_q)
    game.run()
    assert game.done


def test_a_target_outside_the_workspace_changes_nothing() -> None:
    game = game_of()
    distance = game.stages[0].distance
    pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, button=3, pos=(2, 2)))
    game.run(frames=1)
    assert game.stages[0].distance == pytest.approx(distance)


def test_the_command_saves_a_picture_of_both_stages(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    picture = tmp_path / "play.png"
    options = ["--task", "track", "--frames", "3", "--speed", "1", "--picture", str(picture)]
    result = CliRunner().invoke(app, ["play", "pid", "--beside", "textbook-pid", *options])
    assert result.exit_code == 0, result.output
    assert "pid: " in result.output
    pixels = pygame.surfarray.array3d(pygame.image.load(picture))
    left, right = pixels[: len(pixels) // 2], pixels[len(pixels) // 2 :]
    assert len(np.unique(left.reshape(-1, 3), axis=0)) > 20
    assert len(np.unique(right.reshape(-1, 3), axis=0)) > 20


def test_a_speed_that_is_not_positive_is_refused() -> None:
    with pytest.raises(InputError, match="speed is 0"):
        game_of(speed=0.0)


def test_a_missing_display_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "SDL_VIDEODRIVER", "no-such-driver")
    pygame.display.quit()
    with pytest.raises(InputError, match="needs a display"):
        game_of()
