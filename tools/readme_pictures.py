"""Make pictures of README.md and docs/reports.md: two controllers in motion, a report and a scorecard.

    python -m tools.readme_pictures                     # all pictures
    python -m tools.readme_pictures --only animation
    python -m tools.readme_pictures --only report
    python -m tools.readme_pictures --only scorecard

The animation, docs/figures/controllers.webp, shows the model-based controller `pid` and the shipped agent
`ppo` on the same episodes, drawn by the environment's renderer. The report, docs/figures/report_page.png, is
the upper part of the page that `hframe identify examples/rig_a` writes, as headless Chromium displays it; it
needs Chromium, and 15 to 60 s for the identification. The scorecard, docs/figures/scorecard_page.png,
compares two controllers in 64 episodes.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import hframe_gym
from tools.command_line import command_line
from tools.repository import FIGURES, ROOT

CONTROLLERS = {
    "pid": ("Model-based controller (pid)", (31, 95, 191)),
    "ppo": ("Trained agent (ppo)", (196, 84, 14)),
}
SEEDS = (4, 7)  # two long moves, in different directions
FRAME_S = 0.01  # s of the episode between two pictures; both controllers act in every one
STEPS = 45  # pictures of an episode: both controllers are within 0.2 mm by then
SLOWDOWN = 6  # a frame is displayed for 60 ms
HOLD_S = 1.2  # s for which the last picture of an episode stays

WIDTH = 880  # pixels of the animation
SCALE = 2  # pictures are composed at this multiple of the final size and reduced, which smooths all lines
# Part of the renderer's picture that holds the stage: left, top, right, bottom, pixels.
STAGE = (60, 54, 820, 646)
HEADER, STAGE_HEIGHT, CURVE_HEIGHT = 58, 330, 150  # pixels of the three parts, from the top
ERROR_MM = (0.01, 500.0)  # mm, ends of the logarithmic axis of the distance
QUALITY = 80  # of the WebP pictures, 0 to 100

PAPER, INK, MUTED, GRID = (250, 250, 248), (36, 41, 47), (99, 108, 118), (224, 227, 231)

REPORT_SIZE = (1180, 900)  # pixels of the browser's window
CHROMIUM_OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--blink-settings=preferredColorScheme=1", "--virtual-time-budget=5000"),
)


@dataclass(frozen=True)
class Rollout:
    """Pictures and distances of one controller in one episode.

    Attributes:
        pictures: Pictures of the renderer, one every `FRAME_S`, each uint8, shape (height, width, 3).
        distance_mm: Distance of the tool to its goal in these pictures, mm, shape (STEPS + 1,).
        goal: Goal (x, y), m, shape (2,).
    """

    pictures: list[NDArray[np.uint8]]
    distance_mm: NDArray[np.float64]
    goal: NDArray[np.float64]


def roll_out(controller_name: str, seed: int) -> Rollout:
    """Simulate and draw one episode under one controller.

    Args:
        controller_name: Name for `hframe_gym.make_controller`.
        seed: Seed of the episode, which determines start and goal.
    """
    controller = hframe_gym.make_controller(controller_name)
    env = gym.make("HFrame-v0", render_mode="rgb_array", period=FRAME_S, max_episode_steps=None)
    observation, info = env.reset(seed=seed)
    controller.reset()
    pictures, distances = [np.asarray(env.render())], [info["distance_m"]]
    for _ in range(STEPS):
        batch = {key: value[np.newaxis] for key, value in observation.items()}
        action = np.clip(controller.act(batch)[0], -1.0, 1.0).astype(np.float32)
        observation, _, _, _, info = env.step(action)
        pictures.append(np.asarray(env.render()))
        distances.append(info["distance_m"])
    env.close()
    return Rollout(pictures, 1e3 * np.array(distances), np.asarray(observation["desired_goal"]))


def _font(size: int, bold: bool = False) -> Any:
    """Return the sans-serif font that Matplotlib contains, for text of a height in final pixels."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), size * SCALE)


