"""Charts of curves on a page of the app, and their update."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

from nicegui import ui

from .charts import curves_chart, height_of
from .log_columns import Curve

_NO_ZOOM = 24  # pixels of the height below the curves that only a chart with a zoom needs


def show_curves(curves: Sequence[Curve], description: str, dark: bool) -> ui.echart:
    """Show curves over time, one below the other, with a description as the alternative text."""
    chart = ui.echart(curves_chart(curves, dark=dark)).classes("w-full")
    chart.style(f"height: {height_of(len(curves)) - _NO_ZOOM}px")
    return chart.props(f'role=img aria-label="{html.escape(description)}"')


def redraw(chart: ui.echart, options: dict[str, Any]) -> None:
    """Update a chart with new options."""
    chart.options.clear()
    chart.options.update(options)
    chart.update()
