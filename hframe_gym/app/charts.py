"""Options of charts (ECharts): several curves over time, one below the other, and an error over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..recordings import Interval
from ..web_page import COLORS, SERIES
from .log_columns import Curve, thinned

_PLOT, _GAP, _TOP, _BOTTOM = 72, 34, 26, 62  # pixels
_LEFT, _RIGHT = 62, 14


def ink(role: str, dark: bool) -> str:
    """Return the color, "#rrggbb", of a plot element on light or dark displays.

    Args:
        role: Element, a key of `web_page.COLORS` such as "ink" or "line".
    """
    return COLORS[role][dark]


def height_of(count: int) -> int:
    """Return the height, in pixels, of a chart of `count` curves."""
    return _TOP + count * (_PLOT + _GAP) + _BOTTOM - _GAP + 8


def curves_chart(
    curves: Sequence[Curve], *, dark: bool, x_name: str = "time, s", intervals: Sequence[Interval] = ()
) -> dict[str, Any]:
    """Return options of ECharts for curves, one below another, over a common axis of time.

    Args:
        curves: One or more curves.
        dark: Whether the display is dark.
        x_name: Name of the common axis, below the last curve.
        intervals: Time intervals to mark; their `log` is ignored.
    """
    first, last = min(float(c.time[0]) for c in curves), max(float(c.time[-1]) for c in curves)
    options = _frame(dark)
    for k, curve in enumerate(curves):
        top = _TOP + k * (_PLOT + _GAP)
        name = x_name if k == len(curves) - 1 else None
        options["title"].append(_title(curve, top, dark))
        options["grid"].append({"left": _LEFT, "right": _RIGHT, "top": top, "height": _PLOT})
        options["xAxis"].append({"gridIndex": k, "min": first, "max": last, **_time_axis(name, dark)})
        options["yAxis"].append({"gridIndex": k, **_value_axis(dark)})
        lines = _lines(curve, first, last, dark)
        lines[0]["markArea"] = {
            "silent": True,
            "data": [[{"xAxis": i.begin}, {"xAxis": i.end}] for i in intervals],
            "itemStyle": {"color": ink("good", dark), "opacity": 0.16},
        }
        options["series"] += [{"xAxisIndex": k, "yAxisIndex": k, **line} for line in lines]
    return options


def _title(curve: Curve, top: int, dark: bool) -> dict[str, Any]:
    """Return the title above a curve whose plot begins `top` pixels below the upper edge."""
    color = ink("ink" if curve.used else "muted", dark)
    return {
        "text": f"{{name|{curve.name}}}  {{note|{curve.note}}}",
        "left": _LEFT - 2,
        "top": top - 24,
        "padding": 2,
        "textStyle": {
            "rich": {
                "name": {"fontSize": 13, "fontWeight": 600, "color": color},
                "note": {"fontSize": 12, "fontWeight": "normal", "color": ink("muted", dark)},
            }
        },
    }


def _time_axis(name: str | None, dark: bool) -> dict[str, Any]:
    """Return the axis of times of one plot; without name and numbers if `name` is None."""
    muted = ink("muted", dark)
    return {
        "type": "value",
        "name": name or "",
        "nameLocation": "middle",
        "nameGap": 22,
        "nameTextStyle": {"color": muted},
        "axisLabel": {
            "show": name is not None,
            "color": muted,
            "hideOverlap": True,
            "showMinLabel": False,
            "showMaxLabel": False,
        },
        "axisTick": {"show": name is not None},
        "axisLine": {"lineStyle": {"color": ink("line", dark)}, "onZero": False},
        "splitLine": {"show": False},
    }


def _value_axis(dark: bool) -> dict[str, Any]:
    """Return the axis of values of one plot."""
    return {
        "type": "value",
        "scale": True,
        "splitNumber": 2,
        "axisLabel": {"color": ink("muted", dark), "fontSize": 11, "hideOverlap": True},
        "splitLine": {"lineStyle": {"color": ink("line", dark)}},
    }


def _lines(curve: Curve, first: float, last: float, dark: bool) -> list[dict[str, Any]]:
    """Return a curve's line, and below it those that are compared with it, from one time to another, s."""
    return [
        {
            "type": "line",
            "name": f"{curve.name} {name}".strip(),
            "data": thinned(curve.time, values, first, last),
            "showSymbol": False,
            "step": "end" if curve.held else False,
            "lineStyle": {"width": 1.2},
            "color": ink(SERIES[number] if curve.used else "declared", dark),
            "z": 3 - number,
        }
        for number, (name, values) in enumerate({"": curve.values, **curve.others}.items())
    ]


