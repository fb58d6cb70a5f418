"""The figure of a validation: what was measured, and the free runs of every model over it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from odescope.report.downsample import min_max
from odescope.report.figures.style import LINES, WIDTH, axes, legend, page, plain, style
from odescope.report.palette import BLUE, GREEN, ORANGE, SKY, VERMILLION
from odescope.validation.free_runs import FreeRunOf

COLOURS = (VERMILLION, BLUE, GREEN, ORANGE, SKY)
DASHES = ((0, (4, 1.6)), (0, (4, 1.4, 1, 1.4)), (0, (1, 1.2)), (0, (7, 2)), (0, (2, 1)))
LEFT, RIGHT, HEIGHT, GAP, HEAD, FOOT = 0.72, 0.12, 1.3, 0.2, 0.32, 0.42  # inches
PIXELS = 900


def draw_free_runs(runs: tuple[FreeRunOf, ...], coordinates: tuple[tuple[str, str | None, float], ...]) -> Figure:
    """Return a panel for every coordinate (name, unit, offset): the longest recording, and the runs over it."""
    widest = max(runs, key=lambda of: of.record.duration)
    longest, shown = widest.record, [of for of in runs if of.number == widest.number]
    count = len(coordinates)
    figure = page(HEAD + count * HEIGHT + (count - 1) * GAP + FOOT)
    with style():
        for k, (name, unit, offset) in enumerate(coordinates):
            ax = axes(figure, LEFT, HEAD + k * (HEIGHT + GAP), WIDTH - LEFT - RIGHT, HEIGHT)
            measured = longest.column(name)
            kept = min_max(longest.t, measured, PIXELS)
            ax.plot(longest.t[kept], measured[kept], label="measured", **LINES["recorded"])
            low, high = float(measured.min()), float(measured.max())
            room = 0.5 * (high - low) or 1.0
            for number, of in enumerate(shown):
                values = np.clip(of.run.column(name) + offset, low - 2 * room, high + 2 * room)
                kept = min_max(of.run.t, values, PIXELS)
                colour, dashes = COLOURS[number % 5], DASHES[number % 5]
                ax.plot(
                    of.run.t[kept], values[kept], color=colour, linestyle=dashes, linewidth=1.0, label=plain(of.model)
                )
            ax.set_ylim(low - room, high + room)
            ax.set_ylabel(plain(f"{name} ({unit})" if unit else name, 26), labelpad=3)
            ax.margins(x=0.01)
            ax.xaxis.set_major_locator(MaxNLocator(8))
            ax.yaxis.set_major_locator(MaxNLocator(4, min_n_ticks=2))
            if k == count - 1:
                ax.set_xlabel("time (s)", labelpad=2)
            else:
                ax.tick_params(labelbottom=False)
            if k == 0:
                legend(figure, ax)
    return figure
