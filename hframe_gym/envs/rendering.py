"""Pictures of a stage from above: frame, bridge, cart, the belt colored by tension, goal and trail.

Drawn with pygame, the extra `render`; x points to the right and y upward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, naming_extra
from ..machine import Box, Machine, Point, drawn_point, stage_geometry

if TYPE_CHECKING:
    from .environment_batch import EnvironmentBatch

Color = tuple[int, int, int]

TRAIL_LENGTH = 300  # points
PATH_S = 3.0  # s of an episode for which the path of a moving goal is drawn
WIDTH, HEIGHT = 880, 660  # pixels
FULL_COLOR_TENSION = 40.0  # N above or below the pretension for the full color

PAPER, RAIL, BODY, CART, INK = (250, 250, 248), (214, 217, 222), (176, 183, 193), (92, 103, 120), (44, 50, 60)
SLACK, NEUTRAL, TAUT, UNKNOWN = (43, 108, 196), (146, 146, 150), (214, 48, 39), (120, 120, 124)
TARGET, PATH, TRACE = (22, 140, 92), (150, 206, 178), (238, 140, 20)


@dataclass(frozen=True)
class Scene:
    """Hold the positions, tensions and goal of one environment that a picture shows.

    Points of a rotary axis are those of the end of an arm (`drawn_point`).

    Attributes:
        position: Tool position (x, y), m.
        target: Goal position (x, y), m.
        band: Distance to the goal that counts as a success, m.
        angles: Angles of the two motor pulleys, rad.
        tensions: Belt tensions minus pretension by name of the belt, N.
        trail: Past tool positions (x, y), m, oldest first.
        path: Positions (x, y) of a moving goal, m; empty for a fixed goal.
        time_s: Time since the reset, s.
        distance: Distance from tool to goal, in `distance_unit`.
        distance_unit: "mm" or "mrad".
    """

    position: Point
    target: Point
    band: float
    angles: tuple[float, float]
    tensions: dict[str, float]
    trail: Sequence[Point]
    path: Sequence[Point]
    time_s: float
    distance: float
    distance_unit: str = "mm"

    @classmethod
    def of(cls, batch: EnvironmentBatch, b: int, trail: Sequence[Point]) -> Scene:
        """Collect data for a picture of environment b, with a `trail` of tool positions, m, oldest first."""
        index = np.array([b])
        position = batch.simulator.positions(b)
        # A drive without a pulley is drawn at rest.
        drives = [
            d.coordinate
            for d in batch.machine.drives
            if batch.machine.coordinate(d.coordinate).kind == "rotary"
        ]
        angles = [position[c] for c in drives[:2]] + [0.0, 0.0]
        period, unit = batch.config.period, batch.machine.axis_unit
        return cls(
            position=tool_point(batch, b),
            target=drawn_point(unit, batch.references.goals(index)[0].tolist()),
            band=batch.task.band / unit.per_meter,
            angles=(angles[0], angles[1]),
            tensions=batch.simulator.tensions(b),
            trail=list(trail),
            path=[
                drawn_point(unit, point)
                for point in batch.references.path(b, np.arange(0.0, PATH_S, period)).tolist()
            ],
            time_s=float(batch.elapsed[b] * period),
            distance=1e3 * float(batch.distance(index)[0]),
            distance_unit=unit.small,
        )


def tool_point(batch: EnvironmentBatch, b: int) -> Point:
    """Return the point (x, y), m, at which a picture shows the tool of environment b (`drawn_point`).

    If the bridge can yaw, the small displacement of the tool by the yaw is not included.
    """
    position = batch.simulator.positions(b)
    return drawn_point(batch.machine.axis_unit, [position[name] for name in batch.machine.tool_axes])


def tension_color(tension: float | None) -> Color:
    """Return the color of a belt in a picture: gray at its pretension, blue below, red above.

    Args:
        tension: Tension minus pretension, N. Beyond +-40 N the color does not change. None (unknown) or a
            value that is not finite gives a darker gray.
    """
    if tension is None or not math.isfinite(tension):
        return UNKNOWN
    fraction = min(1.0, abs(tension) / FULL_COLOR_TENSION)
    end = TAUT if tension > 0 else SLACK
    r, g, b = (round(a + fraction * (e - a)) for a, e in zip(NEUTRAL, end, strict=True))
    return r, g, b


def _load_pygame() -> Any:
    """Import pygame; raises ImportError with the extra that installs it."""
    with naming_extra("render", "rendering needs pygame"):
        import pygame
    return pygame


class Renderer:
    """Draw scenes of one machine into a window or an array.

    Args:
        mode: "rgb_array" for pictures as arrays, "human" for a window.
        fps: Maximum frame rate of the window, 1/s.

    Raises:
        ImportError: If pygame is missing; the message names the extra.
    """

    def __init__(self, machine: Machine, mode: str, fps: int) -> None:
        self._pygame = _load_pygame()
        self._mode, self._fps = mode, fps
        self._geometry = stage_geometry(machine)
        g = self._geometry
        margin = 0.06  # m
        self._scale = min(WIDTH / (g.x1 - g.x0 + 2 * margin), (HEIGHT - 40) / (g.y1 - g.y0 + 2 * margin))
        self._middle = ((g.x0 + g.x1) / 2, (g.y0 + g.y1) / 2)
        self._surface = self._pygame.Surface((WIDTH, HEIGHT))
        self._background = self._draw_frame()
        self._pygame.font.init()
        self._font = self._pygame.font.Font(None, 22)
        self._window: Any = None
        self._clock: Any = None

    def _pixel(self, point: Point) -> tuple[int, int]:
        """Return the pixel of a point, m."""
        x = WIDTH / 2 + (point[0] - self._middle[0]) * self._scale
        y = (HEIGHT + 30) / 2 - (point[1] - self._middle[1]) * self._scale
        return round(x), round(y)

    def _pixels(self, length: float) -> int:
        """Return a length, m, in pixels."""
        return max(1, round(length * self._scale))

    def _box(self, box: Box) -> Any:
        """Return the rectangle of a box, m."""
        x0, y0, x1, y1 = box
        (left, bottom), (right, top) = self._pixel((x0, y0)), self._pixel((x1, y1))
        return self._pygame.Rect(left, top, right - left, bottom - top)

    def _draw_frame(self) -> Any:
        """Draw what does not move: the rails of the frame and the edge of the workspace."""
        surface, draw, g = self._pygame.Surface((WIDTH, HEIGHT)), self._pygame.draw, self._geometry
        surface.fill(PAPER)
        for rail in g.rails():
            draw.rect(surface, RAIL, self._box(rail), border_radius=8)
        draw.rect(surface, RAIL, self._box((g.left, g.low, g.right, g.high)), width=1)
        return surface

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Draw the machine of a scene from above, with its belts, the goal and the past path of the tool.

        Returns:
            Picture, uint8, shape (660, 880, 3), in mode "rgb_array"; None in mode "human" (updates the
            window).

        Raises:
            InputError: In mode "human", if there is no display.
        """
        surface, draw = self._surface, self._pygame.draw
        surface.blit(self._background, (0, 0))
        x, y = scene.position
        for part in self._geometry.bridge(x, y):
            draw.rect(surface, BODY, self._box(part), border_radius=6)
        for name, points in self._geometry.sections(x, y).items():
            color = tension_color(scene.tensions.get(self._geometry.belts.get(name, "")))
            draw.lines(surface, color, False, [self._pixel(p) for p in points], 4)
        self._draw_pulleys(scene)
        width, height = self._geometry.half_tool
        cart = self._box((x - width, y - height, x + width, y + height))
        draw.rect(surface, CART, cart, border_radius=6)
        self._draw_line(scene.path, PATH, 3)
        self._draw_line(scene.trail, TRACE, 2)
        self._draw_target(scene)
        draw.circle(surface, PAPER, self._pixel(scene.position), 5)
        draw.circle(surface, INK, self._pixel(scene.position), 2)
        belts = "".join(f"    {k} {v:+.0f} N" for k, v in list(scene.tensions.items())[:4])
        text = f"t = {scene.time_s:.2f} s    distance = {scene.distance:.3f} {scene.distance_unit}" + (
            belts and f"    belts:{belts}"
        )
        surface.blit(self._font.render(text, True, INK), (16, 12))
        return self._output()

    def _draw_line(self, points: Sequence[Point], color: Color, width: int) -> None:
        """Draw a line through points, m, of a width in pixels."""
        pixels = [self._pixel(p) for p in points]
        if len(pixels) > 1:
            self._pygame.draw.lines(self._surface, color, False, pixels, width)

    def _draw_target(self, scene: Scene) -> None:
        """Draw the goal and its tolerance."""
        draw, (x, y) = self._pygame.draw, self._pixel(scene.target)
        for dx, dy in ((1, 0), (0, 1)):
            draw.line(self._surface, TARGET, (x - 14 * dx, y - 14 * dy), (x + 14 * dx, y + 14 * dy), 2)
        draw.circle(self._surface, TARGET, (x, y), max(9, self._pixels(scene.band)), 2)

    def _draw_pulleys(self, scene: Scene) -> None:
        """Draw the pulleys, those of the motors with spokes."""
        draw, g = self._pygame.draw, self._geometry
        inner = self._pixels(g.radius) - 2
        spokes = {pulley: spin * angle for (pulley, spin), angle in zip(g.motors, scene.angles, strict=False)}
        for i, center in enumerate(g.pulleys(*scene.position)):
            pixel = self._pixel(center)
            draw.circle(self._surface, INK if i in spokes else CART, pixel, inner)
            draw.circle(self._surface, PAPER, pixel, inner - 2)
            for turn in range(3 if i in spokes else 0):
                angle = spokes[i] + turn * 2 * math.pi / 3
                end = (pixel[0] + (inner - 2) * math.cos(angle), pixel[1] - (inner - 2) * math.sin(angle))
                draw.line(self._surface, INK, pixel, end, 3)
            draw.circle(self._surface, INK, pixel, 3)

    def _output(self) -> NDArray[np.uint8] | None:
        """Return the picture in mode "rgb_array", or show it in the window."""
        pygame = self._pygame
        if self._mode == "rgb_array":
            pixels: NDArray[np.uint8] = np.ascontiguousarray(
                pygame.surfarray.array3d(self._surface).swapaxes(0, 1)
            )
            return pixels
        if self._window is None:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode((WIDTH, HEIGHT))
            except pygame.error as error:
                raise InputError(
                    f"render_mode='human' needs a display ({error}); "
                    "without one use render_mode='rgb_array', or set SDL_VIDEODRIVER=dummy"
                ) from error
            pygame.display.set_caption("HFrame")
            self._clock = pygame.time.Clock()
        self._window.blit(self._surface, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._fps)
        return None

    def close(self) -> None:
        """Close the window if it is open; a later `draw` opens a new one."""
        if self._window is not None:
            self._pygame.display.quit()
            self._window = None
