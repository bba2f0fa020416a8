"""Pictures: shape, content, and the message where pygame is missing."""

import dataclasses
import itertools
import os
import shutil
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

from hframe_gym.envs import HFrameEnv, HFrameVectorEnv
from hframe_gym.envs.rendering import HEIGHT, NEUTRAL, PATH, TARGET, TAUT, UNKNOWN, WIDTH, tension_color
from hframe_gym.machine import BUILTIN_MACHINES, BeltGeometry


def test_picture_shows_the_target_and_the_motion():
    env = HFrameEnv(render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (HEIGHT, WIDTH, 3)
    assert first.dtype == np.uint8
    assert (first == np.array(TARGET)).all(axis=2).any()
    for _ in range(10):
        env.step(np.ones(2, np.float32))
    second = env.render()
    assert (first != second).any()
    assert not np.shares_memory(first, second)


def test_one_picture_per_environment():
    envs = HFrameVectorEnv(3, render_mode="rgb_array")
    envs.reset(seed=0)
    frames = envs.render()
    assert len(frames) == 3
    assert (frames[0] != frames[1]).any()


@pytest.mark.parametrize("position", [(0.0, 0.0), (0.2, -0.1)])
def test_the_belt_is_one_closed_line(position):
    sections = BeltGeometry(np.array([[-0.28, 0.28], [-0.19, 0.19]])).sections(*position)
    path = [sections[name] for name in ("s7", "s5", "s1", "s3", "s9", "s4", "s2", "s6", "s8")]
    for a, b in itertools.pairwise(path):
        np.testing.assert_allclose(a[-1], b[0], atol=1e-9)
    assert path[0][0] == pytest.approx(path[-1][-1])


@pytest.mark.parametrize("machine", ["hframe", "corexy"])
def test_stretched_belts_are_colored_on_every_stage(machine):
    env = HFrameEnv(machine=machine, render_mode="rgb_array", period=0.002)
    env.reset(seed=0)

    def reddish():
        red, green, blue = np.moveaxis(env.render().astype(int), 2, 0)
        return ((red - green > 25) & (abs(green - blue) < 20)).sum()

    assert reddish() == 0
    for _ in range(10):
        env.step(np.array([1.0, 0.0], np.float32))
    assert reddish() > 500


def test_a_stage_of_another_kind_is_drawn_without_belts():
    corexy = BUILTIN_MACHINES["corexy"]()
    x_belt, _, y_belt, _ = corexy.belts
    belts = (
        dataclasses.replace(x_belt, extension={"x": 1.0, "phi1": -1.0}, length={}),
        dataclasses.replace(y_belt, extension={"y": 1.0, "phi2": -1.0}, length={}),
    )
    env = HFrameEnv(machine=corexy.replace(belts=belts, ties={}), render_mode="rgb_array")
    env.reset(seed=0)
    assert not (env.render() == np.array(NEUTRAL)).all(axis=2).any()


def test_colors_follow_the_tension():
    assert tension_color(0.0) == NEUTRAL
    assert tension_color(1e4) == TAUT
    assert tension_color(None) == UNKNOWN


def test_the_message_without_pygame_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    env = HFrameEnv(render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(ImportError, match=r"hframe_gym\[render\]"):
        env.render()


def test_a_copy_has_no_window():
    import copy

    env = HFrameEnv(render_mode="rgb_array")
    env.reset(seed=0)
    env.render()
    np.testing.assert_array_equal(copy.deepcopy(env).render(), env.render())


def test_the_path_of_a_moving_goal_is_drawn():
    env = HFrameEnv(render_mode="rgb_array", task="track")
    env.reset(seed=0)
    on_path = np.argwhere((env.render() == np.array(PATH)).all(axis=2))
    # A circle of 50 mm is 47 pixels across.
    assert 40 < np.ptp(on_path[:, 0]) < 55


def test_a_window_opens_and_closes():
    xvfb = shutil.which("xvfb-run")
    if xvfb is None:
        pytest.skip("needs xvfb-run")
    show = (
        "import numpy as np; from hframe_gym.envs import HFrameEnv; env = HFrameEnv(render_mode='human'); "
        "env.reset(seed=0); [env.step(np.ones(2)) for _ in range(5)]; import pygame; "
        "assert pygame.display.get_init(); env.close(); assert not pygame.display.get_init()"
    )
    subprocess.run([xvfb, "-a", sys.executable, "-c", show], check=True, timeout=120)


def test_a_video_is_recorded(tmp_path):
    pytest.importorskip("moviepy")
    env = gym.wrappers.RecordVideo(
        gym.make("HFrame-v0", render_mode="rgb_array"), str(tmp_path / "videos"), disable_logger=True
    )
    env.reset(seed=0)
    for _ in range(20):
        env.step(np.ones(2, np.float32))
    env.close()
    (video,) = tmp_path.glob("videos/*.mp4")
    assert video.stat().st_size > 1000


def test_a_window_without_a_display_is_refused_with_a_remedy():
    code = "import gymnasium as gym, hframe_gym; gym.make('HFrame-v0', render_mode='human').reset()"
    environment = {**os.environ, "SDL_VIDEODRIVER": "no-such-driver"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert "InputError: render_mode='human' needs a display" in done.stderr
    assert "use render_mode='rgb_array'" in done.stderr
