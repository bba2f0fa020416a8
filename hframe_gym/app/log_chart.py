"""Chart of the columns of a log: it can be zoomed, and the mouse can select an interval in it."""

from __future__ import annotations

import asyncio
import html
from collections.abc import Callable, Sequence
from typing import Any

from nicegui import events, ui

from ..recordings import Interval
from .charts import curves_chart, height_of, with_selection, with_zoom
from .log_columns import Curve, LogView, thinned

_MOST_CURVES = 24  # columns that are drawn; logs of machine tools have hundreds


class LogChart:
    """Chart on the page that shows one log at a time.

    Args:
        dark: Whether the display is dark.
        selected: Called with the ends of an interval, s, that the mouse has selected.
    """

    def __init__(self, dark: bool, selected: Callable[[float, float], None]) -> None:
        self._dark, self._selected = dark, selected
        self._place = ui.element("div").classes("hf-chart")
        self._curves: Sequence[Curve] = ()

    @property
    def is_deleted(self) -> bool:
        """Whether the page no longer shows the chart."""
        return self._place.is_deleted

    def draw(self, view: LogView, intervals: Sequence[Interval], *, selectable: bool) -> None:
        """Draw a log's columns, of hundreds only the first ones; draw nothing if it has none.

        Args:
            intervals: Time intervals of the log to mark.
            selectable: Whether the mouse can select an interval; not where the curves are over row numbers.
        """
        self._place.clear()
        self._curves = curves = view.curves[:_MOST_CURVES]
        if not curves:
            return
        selectable = selectable and view.has_time
        x_name = "time, s" if view.has_time else "row"
        options = with_zoom(
            curves_chart(curves, dark=self._dark, x_name=x_name, intervals=intervals), self._dark
        )
        if selectable:
            with_selection(options, self._dark)
        with self._place:
            chart = ui.echart(options).classes("w-full").style(f"height: {height_of(len(curves))}px")
            text = ", ".join(f"{c.name}: {c.note}" for c in curves)
            chart.props(f'role=img aria-label="{html.escape(text)}"')
            others = len(view.curves) - len(curves)
            if others:
                ui.label(f"and {others} more columns").classes("hf-muted")
            if selectable:
                chart.on("chart:brushEnd", self._brushed, args=["areas"])
                ui.timer(0.4, lambda: _let_select(chart), once=True)
            chart.on("chart:datazoom", lambda e: self._zoomed(chart, e.args), args=["start", "end", "batch"])

    async def _zoomed(self, chart: Any, args: dict[str, Any]) -> None:
        """Send more points of the part that is visible after a zoom."""
        zoom = args if args.get("start") is not None else (args.get("batch") or [{}])[0]
        if zoom.get("start") is None or not self._curves:
            return
        first, last = min(c.time[0] for c in self._curves), max(c.time[-1] for c in self._curves)
        span = last - first
        begin, end = first + zoom["start"] / 100 * span, first + zoom["end"] / 100 * span
        margin = 0.5 * (end - begin)
        series = [{"data": thinned(c.time, c.values, begin - margin, end + margin)} for c in self._curves]
        chart.run_chart_method("setOption", {"series": series})
        await asyncio.sleep(0)

    def _brushed(self, event: events.GenericEventArguments) -> None:
        """Tell the interval that the mouse selected."""
        areas = event.args.get("areas") or []
        if not areas:
            return
        span = areas[0].get("coordRange") or (areas[0].get("coordRanges") or [[]])[0]
        if len(span) == 2 and span[0] < span[1]:
            self._selected(float(span[0]), float(span[1]))


def _let_select(chart: Any) -> None:
    """Let the mouse select an interval without a button before."""
    option = {"brushType": "lineX", "brushMode": "single"}
    chart.run_chart_method(
        "dispatchAction", {"type": "takeGlobalCursor", "key": "brush", "brushOption": option}
    )
