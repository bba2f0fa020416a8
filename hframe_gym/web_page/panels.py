"""Plots as small sets of axes with title and description: graphics of a page, and parts of picture files."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import naming_extra
from ..files import atomic_file
from .colors import COLORS, SERIES, color

NEED = "reports need more packages"
PANEL_WIDTH = 3.6  # in; 346 px, so that text keeps its size on a phone
TITLE_CHARACTERS = 44  # of a line of a title in a picture file, as many as a panel is wide
# Of a line beside the vertical axis, per inch of the panel's height: as many as fit with 9 points in the
# page's font. A longer label would be cut off at the panel's edges.
LABEL_CHARACTERS = 12
MAX_COLUMNS = 3  # panels beside each other in a picture file
MAX_TICKS = (
    6  # intervals between the ticks of a horizontal axis; eight numbers of six characters fill a panel
)


class Panel(NamedTuple):
    """A plot with one pair of axes.

    Attributes:
        title: Title above the axes.
        description: What the plot shows, for readers who do not see it (alternative text).
        draw: Function that draws on matplotlib axes; colors are those of `color`.
        height: Height, in; the width is 3.6 in.
    """

    title: str
    description: str
    draw: Callable[[Any], None]
    height: float = 2.3


def plot_style() -> Any:  # matplotlib's type lists the names of all settings
    """Return the package's plot settings, for `matplotlib.rc_context`."""
    with naming_extra("report", NEED):
        from cycler import cycler
    ink, muted, line = color("ink"), color("muted"), color("line")
    return {
        "font.size": 9,
        "axes.prop_cycle": cycler(color=[color(role) for role in SERIES]),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.edgecolor": muted,
        "axes.facecolor": "none",
        "axes.titlesize": 9,
        "axes.formatter.limits": (-3, 4),
        "grid.color": line,
        "text.color": ink,
        "axes.labelcolor": ink,
        "xtick.color": muted,
        "ytick.color": muted,
        "xtick.labelcolor": ink,
        "ytick.labelcolor": ink,
        "text.parse_math": False,  # names of channels and runs are data
        "legend.frameon": False,
        "legend.fontsize": 8,
        "svg.fonttype": "none",  # text stays text: it can be selected, and takes the font of the page
    }


def panel_svg(panel: Panel, prefix: str) -> str:
    """Draw a plot as an SVG element for a web page, with its description as the alternative text.

    Each color becomes a variable of the page's style sheet, for example `var(--ink)`, so that the plot
    follows the light or dark display of the reader.

    Args:
        prefix: Prefix of the element's identifiers (letters, digits, hyphens); each plot of a page needs
            another one.

    Returns:
        Text of the element, from <svg to </svg>.

    Raises:
        ImportError: If matplotlib or Jinja is missing; the message says how to install them.
    """
    from io import StringIO

    with naming_extra("report", NEED):
        import matplotlib
        from markupsafe import escape
        from matplotlib.figure import Figure
    with matplotlib.rc_context(plot_style() | {"svg.hashsalt": prefix}):
        figure = Figure(figsize=(PANEL_WIDTH, panel.height), layout="constrained")
        axes = figure.subplots()
        _draw(panel, axes)
        _fix_layout(figure)
        buffer = StringIO()
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    drawing = buffer.getvalue()
    view_box = re.search(r'viewBox="[^"]*"', drawing)
    body = drawing[drawing.index("<defs>") : drawing.rindex("</svg>")]
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', body))
    # Identifiers must be unique in the page: the unused ones are dropped, the others get the prefix.
    body = re.sub(r' id="([^"]*)"', lambda m: f' id="{prefix}-{m[1]}"' if m[1] in used else "", body)
    body = re.sub(r'(?:xlink:)?href="#', f'href="#{prefix}-', body).replace("url(#", f"url(#{prefix}-")
    for role, (light, _) in COLORS.items():
        body = body.replace(light, f"var(--{role})")
    body = re.sub(r"<!--.*?-->\s*", "", body)
    label = f'role="img" aria-label="{escape(panel.description)}"'
    return f"<svg {view_box[0] if view_box else ''} {label}>{body}</svg>"


def save_panels(panels: Sequence[Panel], path: Path) -> None:
    """Draw plots into one picture file, up to three in a row, with the colors of a light display.

    Args:
        path: File to write; the suffix gives the format (.png, .svg, .pdf). If writing fails, an existing
            file is unchanged.

    Raises:
        ImportError: If matplotlib is missing; the message says how to install it.
        OSError: If the file cannot be written.
    """
    with naming_extra("report", NEED):
        import matplotlib
        from matplotlib.figure import Figure
    columns = min(MAX_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    with matplotlib.rc_context(plot_style()):
        height = rows * (max(panel.height for panel in panels) + 0.25)
        figure = Figure(figsize=(PANEL_WIDTH * columns, height), dpi=120, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, panel in zip(grid, panels, strict=False):
            _draw(panel, axes)
            title = textwrap.fill(panel.title, TITLE_CHARACTERS)
            axes.set_title(title, loc="left", pad=22 if axes.get_legend() else 6)
        for axes in grid[len(panels) :]:
            axes.set_visible(False)
        _fix_layout(figure)
        with atomic_file(path) as file:
            figure.savefig(file, dpi=120, format=path.suffix[1:])


def _draw(panel: Panel, axes: Any) -> None:
    """Draw a plot on its axes, with ticks and labels that fit into the panel."""
    panel.draw(axes)
    _limit_ticks(axes)
    axes.set_ylabel(textwrap.fill(axes.get_ylabel(), round(LABEL_CHARACTERS * panel.height)))


def _limit_ticks(axes: Any) -> None:
    """Choose so few ticks on a linear horizontal axis that numbers such as -0.075 do not touch each other."""
    from matplotlib.ticker import AutoLocator

    locator = axes.xaxis.get_major_locator()
    if isinstance(locator, AutoLocator):
        locator.set_params(nbins=MAX_TICKS)


def _fix_layout(figure: Any) -> None:
    """Arrange the plots of a figure for good; to arrange them, `savefig` would draw the figure once more."""
    figure.get_layout_engine().execute(figure)
    figure.set_layout_engine(None)


def legend_above(axes: Any) -> None:
    """Add a legend above the axes, where it hides no curve, with up to four entries in a row.

    Args:
        axes: Axes of matplotlib with labeled curves.
    """
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        borderaxespad=0.2,
        columnspacing=1.0,
        handlelength=1.2,
        handletextpad=0.4,
    )
