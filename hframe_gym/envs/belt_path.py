"""Where the belt of a drawn stage runs: pulleys, and the sections between them.

The path follows the belt sections of the 20th-order model (eq. 25-34): cart, down the bridge's left side, out along the
frame, round two corner pulleys (the right one is the motor), back to the bridge's right side, up, and the same above.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]

RADIUS = 0.0194  # m, of the drawn pulleys
HALF_BRIDGE = 0.045  # m, from the bridge's middle to the belts at its sides
CLEARANCE = 0.075  # m, from the workspace to the frame


def arc(centre: Point, start: float, end: float) -> list[Point]:
    """Points on a pulley from one angle to another, rad."""
    count = max(2, int(abs(end - start) / 0.2) + 1)
    return [
        (centre[0] + RADIUS * math.cos(a), centre[1] + RADIUS * math.sin(a))
        for a in np.linspace(start, end, count).tolist()
    ]


class BeltGeometry:
    """Where the pulleys are, for a workspace (2, 2) m, and the belt's sections for a position of the tool."""

    def __init__(self, workspace: NDArray[np.float64]) -> None:
        (self.left, self.right), (self.low, self.high) = workspace.tolist()
        out = CLEARANCE + HALF_BRIDGE
        self.x0, self.x1 = self.left - out, self.right + out
        self.y0, self.y1 = self.low - CLEARANCE, self.high + CLEARANCE
        # phi3, phi1 (motor) below, phi4, phi2 (motor) above.
        self.corners = [(self.x0, self.y0), (self.x1, self.y0), (self.x0, self.y1), (self.x1, self.y1)]

    def bridge_pulleys(self, x: float) -> list[Point]:
        """phi7, phi5 (below), phi8, phi6 (above)."""
        d = HALF_BRIDGE + RADIUS
        return [
            (x - d, self.y0 + 2 * RADIUS),
            (x + d, self.y0 + 2 * RADIUS),
            (x - d, self.y1 - 2 * RADIUS),
            (x + d, self.y1 - 2 * RADIUS),
        ]

    def sections(self, x: float, y: float) -> dict[str, list[Point]]:
        """Lines of the sections s1 .. s9 for the tool at (x, y)."""
        phi7, phi5, phi8, phi6 = self.bridge_pulleys(x)
        phi3, phi1, phi4, phi2 = self.corners
        half = math.pi / 2
        side = HALF_BRIDGE
        return {
            "s7": [(x - side, y), (x - side, phi7[1]), *arc(phi7, 0.0, -half)],
            "s5": [(phi7[0], phi7[1] - RADIUS), (phi3[0], phi3[1] + RADIUS), *arc(phi3, half, 3 * half)],
            "s1": [(phi3[0], phi3[1] - RADIUS), (phi1[0], phi1[1] - RADIUS), *arc(phi1, -half, half)],
            "s3": [(phi1[0], phi1[1] + RADIUS), (phi5[0], phi5[1] - RADIUS), *arc(phi5, -half, -2 * half)],
            "s9": [(x + side, phi5[1]), (x + side, phi6[1]), *arc(phi6, 2 * half, half)],
            "s4": [(phi6[0], phi6[1] + RADIUS), (phi2[0], phi2[1] - RADIUS), *arc(phi2, -half, half)],
            "s2": [(phi2[0], phi2[1] + RADIUS), (phi4[0], phi4[1] + RADIUS), *arc(phi4, half, 3 * half)],
            "s6": [(phi4[0], phi4[1] - RADIUS), (phi8[0], phi8[1] + RADIUS), *arc(phi8, half, 0.0)],
            "s8": [(x - side, phi8[1]), (x - side, y)],
        }


# The lumped belts of the 8th-order model and the sections that each is made of.
LUMPED = {"left": ("s1", "s5", "s7"), "right": ("s2", "s6", "s8"), "bottom": ("s3", "s4", "s9")}


def section_tension(tensions: dict[str, float], section: str) -> float | None:
    """Tension of a section from its own belt or the lumped one, N; None where the machine has neither."""
    whole = next(name for name, sections in LUMPED.items() if section in sections)
    return tensions.get(section, tensions.get(whole))
