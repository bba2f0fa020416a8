"""Pictures of a stage: frame, bridge, cart, the belt along its path coloured by tension, target and trail.

Drawn with pygame, the extra `render`, from above: x to the right, y up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .belt_path import RADIUS, BeltGeometry, Point, section_tension

if TYPE_CHECKING:
    from .environment_batch import EnvironmentBatch

TRAIL = 300  # points of the trail that are kept
PATH_S = 3.0  # s of an episode for which the path of a moving goal is drawn
WIDTH, HEIGHT = 880, 660  # pixels
FULL_COLOUR = 40.0  # N of tension beyond (or below) pretension for the full colour

PAPER, RAIL, BODY, CART, INK = (250, 250, 248), (214, 217, 222), (176, 183, 193), (92, 103, 120), (44, 50, 60)
SLACK, NEUTRAL, TAUT, UNKNOWN = (43, 108, 196), (146, 146, 150), (214, 48, 39), (120, 120, 124)
TARGET, PATH, TRACE = (22, 140, 92), (150, 206, 178), (238, 140, 20)


@dataclass(frozen=True)
class Scene:
    """What a picture shows.  position, target, trail, path: m.  angles: of the motors, rad.  tensions: by belt, N."""

    position: Point
    target: Point
    band: float
    angles: tuple[float, float]
    tensions: dict[str, float]
    trail: Sequence[Point]
    path: Sequence[Point]
    time_s: float
    distance: float


def scene(batch: EnvironmentBatch, b: int, trail: Sequence[Point]) -> Scene:
    """The scene of environment b of a batch."""
    index = np.array([b])
    position = batch.stages.positions(b)
    # A drive that turns no pulley is drawn at rest.
    turning = [d.coordinate for d in batch.machine.drives if batch.machine.coordinate(d.coordinate).kind == "rotary"]
    angles = [position[c] for c in turning[:2]] + [0.0, 0.0]
    x, y = batch.goals.now(index)[0].tolist()
    return Scene(
        position=(position["x"], position["y"]),
        target=(x, y),
        band=batch.task.band,
        angles=(angles[0], angles[1]),
        tensions=batch.stages.tensions(b),
        trail=list(trail),
        path=batch.goals.path(b, np.arange(0.0, PATH_S, batch.settings.period)).tolist(),
        time_s=float(batch.elapsed[b] * batch.settings.period),
        distance=float(batch.distance(index)[0]),
    )


def check_mode(mode: str | None, known: Sequence[str]) -> str | None:
    """The render mode, if it is one.

    Raises ValueError for an unknown mode.
    """
    if mode is not None and mode not in known:
        raise ValueError(f"render_mode is {mode!r}, choose one of {', '.join(known)} or None")
    return mode


def load_pygame() -> Any:
    """pygame, imported where it is needed.

    Raises ImportError naming the extra that installs it.
    """
    try:
        import pygame
    except ImportError as error:
        raise ImportError("rendering needs pygame: pip install 'hframe-gym[render]'") from error
    return pygame


def tension_colour(tension: float | None) -> tuple[int, int, int]:
    """Blue where a belt is slacker than its pretension, red where it is tighter, by N."""
    if tension is None or not math.isfinite(tension):
        return UNKNOWN
    share = min(1.0, abs(tension) / FULL_COLOUR)
    end = TAUT if tension > 0 else SLACK
    r, g, b = (round(a + share * (e - a)) for a, e in zip(NEUTRAL, end, strict=True))
    return r, g, b


class Renderer:
    """Draws scenes of one machine, into a window (mode human) or an array (rgb_array)."""

    def __init__(self, machine: Machine, mode: str, fps: int) -> None:
        self._pygame = load_pygame()
        self.mode = mode
        self.fps = fps
        self._geometry = BeltGeometry(np.array([machine.coordinate(name).range for name in ("x", "y")]))
        g = self._geometry
        margin = 0.06
        self._scale = min(WIDTH / (g.x1 - g.x0 + 2 * margin), (HEIGHT - 40) / (g.y1 - g.y0 + 2 * margin))
        self._middle = ((g.x0 + g.x1) / 2, (g.y0 + g.y1) / 2)
        self._surface = self._pygame.Surface((WIDTH, HEIGHT))
        self._background = self._draw_frame()
        self._pygame.font.init()
        self._font = self._pygame.font.Font(None, 22)
        self._window: Any = None
        self._clock: Any = None

    def _at(self, point: Point) -> tuple[int, int]:
        x = WIDTH / 2 + (point[0] - self._middle[0]) * self._scale
        y = (HEIGHT + 30) / 2 - (point[1] - self._middle[1]) * self._scale
        return round(x), round(y)

    def _length(self, metres: float) -> int:
        return max(1, round(metres * self._scale))

    def _box(self, x0: float, y0: float, x1: float, y1: float) -> Any:
        (left, bottom), (right, top) = self._at((x0, y0)), self._at((x1, y1))
        return self._pygame.Rect(left, top, right - left, bottom - top)

    def _draw_frame(self) -> Any:
        """What does not move: the frame's rails, the workspace's edge."""
        surface, draw, g = self._pygame.Surface((WIDTH, HEIGHT)), self._pygame.draw, self._geometry
        surface.fill(PAPER)
        for y in (g.y0, g.y1):
            draw.rect(surface, RAIL, self._box(g.x0 - 0.03, y - 0.03, g.x1 + 0.03, y + 0.03), border_radius=8)
        draw.rect(surface, RAIL, self._box(g.left, g.low, g.right, g.high), width=1)
        return surface

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """The picture (HEIGHT, WIDTH, 3) in mode rgb_array; shows it and returns None in mode human."""
        surface, draw = self._surface, self._pygame.draw
        surface.blit(self._background, (0, 0))
        self._draw_bridge(scene.position[0])
        self._draw_belt(scene)
        self._draw_pulleys(scene)
        x, y = scene.position
        draw.rect(surface, CART, self._box(x - 0.055, y - 0.028, x + 0.055, y + 0.028), border_radius=6)
        self._draw_line(scene.path, PATH, 3)
        self._draw_line(scene.trail, TRACE, 2)
        self._draw_target(scene)
        draw.circle(surface, PAPER, self._at(scene.position), 5)
        draw.circle(surface, INK, self._at(scene.position), 2)
        text = f"t = {scene.time_s:.2f} s    distance = {1e3 * scene.distance:.3f} mm    belts: "
        self._write(text + "    ".join(f"{k} {v:+.0f} N" for k, v in list(scene.tensions.items())[:3]))
        return self._show()

    def _draw_bridge(self, x: float) -> None:
        g, draw = self._geometry, self._pygame.draw
        for y, inward in ((g.y0, 1.0), (g.y1, -1.0)):
            low, high = sorted((y - 0.012 * inward, y + 0.062 * inward))
            draw.rect(self._surface, BODY, self._box(x - 0.092, low, x + 0.092, high), border_radius=8)
        draw.rect(self._surface, BODY, self._box(x - 0.025, g.y0, x + 0.025, g.y1), border_radius=4)

    def _draw_line(self, points: Sequence[Point], colour: tuple[int, int, int], width: int) -> None:
        pixels = [self._at(p) for p in points]
        if len(pixels) > 1:
            self._pygame.draw.lines(self._surface, colour, False, pixels, width)

    def _draw_target(self, scene: Scene) -> None:
        draw, (x, y) = self._pygame.draw, self._at(scene.target)
        for dx, dy in ((1, 0), (0, 1)):
            draw.line(self._surface, TARGET, (x - 14 * dx, y - 14 * dy), (x + 14 * dx, y + 14 * dy), 2)
        draw.circle(self._surface, TARGET, (x, y), max(9, self._length(scene.band)), 2)

    def _draw_belt(self, scene: Scene) -> None:
        for name, points in self._geometry.sections(*scene.position).items():
            colour = tension_colour(section_tension(scene.tensions, name))
            pixels = [self._at(p) for p in points]
            self._pygame.draw.lines(self._surface, colour, False, pixels, 4)

    def _draw_pulleys(self, scene: Scene) -> None:
        draw, g = self._pygame.draw, self._geometry
        inner = self._length(RADIUS) - 2
        # Seen from above with the belt's sections as drawn, a positive angle turns motor 1 and 2 against the clock.
        spokes = {1: scene.angles[0], 3: scene.angles[1]}
        for i, centre in enumerate([*g.corners, *g.bridge_pulleys(scene.position[0])]):
            at = self._at(centre)
            draw.circle(self._surface, INK if i in spokes else CART, at, inner)
            draw.circle(self._surface, PAPER, at, inner - 2)
            if i in spokes:
                a = spokes[i]
                for turn in range(3):
                    angle = a + turn * 2 * math.pi / 3
                    end = (at[0] + (inner - 2) * math.cos(angle), at[1] - (inner - 2) * math.sin(angle))
                    draw.line(self._surface, INK, at, end, 3)
            draw.circle(self._surface, INK, at, 3)

    def _write(self, text: str) -> None:
        self._surface.blit(self._font.render(text, True, INK), (16, 12))

    def _show(self) -> NDArray[np.uint8] | None:
        pygame = self._pygame
        if self.mode == "rgb_array":
            pixels: NDArray[np.uint8] = np.ascontiguousarray(pygame.surfarray.array3d(self._surface).swapaxes(0, 1))
            return pixels
        if self._window is None:
            pygame.display.init()
            self._window = pygame.display.set_mode((WIDTH, HEIGHT))
            pygame.display.set_caption("HFrame")
            self._clock = pygame.time.Clock()
        self._window.blit(self._surface, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self.fps)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._pygame.display.quit()
            self._window = None
