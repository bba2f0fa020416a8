"""Build self-contained web pages: one style sheet for light and dark displays, and plots inside the page.

A plot is a `Panel`, a small set of axes with a title and a description. The same panel becomes a scalable
graphic of a page, which takes its colors from the style sheet, and part of a picture file for slides and
papers. Plots need matplotlib, pages Jinja: the extra `report`.
"""

from .colors import COLORS, SERIES, color
from .page import NextStep, number, write_page
from .panels import Panel, legend_above, panel_svg, plot_style, save_panels
from .thinning import extreme_rows

__all__ = [
    "COLORS",
    "SERIES",
    "NextStep",
    "Panel",
    "color",
    "extreme_rows",
    "legend_above",
    "number",
    "panel_svg",
    "plot_style",
    "save_panels",
    "write_page",
]
