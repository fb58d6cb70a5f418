"""A chart of long lines: whatever part is looked at is drawn anew, with the extremes of every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nicegui.events import GenericEventArguments

from odescope.report.data import Role
from odescope.report.palette import BLACK
from odescope.workbench import charts
from odescope.workbench.frame import text
from odescope.workbench.overview import Overview

PIXELS = 1200  # of a line
AROUND = 0.5  # of what is looked at: what is drawn on either side, so that it is there when the picture is moved
ZOOM = "(e) => { const z = e.batch ? e.batch[0] : e; emit({start: z.start, end: z.end}); }"
HELP = "Drag the picture to move along it, and the ends of the bar to zoom; with Shift held, the wheel zooms."


@dataclass(frozen=True, eq=False)
class LongLine:
    """A line by its name, with its role."""

    name: str
    role: Role
    values: Overview


@dataclass(frozen=True, eq=False)
class LongPlot:
    """A panel of them under the label of its ordinate."""

    label: str
    lines: tuple[LongLine, ...]


class LongChart:
    """Panels over one axis. What it shows can be exchanged for as many panels of as many lines."""

    def __init__(self, plots: Sequence[LongPlot], axis: str, label: str, legend: bool = True) -> None:
        """Draw the whole.

        Args:
            plots: from the top down.
            axis: label of the abscissa.
            label: what the chart shows, for who does not see it.
            legend: whether lines are named above.
        """
        self._plots, self._axis, self._legend = tuple(plots), axis, legend
        self._part = (0.0, 100.0)  # per cent of the abscissa that are looked at
        self.chart = charts.chart(self._options(), label, charts.height(len(plots)))
        self.chart.on("chart:datazoom", self._zoomed, js_handler=ZOOM)
        text("p", HELP, "about")

    def show(self, plots: Sequence[LongPlot]) -> None:
        """Show other lines where these were."""
        self._plots = tuple(plots)
        self.chart.options.update(self._options())
        self.chart.update()  # which waits, unlike a call, for a chart whose script is still on the way

    def mark(self, abscissa: float) -> None:
        """Draw a line across all panels."""
        line = {"silent": True, "symbol": "none", "data": [{"xAxis": abscissa}], "animation": False}
        style = {"label": {"show": False}, "lineStyle": {"color": BLACK, "width": 1, "type": "solid"}}
        count = sum(len(plot.lines) for plot in self._plots)
        self.chart.run_chart_method("setOption", {"series": [{"markLine": {**line, **style}}] * count})

    def _options(self) -> charts.Options:
        options = charts.stacked(self._drawn(), self._axis, self._span)
        return options if self._legend else {**options, "legend": {"show": False}}

    @property
    def _span(self) -> tuple[float, float]:
        return self._plots[0].lines[0].values.span

    def _drawn(self) -> list[charts.Plot]:
        first, last = self._span
        begin, end = (first + share / 100.0 * (last - first) for share in self._part)
        more = AROUND * (end - begin)
        low, high = max(begin - more, first), min(end + more, last)
        return [
            charts.Plot(
                plot.label,
                tuple(charts.line(one.name, *one.values.window(low, high, PIXELS), one.role) for one in plot.lines),
            )
            for plot in self._plots
        ]

    def _zoomed(self, event: GenericEventArguments) -> None:
        self._part = (event.args["start"], event.args["end"])
        series = [{"data": one["data"]} for plot in self._drawn() for one in plot.lines]
        self.chart.run_chart_method("setOption", {"series": series})