def _frame(dark: bool) -> dict[str, Any]:
    """Return the options that all charts have."""
    surface, line, text = ink("surface", dark), ink("line", dark), ink("ink", dark)
    return {
        "animation": False,
        "backgroundColor": "transparent",
        "textStyle": {"fontFamily": "system-ui, -apple-system, 'Segoe UI', Roboto, Arial, sans-serif"},
        "title": [],
        "grid": [],
        "xAxis": [],
        "yAxis": [],
        "series": [],
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "tooltip": {
            "trigger": "axis",
            "confine": True,
            "backgroundColor": surface,
            "borderColor": line,
            "textStyle": {"color": text, "fontSize": 12},
        },
    }


def with_zoom(options: dict[str, Any], dark: bool) -> dict[str, Any]:
    """Add a time slider, and zooming by Ctrl and wheel, to a chart of curves.

    Args:
        options: Options of ECharts; they are changed and returned.
        dark: Whether the display is dark.
    """
    options["dataZoom"] = [
        {"type": "inside", "xAxisIndex": "all", "zoomOnMouseWheel": "ctrl", "filterMode": "none"},
        {
            "type": "slider",
            "xAxisIndex": "all",
            "height": 16,
            "bottom": 6,
            "filterMode": "none",
            "showDetail": False,
            "borderColor": ink("line", dark),
            "fillerColor": ink("after", dark) + "22",
            "dataBackground": {"lineStyle": {"opacity": 0}, "areaStyle": {"opacity": 0}},
            "brushSelect": False,
        },
    ]
    return options


def with_selection(options: dict[str, Any], dark: bool) -> dict[str, Any]:
    """Let the mouse select a time interval in a chart of curves.

    Args:
        options: Options of ECharts; they are changed and returned.
        dark: Whether the display is dark.
    """
    options["toolbox"] = {"show": False}
    options["brush"] = {
        "xAxisIndex": "all",
        "brushType": "lineX",
        "brushMode": "single",
        "throttleType": "debounce",
        "brushStyle": {
            "color": ink("after", dark) + "33",
            "borderColor": ink("after", dark),
            "borderWidth": 1,
        },
        "outOfBrush": {"colorAlpha": 1},
    }
    return options


def error_chart(errors: Sequence[tuple[float, float]], now: float, dark: bool) -> dict[str, Any]:
    """Return options of ECharts for the best machine's error over the processor time of the search.

    Args:
        errors: Processor time, s, and chi-squared per sample, at each change of the error; its square root is
            drawn, at least 0.03.
        now: Present processor time, s, to which the last error is continued.
        dark: Whether the display is dark.
    """
    muted, line = ink("muted", dark), ink("line", dark)
    points = [[t, max(e, 1e-3) ** 0.5] for t, e in errors]
    points += [[max(now, points[-1][0]), points[-1][1]]] if points else []
    options = _frame(dark)
    options["grid"] = [{"left": _LEFT, "right": 24, "top": 30, "height": 120}]
    axis = {"nameTextStyle": {"color": muted}, "axisLabel": {"color": muted, "hideOverlap": True}}
    options["xAxis"] = [
        {
            **axis,
            "type": "value",
            "name": "processor time, s",
            "nameLocation": "middle",
            "nameGap": 26,
            "min": 0,
        }
        | {"splitLine": {"show": False}, "axisLine": {"lineStyle": {"color": line}}}
    ]
    options["yAxis"] = [
        {**axis, "type": "log", "name": "error, times the noise", "nameLocation": "end"}
        | {"nameTextStyle": {"color": muted, "align": "left"}, "splitLine": {"lineStyle": {"color": line}}}
    ]
    mark = {"silent": True, "symbol": "none", "label": {"show": False}, "data": [{"yAxis": 1}]}
    options["series"] = [
        {
            "type": "line",
            "name": "error so far",
            "step": "end",
            "data": points,
            "symbolSize": 7,
            "color": ink("after", dark),
            "markLine": mark | {"lineStyle": {"color": ink("good", dark), "type": "dashed"}},
        }
    ]
    return options
