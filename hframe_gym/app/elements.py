"""Elements of which stages consist: sentences with a colored edge, headings, tables and charts of curves."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any, Literal

from nicegui import ui

from .charts import curves_chart, height_of
from .log_columns import Curve

_NO_ZOOM = 24  # pixels of the height below the curves that only a chart with a zoom needs


def banner(tone: Literal["good", "neutral", "warning"], title: str, text: str) -> None:
    """Show a sentence with a colored edge, green, gray or yellow by `tone`.

    Args:
        title: Title before the text, in bold; "" for none.
    """
    strong = f"<b>{html.escape(title)}</b> " if title else ""
    ui.html(strong + html.escape(text), sanitize=False).classes(f"hf-banner hf-{tone}").props("role=status")


def heading(text: str) -> None:
    """Show the heading of a part of a stage."""
    ui.html(f"<h2>{html.escape(text)}</h2>", sanitize=False)


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> None:
    """Show a table of texts; `numbers` are indices of the columns whose cells are aligned at the right."""

    def cells(tag: str, texts: Sequence[str]) -> str:
        parts = (
            f"<{tag}{' class=num' if k in numbers else ''}>{html.escape(text)}</{tag}>"
            for k, text in enumerate(texts)
        )
        return f"<tr>{''.join(parts)}</tr>"

    body = "".join(cells("td", row) for row in rows)
    with ui.element("div").classes("hf-scroll"):
        content = f'<table class="hf-table"><thead>{cells("th", head)}</thead><tbody>{body}</tbody></table>'
        ui.html(content, sanitize=False)


def show_curves(curves: Sequence[Curve], description: str, dark: bool) -> ui.echart:
    """Show curves over time, one below the other, in a chart of ECharts, and return it.

    Args:
        description: Text for users who cannot see the chart.
        dark: Whether the display is dark.
    """
    chart = ui.echart(curves_chart(curves, dark=dark)).classes("w-full")
    chart.style(f"height: {height_of(len(curves)) - _NO_ZOOM}px")
    return chart.props(f'role=img aria-label="{html.escape(description)}"')


def redraw(chart: ui.echart, options: dict[str, Any]) -> None:
    """Replace the options of a chart of ECharts and draw it again."""
    chart.options.clear()
    chart.options.update(options)
    chart.update()
