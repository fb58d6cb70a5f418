"""The figure of the free runs: a thumbnail for every recording, of one recording at full width."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from odescope.report.data import Panel, Thumbnail, Thumbnails, side_by_side
from odescope.report.figures.style import LINES, WIDTH, axes, draw, numbers, page, plain, style
from odescope.report.palette import GREY

LEFT, RIGHT, BETWEEN, GAP, HEAD, TITLE, FOOT = 0.72, 0.12, 0.16, 0.12, 0.3, 0.2, 0.42  # inches
HEIGHTS = {1: 1.2, 2: 0.95, 3: 0.8}  # inches of a panel, by how many stand side by side
LOW = 0.62
PARTED = {"color": GREY, "linewidth": 0.9, "linestyle": (0, (2, 2))}
ROOM = 0.08  # of the range of a coordinate, above and below


def draw_thumbnails(shown: Thumbnails) -> Figure:
    """Return a block of panels for every recording, some side by side, with the same scales in all."""
    wide = side_by_side(len(shown.runs))
    coordinates = max((len(run.panels) for run in shown.runs), default=1)
    blocks = [shown.runs[k : k + wide] for k in range(0, len(shown.runs), wide)] or [()]
    panel = HEIGHTS.get(wide, LOW)
    block = TITLE + coordinates * (panel + GAP) + FOOT - GAP
    figure = page(HEAD + len(blocks) * block)
    width = (WIDTH - LEFT - RIGHT - (wide - 1) * BETWEEN) / wide
    limits = [_limits([run.panels[k] for run in shown.runs]) for k in range(coordinates)]
    with style():
        for b, runs in enumerate(blocks):
            for k, run in enumerate(runs):
                top = HEAD + b * block + TITLE
                column = [
                    axes(figure, LEFT + k * (width + BETWEEN), top + c * (panel + GAP), width, panel)
                    for c in range(coordinates)
                ]
                _column(column, run, limits, 0 if wide == 1 else k + 1)
        _legend(figure, shown)
    return figure


def _column(column: Sequence[Axes], run: Thumbnail, limits: Sequence[tuple[float, float]], place: int) -> None:
    """Draw one recording; `place` counts those of its row from 1, and is 0 where it has the width alone."""
    ends = [x[-1] for p in run.panels for line in p.wide if len(x := numbers(line.x))]
    for k, (ax, panel) in enumerate(zip(column, run.panels, strict=True)):
        draw(ax, panel.wide)
        if run.mark is not None:
            ax.axvline(run.mark, **PARTED)  # type: ignore[arg-type]
        ax.set_ylim(*limits[k])
        ax.set_xlim(0.0, max(ends, default=1.0) or 1.0)
        ax.xaxis.set_major_locator(MaxNLocator(3 if place else 8))
        ax.yaxis.set_major_locator(MaxNLocator(2 if ax.bbox.height < 60 else 4, min_n_ticks=2))
        if place < 2:
            ax.set_ylabel(plain(panel.label, 22), labelpad=3)
        else:
            ax.tick_params(labelleft=False)
        if k == 0:
            ax.set_title(plain(run.title), loc="left", pad=3)
        if k == len(column) - 1:
            ax.set_xlabel("time (s)", labelpad=1)
        else:
            ax.tick_params(labelbottom=False)


def _limits(panels: Sequence[Panel]) -> tuple[float, float]:
    """Return the limits of what was measured of a coordinate in all recordings, and of runs near it."""
    values = [numbers(line.y) for panel in panels for line in panel.wide if len(line.y)]
    joined = np.concatenate(values) if values else np.zeros(1)
    joined = joined[np.isfinite(joined)] if np.isfinite(joined).any() else np.zeros(1)
    low, high = float(joined.min()), float(joined.max())
    room = ROOM * (high - low) or 1.0
    return low - room, high + room


def _legend(figure: Figure, shown: Thumbnails) -> None:
    handles = [
        Line2D([], [], label="measured", **LINES["recorded"]),
        Line2D([], [], label="free run of the model", **LINES["model"]),
    ]
    if any(run.mark is not None for run in shown.runs):
        handles.append(Line2D([], [], label="here it parts from the record", **PARTED))  # type: ignore[arg-type]
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.085, 1.0), ncols=3, handlelength=2.4)