class Composition:
    """Compose the pictures of an episode: both stages side by side, and the distances over time below them.

    Args:
        rollouts: One per entry of `CONTROLLERS`, all of the same episode.
    """

    def __init__(self, rollouts: Sequence[Rollout]) -> None:
        self._rollouts = rollouts
        self._small, self._large, self._bold = _font(13), _font(16), _font(16, bold=True)
        self._left, self._right = 76 * SCALE, (WIDTH - 24) * SCALE  # of the distance's axis
        self._top = (HEADER + STAGE_HEIGHT + 12) * SCALE
        self._bottom = (HEADER + STAGE_HEIGHT + CURVE_HEIGHT - 30) * SCALE

    def frame(self, step: int) -> Image.Image:
        """Compose one picture.

        Args:
            step: Number of pictures since the start of the episode.

        Returns:
            Picture, RGB, `WIDTH` pixels wide.
        """
        size = (WIDTH, HEADER + STAGE_HEIGHT + CURVE_HEIGHT)
        image = Image.new("RGB", (size[0] * SCALE, size[1] * SCALE), PAPER)
        draw = ImageDraw.Draw(image)
        for i, ((label, color), rollout) in enumerate(zip(CONTROLLERS.values(), self._rollouts, strict=True)):
            self._draw_stage(image, draw, i * WIDTH // 2 * SCALE, label, color, rollout, step)
        self._draw_axes(draw, step)
        for (_, color), rollout in zip(CONTROLLERS.values(), self._rollouts, strict=True):
            points = [self._point(k, d) for k, d in enumerate(rollout.distance_mm[: step + 1])]
            if step:
                draw.line(points, color, 2 * SCALE, joint="curve")
            x, y = points[-1]
            draw.ellipse((x - 4 * SCALE, y - 4 * SCALE, x + 4 * SCALE, y + 4 * SCALE), color)
        return image.resize(size, Image.Resampling.LANCZOS)

    def _draw_stage(
        self,
        image: Image.Image,
        draw: ImageDraw.ImageDraw,
        left: int,
        label: str,
        color: tuple[int, int, int],
        rollout: Rollout,
        step: int,
    ) -> None:
        """Draw one half of the upper part: label, distance and stage."""
        middle, width = left + WIDTH * SCALE // 4, STAGE[2] - STAGE[0]
        stage = Image.fromarray(rollout.pictures[step]).crop(STAGE)
        height = STAGE_HEIGHT * SCALE
        stage = stage.resize(
            (round(width * height / (STAGE[3] - STAGE[1])), height), Image.Resampling.LANCZOS
        )
        image.paste(stage, (middle - stage.width // 2, HEADER * SCALE))
        draw.text((middle, 10 * SCALE), label, color, self._bold, anchor="ma")
        distance = rollout.distance_mm[step]
        text = f"{distance:.0f} mm" if distance >= 10.0 else f"{distance:.2f} mm"
        draw.text((middle, 34 * SCALE), f"{text} from the goal", INK, self._large, anchor="ma")

    def _point(self, step: float, distance_mm: float) -> tuple[float, float]:
        """Return the pixel of a distance at a step of the episode."""
        low, high = (math.log(end) for end in ERROR_MM)
        height = (min(max(math.log(max(distance_mm, 1e-9)), low), high) - low) / (high - low)
        x = self._left + (self._right - self._left) * step / STEPS
        return x, self._bottom - (self._bottom - self._top) * height

    def _draw_axes(self, draw: ImageDraw.ImageDraw, step: int) -> None:
        """Draw the axes of distance and time, and the time of this picture."""
        for tick, name in ((100.0, "100 mm"), (10.0, ""), (1.0, "1 mm"), (0.1, ""), (0.01, "0.01 mm")):
            _, y = self._point(0, tick)
            draw.line((self._left, y, self._right, y), GRID, SCALE)
            draw.text((self._left - 8 * SCALE, y), name, MUTED, self._small, anchor="rm")
        ticks = range(0, STEPS + 1, 10)
        for tick in ticks:
            x, _ = self._point(tick, 1.0)
            draw.text(
                (x, self._bottom + 8 * SCALE), f"{tick * FRAME_S:.1f} s", MUTED, self._small, anchor="ma"
            )
        text = f"distance to the goal, t = {step * FRAME_S:.2f} s, {SLOWDOWN} times slower than real time"
        # Below the curves, which begin at the top and end at the right.
        draw.text((self._left + 8 * SCALE, self._bottom - 6 * SCALE), text, MUTED, self._small, anchor="ls")


def make_animation(path: Path) -> None:
    """Write the animation of both controllers on the same episodes.

    Args:
        path: WebP file.
    """
    frames: list[Image.Image] = []
    durations: list[int] = []
    for seed in SEEDS:
        rollouts = [roll_out(name, seed) for name in CONTROLLERS]
        composition = Composition(rollouts)
        frames += [composition.frame(step) for step in range(STEPS + 1)]
        durations += [round(1e3 * FRAME_S * SLOWDOWN)] * STEPS + [round(1e3 * HOLD_S)]
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=QUALITY, method=4
    )


def make_report(path: Path) -> None:
    """Identify examples/rig_a and write a picture of the upper part of its report.

    Args:
        path: PNG file.

    Raises:
        SystemExit: If there is no Chromium.
    """
    with tempfile.TemporaryDirectory() as folder:
        report = Path(os.environ.get("README_REPORT", Path(folder) / "out" / "rig_a"))
        if not (report / "report.html").is_file():
            runs = str(ROOT / "examples" / "rig_a")
            # In the folder, so that the commands on the page have the short paths that users see.
            command = [sys.executable, "-m", "hframe_gym", "identify", runs, "--out", "out/rig_a"]
            subprocess.run(command, cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)}, check=True)
        screenshot(_browser(), (report / "report.html").as_uri(), path)
    _reduce_colors(path)


