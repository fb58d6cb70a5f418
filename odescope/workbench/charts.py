"""Charts in the colours of the report; lines come as arrays, and never more than there are pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from nicegui import ui

from odescope.arrays import FloatArray
from odescope.report.data import Point, Role
from odescope.report.palette import BLACK, BLUE, GREEN, GREY, ORANGE, RECORDED, SKY, VERMILLION

Options: TypeAlias = "dict[str, object]"
LEFT, RIGHT, HEIGHT, GAP, FOOT = 74, 18, 120, 26, 74  # pixels
STYLES: dict[Role, tuple[str, float, object]] = {
    "recorded": (RECORDED, 2.0, "solid"),
    "gated": (VERMILLION, 0.0, "solid"),
    "estimated": (BLUE, 1.3, "solid"),
    "truth": (BLACK, 1.2, "dotted"),
    "model": (VERMILLION, 1.5, [6, 3]),
    "refitted": (GREEN, 1.3, [6, 2, 1, 2]),
}
COLOURS = (VERMILLION, BLUE, GREEN, ORANGE, SKY, BLACK)


@dataclass(frozen=True, eq=False)
class Plot:
    """One panel of lines over a shared axis: the label of its ordinate, and the lines with their styles."""

    label: str
    lines: tuple[Options, ...]


def line(
    name: str, x: FloatArray | Sequence[float | None], y: FloatArray | Sequence[float | None], role: Role = "estimated"
) -> Options:
    """Return a line of a role.

    Args:
        name: in the legend.
        x: abscissas (n,).
        y: ordinates (n,); None or NaN interrupts it.
        role: how it is drawn.
    """
    colour, width, dash = STYLES[role]
    return _line(name, points(x, y), colour, width, dash)


def coloured(name: str, x: FloatArray, y: FloatArray, number: int) -> Options:
    """Return one of several lines of a kind, told apart by its colour.

    Args:
        name: in the legend.
        x: abscissas (n,).
        y: ordinates (n,).
        number: of the line, from 0.
    """
    return _line(name, points(x, y), COLOURS[number % len(COLOURS)], 1.5, "solid" if number < len(COLOURS) else [6, 3])


def points(x: FloatArray | Sequence[float | None], y: FloatArray | Sequence[float | None]) -> list[list[float | None]]:
    """Return pairs for a chart, with None where there is no number."""
    pairs = zip(_plain(x), _plain(y), strict=True)
    return [[a, b] for a, b in pairs]


def _plain(values: FloatArray | Sequence[float | None]) -> list[float | None]:
    listed = list(values) if isinstance(values, tuple | list) else values.tolist()  # type: ignore[union-attr]
    return [None if v is None or v != v or abs(v) == float("inf") else v for v in listed]


def _line(name: str, data: list[list[float | None]], colour: str, width: float, dash: object) -> Options:
    crosses = width == 0.0
    return {
        "type": "scatter" if crosses else "line",
        "name": name,
        "data": data,
        "symbol": "path://M0,0L8,8M8,0L0,8" if crosses else "none",
        "symbolSize": 5,
        "itemStyle": {"color": colour, "borderColor": colour, "borderWidth": 1},
        "lineStyle": {"color": colour, "width": width, "type": dash},
        "connectNulls": False,
        "emphasis": {"disabled": True},
        "animation": False,
    }


def height(panels: int) -> int:
    """Return the height in pixels of a chart of panels."""
    return 34 + panels * (HEIGHT + GAP) + FOOT


def stacked(plots: Sequence[Plot], axis: str, span: tuple[float, float] | None = None) -> Options:
    """Return a chart of panels over one axis that is zoomed and panned for all of them.

    Args:
        plots: from the top down.
        axis: label of the abscissa.
        span: its ends; by default those of the lines.
    """
    every = list(range(len(plots)))
    low, high = span or (None, None)
    series = [{**one, "xAxisIndex": k, "yAxisIndex": k} for k, plot in enumerate(plots) for one in plot.lines]
    tops = [34 + k * (HEIGHT + GAP) for k in every]
    return {
        **_common([str(s["name"]) for s in series]),
        "grid": [{"left": LEFT, "right": RIGHT, "top": top, "height": HEIGHT} for top in tops],
        "xAxis": [
            {
                **_axis(axis if k == every[-1] else "", 26),
                "gridIndex": k,
                "min": low,
                "max": high,
                "axisLabel": {
                    "show": k == every[-1],
                    "color": GREY,
                    "hideOverlap": True,
                    "showMinLabel": span is None,
                    "showMaxLabel": span is None,
                },
            }
            for k in every
        ],
        "yAxis": [{**_axis(plot.label, 52), "gridIndex": k, "scale": True} for k, plot in enumerate(plots)],
        "axisPointer": {"link": [{"xAxisIndex": "all"}], "label": {"show": False}},
        "series": series,
        "dataZoom": _zoom(every),
    }


def _zoom(axes: list[int]) -> list[Options]:
    every: Options = {"xAxisIndex": axes, "filterMode": "none", "throttle": 40}
    inside = {**every, "type": "inside", "zoomOnMouseWheel": "shift", "moveOnMouseWheel": False}
    return [
        inside,
        {**every, "type": "slider", "height": 20, "bottom": 8, "showDataShadow": False, "brushSelect": False},
    ]


def _common(names: Sequence[str]) -> Options:
    return {
        "animation": False,
        "textStyle": {"fontFamily": "system-ui, sans-serif", "fontSize": 12},
        "legend": {"top": 0, "left": LEFT - 8, "itemWidth": 26, "data": list(dict.fromkeys(names)), "type": "scroll"},
        "tooltip": {"trigger": "axis", "confine": True, "axisPointer": {"type": "line", "animation": False}},
    }


def _axis(name: str, gap: int) -> Options:
    return {
        "type": "value",
        "name": name,
        "nameLocation": "middle",
        "nameGap": gap,
        "nameTextStyle": {"color": "#3f3f46", "width": HEIGHT, "overflow": "truncate"},
        "axisLine": {"show": True, "lineStyle": {"color": "#a1a1aa"}},
        "axisTick": {"show": True, "lineStyle": {"color": "#a1a1aa"}},
        "axisLabel": {"color": GREY, "hideOverlap": True},
        "splitLine": {"show": True, "lineStyle": {"color": "#f0f0f1"}},
    }


@dataclass(frozen=True, eq=False)
class Group:
    """Points of one kind: their name and coordinates, the number of their colour, and whether they are chosen ones."""

    name: str
    points: Sequence[tuple[float, float | None]]
    colour: int
    chosen: bool


def candidates(found: Mapping[str, Sequence[Point]]) -> None:
    """Make a chart of candidates by their targets."""
    groups = []
    for k, (target, points_) in enumerate(found.items(), 1):
        groups.append(Group(target, [(p.terms, p.rmse) for p in points_ if not p.chosen], k, False))
        groups.append(Group(f"{target}, chosen", [(p.terms, p.rmse) for p in points_ if p.chosen], k, True))
    chart(spots(groups, "terms", "held-out error"), "candidates: held-out error over terms", 320)


def spots(groups: Sequence[Group], across: str, up: str) -> Options:
    """Return a chart of points over whole numbers, the ordinate logarithmic; the chosen are filled.

    Args:
        groups: of points; those of one colour belong together.
        across: label of the abscissa.
        up: label of the ordinate.
    """
    series = []
    for group in groups:
        colour, chosen = COLOURS[group.colour % len(COLOURS)], group.chosen
        series.append(
            {
                "type": "scatter",
                "name": group.name,
                "data": [[a, b] for a, b in group.points if b is not None and b > 0.0],
                "symbol": "diamond" if chosen else "circle",
                "symbolSize": 14 if chosen else 8,
                "itemStyle": {
                    "color": colour if chosen else "rgba(255,255,255,0.7)",
                    "borderColor": BLACK if chosen else colour,
                    "borderWidth": 1 if chosen else 1.5,
                },
                "z": 3 if chosen else 2,
            }
        )
    numbers = [a for group in groups for a, _ in group.points] or [0.0]
    return {
        **_common([group.name for group in groups]),
        "tooltip": {"trigger": "item", "confine": True},
        "grid": {"left": LEFT, "right": RIGHT, "top": 34, "bottom": 46},
        "xAxis": {**_axis(across, 26), "minInterval": 1, "min": min(numbers) - 1, "max": max(numbers) + 1},
        "yAxis": {**_axis(up, 56), "type": "log", "scale": True},
        "series": series,
    }


def spectrum(name: str, up: str, power: Options, across: dict[str, float], levels: dict[str, float]) -> Options:
    """Return a periodogram, both axes logarithmic, with lines across it.

    Args:
        name: of the channel.
        up: label of the ordinate.
        power: the line.
        across: frequencies in Hz that are marked, by their labels.
        levels: powers that are marked.
    """
    marks = [{"xAxis": at, "label": {"formatter": said, "position": "end"}} for said, at in across.items() if at > 0.0]
    marks += [
        {"yAxis": at, "label": {"formatter": said, "position": "insideStartBottom"}, "lineStyle": {"color": GREY}}
        for said, at in levels.items()
        if at > 0.0
    ]
    drawn = {**power, "markLine": {"symbol": "none", "silent": True, "lineStyle": {"color": VERMILLION}, "data": marks}}
    return {
        **_common([name]),
        "legend": {"show": False},
        "grid": {"left": LEFT + 14, "right": RIGHT + 20, "top": 30, "bottom": 46},
        "xAxis": {**_axis("frequency (Hz)", 26), "type": "log"},
        "yAxis": {**_axis(f"{name}: {up}", 64), "type": "log"},
        "series": [drawn],
    }


def matrix(names: Sequence[str], percent: Sequence[Sequence[int]]) -> Options:
    """Return the correlations between terms as a chart of coloured squares."""
    cells = [[j, k, value] for k, row in enumerate(percent) for j, value in enumerate(row)]
    labels = {"type": "category", "data": list(names), "splitArea": {"show": False}}
    small = {"fontSize": 10, "color": GREY, "width": 110, "overflow": "truncate"}
    return {
        "animation": False,
        "tooltip": {"confine": True},
        "grid": {"left": 120, "right": 20, "top": 10, "bottom": 150},
        "xAxis": {**labels, "axisLabel": {**small, "rotate": 60, "interval": 0 if len(names) <= 40 else "auto"}},
        "yAxis": {**labels, "inverse": True, "axisLabel": {**small, "interval": 0 if len(names) <= 40 else "auto"}},
        "visualMap": {
            "min": -100,
            "max": 100,
            "orient": "horizontal",
            "left": "center",
            "bottom": 0,
            "inRange": {"color": [BLUE, "#ffffff", ORANGE]},
            "text": ["100 %", "−100 %"],
        },
        "series": [{"type": "heatmap", "name": "correlation (%)", "data": cells}],
    }


def chart(options: Options, label: str, pixels: int) -> ui.echart:
    """Return a chart on the page.

    Args:
        options: of the chart.
        label: what it shows, for who does not see it.
        pixels: its height.
    """
    made = ui.echart(options).classes("chart").style(f"height: {pixels}px")
    made.props["role"] = "img"
    made.props["aria-label"] = label
    return made
