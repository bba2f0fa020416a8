"""Colors of pages and plots by role, for light and for dark displays."""

from __future__ import annotations

from collections.abc import Mapping

# Colors by role, for light and for dark displays. Every color has a contrast of at least 4.5 (text) or 3
# (lines) to the background of its display. Before and after are orange and blue, which color-blind readers
# can distinguish.
COLORS: Mapping[str, tuple[str, str]] = {
    "background": ("#ffffff", "#12161c"),
    "surface": ("#f5f7f9", "#1b212a"),
    "line": ("#d5dae1", "#38414d"),
    "ink": ("#1c2127", "#e8edf3"),
    "muted": ("#59636f", "#a3afbd"),
    "link": ("#0a58b8", "#79b8ff"),
    "good": ("#1a7348", "#58cf95"),
    "neutral": ("#3f5f9a", "#8fb4f5"),
    "warning": ("#a04a00", "#f5a94f"),
    "declared": ("#7b8592", "#8d98a6"),
    "before": ("#cc5200", "#ff9d57"),
    "after": ("#0b69c7", "#66b2ff"),
    "series3": ("#20805f", "#55c79f"),
    "series4": ("#8a3ea8", "#d08bea"),
    "series5": ("#8c6d00", "#dcbc4a"),
    "series6": ("#b02a55", "#ff8bb0"),
}
SERIES = ("after", "before", "series3", "series4", "series5", "series6")  # order of the curves of a plot


def color(role: str) -> str:
    """Return the color of a plot element, such as "ink" or "before", on a light background.

    In a web page, `panel_svg` replaces these colors by variables of the style sheet, which gives others on a
    dark display.

    Args:
        role: Element: "background", "surface", "line", "ink", "muted", "link", "good", "neutral", "warning",
            "declared", "before", "after", or "series3" to "series6" for further curves.

    Returns:
        Hexadecimal color, "#rrggbb".

    Raises:
        KeyError: If there is no such role.
    """
    return COLORS[role][0]
