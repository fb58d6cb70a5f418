"""The figure of the path of models: held-out error of free runs over the number of terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator

from odescope.model.scores import PathScore
from odescope.report.figures.style import WIDTH, axes, legend, numbers, page, style
from odescope.report.palette import BLUE, VERMILLION

LEFT, RIGHT = 0.72, 0.15  # inches
LOW, HIGH = 0.5, 1.5  # of the least and the largest number shown: limits of the axis


def draw_path(path: Sequence[PathScore]) -> Figure:
    """Return the error of every model on the path over its number of terms, its spread as bars, the chosen one marked.

    A bar that reaches below zero ends at the foot of the logarithmic axis.
    """
    figure = page(2.75)
    terms, chosen = np.array([s.terms for s in path]), np.array([s.chosen for s in path], dtype=np.bool_)
    error, spread = numbers([s.error for s in path]), np.nan_to_num(numbers([s.spread for s in path]))
    known = np.isfinite(error)
    with style():
        ax = axes(figure, LEFT, 0.35, WIDTH - LEFT - RIGHT, 1.92)
        if known.any() and (error[known] > 0.0).all():
            ends = error[known] - spread[known]
            low = LOW * min(error[known].min(), *ends[ends > 0.0])
            ax.set_yscale("log")
            ax.set_ylim(low, HIGH * (error + spread)[known].max())
            ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=8))
            ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
            ax.minorticks_off()
            lower = np.minimum(spread, error - 0.5 * low)
        else:
            lower = spread
        ax.errorbar(terms, error, (lower, spread), linestyle="none", ecolor=BLUE, elinewidth=0.9, capsize=2.5, zorder=2)
        ax.plot(
            terms[~chosen], error[~chosen], linestyle="none", marker="o", markersize=4, markerfacecolor="#ffffff",
            markeredgecolor=BLUE, markeredgewidth=0.8, label="model on the path", zorder=3,
        )  # fmt: skip
        ax.plot(
            terms[chosen], error[chosen], linestyle="none", marker="D", markersize=7, color=VERMILLION,
            markeredgecolor="#000000", label="chosen", zorder=4,
        )  # fmt: skip
        ax.xaxis.set_major_locator(MaxNLocator(12, integer=True))
        ax.set_ylabel("free-run error, held out (std)", labelpad=3, fontsize=7)
        ax.set_xlabel("terms", labelpad=2)
        ax.grid(axis="y", linewidth=0.4, color="#e5e7eb")
        legend(figure, ax)
    return figure