def make_scorecard(path: Path) -> None:
    """Evaluate two controllers and write a picture of the upper part of their scorecard.

    Args:
        path: PNG file.

    Raises:
        SystemExit: If there is no Chromium.
    """
    command = [sys.executable, "-m", "hframe_gym", "evaluate", "pid", "textbook-pid", "--episodes", "64"]
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        subprocess.run([*command, "--html", "--out", "scores"], cwd=folder, env=environment, check=True)
        screenshot(_browser(), (Path(folder) / "scores" / "scorecard.html").as_uri(), path)
    _reduce_colors(path)


def _browser() -> str:
    """Return the path of Chromium."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("pictures of pages need Chromium: apt-get install chromium")
    return browser


def _reduce_colors(path: Path) -> None:
    """Write a picture with fewer colors, so that the repository stays small."""
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(128, Image.Quantize.MEDIANCUT).save(path, optimize=True)


def screenshot(browser: str, address: str, path: Path) -> None:
    """Write a picture of a page in headless Chromium, with a window of `REPORT_SIZE`.

    Args:
        browser: Path of the browser.
        path: PNG file.

    Raises:
        subprocess.CalledProcessError: If the browser fails.
    """
    with tempfile.TemporaryDirectory() as profile:
        width, height = REPORT_SIZE
        options = [f"--user-data-dir={profile}", f"--window-size={width},{height}", f"--screenshot={path}"]
        subprocess.run([browser, *CHROMIUM_OPTIONS, *options, address], check=True, capture_output=True)


def main() -> None:
    """Make the pictures that the command line names."""
    parser = command_line(__doc__)
    parser.add_argument("--only", choices=("animation", "report", "scorecard"), help="make only this picture")
    only = parser.parse_args().only
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    for name, make, path in (
        ("animation", make_animation, FIGURES / "controllers.webp"),
        ("report", make_report, FIGURES / "report_page.png"),
        ("scorecard", make_scorecard, FIGURES / "scorecard_page.png"),
    ):
        if only in (None, name):
            make(path)
            print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
