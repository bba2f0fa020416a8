"""Pictures of a stage from above: frame, bridge, cart, the belt colored by tension, goal and trail.

Drawn with pygame, the extra `render`; x points to the right and y upward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..machine import Machine
from .scene import Point, Scene
from .spaces import workspace_of

Color = tuple[int, int, int]

WIDTH, HEIGHT = 880, 660  # pixels
FULL_COLOR_TENSION = 40.0  # N above or below the pretension for the full color
PULLEY_RADIUS = 0.0194  # m
HALF_BRIDGE = 0.045  # m, from the bridge's middle to the belts at its sides
CLEARANCE = 0.075  # m, from the workspace to the frame

PAPER, RAIL, BODY, CART, INK = (250, 250, 248), (214, 217, 222), (176, 183, 193), (92, 103, 120), (44, 50, 60)
SLACK, NEUTRAL, TAUT, UNKNOWN = (43, 108, 196), (146, 146, 150), (214, 48, 39), (120, 120, 124)
TARGET, PATH, TRACE = (22, 140, 92), (150, 206, 178), (238, 140, 20)

# The lumped belts of the 8th-order model and the belt sections of the 20th-order model that each consists of.
LUMPED_SECTIONS = {"left": ("s1", "s5", "s7"), "right": ("s2", "s6", "s8"), "bottom": ("s3", "s4", "s9")}


class BeltGeometry:
    """Compute where the pulleys are, and the path of the belt around them.

    The path follows the sections of the 20th-order model (eq. 25-34 of Sollmann et al. 2010): from the cart down the
    left side of the bridge, out along the frame, around two corner pulleys (the right one is the motor), back to the
    right side of the bridge, up, and the same above.

    Args:
        workspace: Rows x and y, columns low and high, m, shape (2, 2).

    Attributes:
        left, right, low, high: Ends of the workspace along x and along y, m.
        x0, x1, y0, y1: Positions of the corner pulleys along x and along y, m.
    """

    def __init__(self, workspace: NDArray[np.float64]) -> None:
        (self.left, self.right), (self.low, self.high) = workspace.tolist()
        out = CLEARANCE + HALF_BRIDGE
        self.x0, self.x1 = self.left - out, self.right + out
        self.y0, self.y1 = self.low - CLEARANCE, self.high + CLEARANCE
        self._corners = [(self.x0, self.y0), (self.x1, self.y0), (self.x0, self.y1), (self.x1, self.y1)]

    def pulleys(self, x: float) -> list[Point]:
        """Compute the centers of the eight pulleys.

        Args:
            x: Position of the bridge, m.

        Returns:
            Points (x, y), m, of the pulleys phi3, phi1 (motor), phi4, phi2 (motor), phi7, phi5, phi8, phi6.
        """
        d, rise = HALF_BRIDGE + PULLEY_RADIUS, 2 * PULLEY_RADIUS
        bridge = [(x - d, self.y0 + rise), (x + d, self.y0 + rise), (x - d, self.y1 - rise), (x + d, self.y1 - rise)]
        return [*self._corners, *bridge]

    def sections(self, x: float, y: float) -> dict[str, list[Point]]:
        """Compute the lines along which the nine belt sections are drawn.

        Args:
            x: Tool position along x, m.
            y: Tool position along y, m.

        Returns:
            Vertices (x, y), m, by name of the section, "s1" to "s9".
        """
        phi3, phi1, phi4, phi2, phi7, phi5, phi8, phi6 = self.pulleys(x)  # centers (x, y)
        # Each section is a straight line, which touches the pulleys at a distance r from their centers, and the arc
        # around the pulley at its end.
        half = math.pi / 2
        side, r = HALF_BRIDGE, PULLEY_RADIUS
        return {
            "s7": [(x - side, y), (x - side, phi7[1]), *_arc(phi7, 0.0, -half)],
            "s5": [(phi7[0], phi7[1] - r), (phi3[0], phi3[1] + r), *_arc(phi3, half, 3 * half)],
            "s1": [(phi3[0], phi3[1] - r), (phi1[0], phi1[1] - r), *_arc(phi1, -half, half)],
            "s3": [(phi1[0], phi1[1] + r), (phi5[0], phi5[1] - r), *_arc(phi5, -half, -2 * half)],
            "s9": [(x + side, phi5[1]), (x + side, phi6[1]), *_arc(phi6, 2 * half, half)],
            "s4": [(phi6[0], phi6[1] + r), (phi2[0], phi2[1] - r), *_arc(phi2, -half, half)],
            "s2": [(phi2[0], phi2[1] + r), (phi4[0], phi4[1] + r), *_arc(phi4, half, 3 * half)],
            "s6": [(phi4[0], phi4[1] - r), (phi8[0], phi8[1] + r), *_arc(phi8, half, 0.0)],
            "s8": [(x - side, phi8[1]), (x - side, y)],
        }


def _arc(center: Point, start: float, end: float) -> list[Point]:
    """Return points on a pulley from one angle to another, rad."""
    angles = np.linspace(start, end, max(2, int(abs(end - start) / 0.2) + 1)).tolist()
    return [(center[0] + PULLEY_RADIUS * math.cos(a), center[1] + PULLEY_RADIUS * math.sin(a)) for a in angles]


def section_tension(tensions: dict[str, float], section: str) -> float | None:
    """Look up the tension of a belt section, or of the lumped belt of the 8th-order model that contains it.

    Args:
        tensions: Tension minus pretension by name of the belt, N.
        section: Name of the section, "s1" to "s9".

    Returns:
        Tension minus pretension, N; None if the machine has neither belt.
    """
    lumped = next(name for name, sections in LUMPED_SECTIONS.items() if section in sections)
    return tensions.get(section, tensions.get(lumped))


def tension_color(tension: float | None) -> Color:
    """Return the color of a belt: gray at its pretension, blue below it, red above it.

    Args:
        tension: Tension minus pretension, N; None if unknown. The color saturates at `FULL_COLOR_TENSION`.

    Returns:
        Red, green and blue, 0 to 255.
    """
    if tension is None or not math.isfinite(tension):
        return UNKNOWN
    fraction = min(1.0, abs(tension) / FULL_COLOR_TENSION)
    end = TAUT if tension > 0 else SLACK
    r, g, b = (round(a + fraction * (e - a)) for a, e in zip(NEUTRAL, end, strict=True))
    return r, g, b


def _load_pygame() -> Any:
    """Import pygame; raises ImportError with the extra that installs it."""
    try:
        import pygame
    except ImportError as error:
        raise ImportError("rendering needs pygame: pip install 'hframe_gym[render]'") from error
    return pygame


class Renderer:
    """Draw scenes of one machine into a window or an array.

    Args:
        machine: Machine with a workspace.
        mode: Render mode, "human" (a window) or "rgb_array" (an array).
        fps: Maximum frame rate of the window, 1/s.

    Raises:
        ImportError: If pygame is missing; the message names the extra.
    """

    def __init__(self, machine: Machine, mode: str, fps: int) -> None:
        self._pygame = _load_pygame()
        self._mode, self._fps = mode, fps
        workspace = workspace_of(machine)
        self._planar = len(workspace) > 1
        # One axis is drawn along the middle of a narrow workspace.
        self._geometry = BeltGeometry(workspace if self._planar else np.vstack([workspace, [-0.05, 0.05]]))
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

    def _box(self, x0: float, y0: float, x1: float, y1: float) -> Any:
        """Return the rectangle between two corners, m."""
        (left, bottom), (right, top) = self._pixel((x0, y0)), self._pixel((x1, y1))
        return self._pygame.Rect(left, top, right - left, bottom - top)

    def _draw_frame(self) -> Any:
        """Draw what does not move: the rails of the frame and the edge of the workspace."""
        surface, draw, g = self._pygame.Surface((WIDTH, HEIGHT)), self._pygame.draw, self._geometry
        surface.fill(PAPER)
        for y in (g.y0, g.y1) if self._planar else (0.0,):
            draw.rect(surface, RAIL, self._box(g.x0 - 0.03, y - 0.03, g.x1 + 0.03, y + 0.03), border_radius=8)
        draw.rect(surface, RAIL, self._box(g.left, g.low, g.right, g.high), width=1)
        return surface

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Draw a scene.

        Args:
            scene: Positions, tensions and goal of an environment.

        Returns:
            Picture, uint8, shape (HEIGHT, WIDTH, 3), in mode "rgb_array"; None in mode "human" (updates the window).
        """
        surface, draw = self._surface, self._pygame.draw
        surface.blit(self._background, (0, 0))
        if self._planar:
            self._draw_bridge(scene.position[0])
            for name, points in self._geometry.sections(*scene.position).items():
                color = tension_color(section_tension(scene.tensions, name))
                draw.lines(surface, color, False, [self._pixel(p) for p in points], 4)
            self._draw_pulleys(scene)
        x, y = scene.position
        draw.rect(surface, CART, self._box(x - 0.055, y - 0.028, x + 0.055, y + 0.028), border_radius=6)
        self._draw_line(scene.path, PATH, 3)
        self._draw_line(scene.trail, TRACE, 2)
        self._draw_target(scene)
        draw.circle(surface, PAPER, self._pixel(scene.position), 5)
        draw.circle(surface, INK, self._pixel(scene.position), 2)
        belts = "".join(f"    {k} {v:+.0f} N" for k, v in list(scene.tensions.items())[:3])
        text = f"t = {scene.time_s:.2f} s    distance = {1e3 * scene.distance:.3f} mm" + (
            belts and f"    belts:{belts}"
        )
        surface.blit(self._font.render(text, True, INK), (16, 12))
        return self._output()

    def _draw_bridge(self, x: float) -> None:
        """Draw the bridge at x, m."""
        g, draw = self._geometry, self._pygame.draw
        for y, inward in ((g.y0, 1.0), (g.y1, -1.0)):
            low, high = sorted((y - 0.012 * inward, y + 0.062 * inward))
            draw.rect(self._surface, BODY, self._box(x - 0.092, low, x + 0.092, high), border_radius=8)
        draw.rect(self._surface, BODY, self._box(x - 0.025, g.y0, x + 0.025, g.y1), border_radius=4)

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
        inner = self._pixels(PULLEY_RADIUS) - 2
        # From above, with the belt as drawn, a positive angle turns both motors counterclockwise.
        spokes = {1: scene.angles[0], 3: scene.angles[1]}
        for i, center in enumerate(g.pulleys(scene.position[0])):
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
            pixels: NDArray[np.uint8] = np.ascontiguousarray(pygame.surfarray.array3d(self._surface).swapaxes(0, 1))
            return pixels
        if self._window is None:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode((WIDTH, HEIGHT))
            except pygame.error as error:
                raise InputError(
                    f"render_mode='human' needs a display ({error}); without one use render_mode='rgb_array', or set "
                    "SDL_VIDEODRIVER=dummy"
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
