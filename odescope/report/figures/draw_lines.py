"""Figures over time and over frequency: signals, derivatives, the model at work, spectra (the paper's 1 to 3, 6, 7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator

from odescope.report.data import Chart, Panel, Periodogram
from odescope.report.figures.style import WIDTH, axes, decades, draw, legend, numbers, page, plain, style
from odescope.report.palette import BLUE, GREY, ORANGE, VERMILLION

LEFT, RIGHT, BETWEEN, CLOSE = 0.72, 0.12, 0.6, 1.95  # inches
HEIGHT, GAP, HEAD, FOOT = 1.05, 0.2, 0.32, 0.42


def draw_chart(chart: Chart) -> Figure:
    """Return panels below each other, each over all of the time and, on the right, close up."""
    count = max(len(chart.panels), 1)
    figure = page(HEAD + count * HEIGHT + (count - 1) * GAP + FOOT)
    close = max((k for k, panel in enumerate(chart.panels) if panel.close), default=-1)
    wide = WIDTH - LEFT - RIGHT - ((BETWEEN + CLOSE) if close >= 0 else 0.0)
    with style():
        for k, panel in enumerate(chart.panels):
            top, last = HEAD + k * (HEIGHT + GAP), k == count - 1
            ax = axes(figure, LEFT, top, wide, HEIGHT)
            _panel(ax, panel, chart, last)
            if panel.close:
                _close(axes(figure, LEFT + wide + BETWEEN, top, CLOSE, HEIGHT), ax, panel, chart, k == close)
            if k == 0:
                legend(figure, ax)
    return figure


def _panel(ax: Any, panel: Panel, chart: Chart, last: bool) -> None:
    draw(ax, panel.wide)
    ax.set_ylabel(plain(panel.label, 26), labelpad=3)
    ax.margins(x=0.01)
    for at, _ in chart.marks:
        ax.axvline(at, color=GREY, linewidth=0.8, linestyle=(0, (2, 2)))
    if chart.marks:
        at, text = chart.marks[0]
        ax.annotate(
            plain(text), (at, 1.0), (3, -2), xycoords=("data", "axes fraction"), textcoords="offset points",
            fontsize=6.5, color=GREY, va="top",
        )  # fmt: skip
    _ticks(ax, chart.time if last else "", 8)


def _close(ax: Any, wide: Any, panel: Panel, chart: Chart, last: bool) -> None:
    draw(ax, panel.close)
    ax.margins(x=0.0)
    low, high = ax.get_xlim()
    first, end = wide.get_xlim()
    if high - low < 0.5 * (end - first):
        wide.axvspan(low, high, color="#e5e7eb", zorder=0.5, linewidth=0)
    ax.set_facecolor("#f6f7f8")
    _ticks(ax, chart.beside if last else "", 4)


def _ticks(ax: Any, label: str, count: int) -> None:
    ax.xaxis.set_major_locator(MaxNLocator(count))
    ax.yaxis.set_major_locator(MaxNLocator(4, min_n_ticks=2))
    if label:
        ax.set_xlabel(label, labelpad=2)
    else:
        ax.tick_params(labelbottom=False)


def draw_spectra(spectra: Sequence[Periodogram]) -> Figure:
    """Return the periodograms with noise floor and ceiling, the chosen cutoff and the paper's."""
    count, height = max(len(spectra), 1), 1.6
    figure = page(HEAD + count * height + (count - 1) * GAP + FOOT + 0.12)
    with style():
        for k, spectrum in enumerate(spectra):
            ax = axes(figure, LEFT, HEAD + 0.12 + k * (height + GAP), WIDTH - LEFT - RIGHT, height)
            x, y = numbers(spectrum.power.x), numbers(spectrum.power.y)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.plot(x, y, color="#8b9099", linewidth=0.9, label="periodogram")
            ax.axhline(spectrum.floor, color=BLUE, linewidth=1.0, label="noise floor")
            ax.axhline(
                spectrum.ceiling, color=ORANGE, linewidth=1.0, linestyle=(0, (5, 2)), label="noise ceiling (paper)"
            )
            ax.axvline(spectrum.cutoff, color=VERMILLION, linewidth=1.4, label="cutoff")
            ax.axvline(
                spectrum.paper_cutoff, color="#000000", linewidth=1.0, linestyle=(0, (1, 1.5)),
                label="cutoff (paper)",
            )  # fmt: skip
            ax.set_ylabel(_density(spectrum), labelpad=3)
            _limits(ax, x, y, spectrum)
            for axis, most in ((ax.xaxis, 8), (ax.yaxis, 5)):
                axis.set_major_locator(LogLocator(numticks=most))
                axis.set_major_formatter(decades)
            ax.minorticks_off()
            if k == count - 1:
                ax.set_xlabel("frequency (Hz)", labelpad=2)
            else:
                ax.tick_params(labelbottom=False)
            if k == 0:
                legend(figure, ax, 5)
    return figure


def _density(spectrum: Periodogram) -> str:
    unit = plain(spectrum.unit, 8)
    return f"{spectrum.channel} ({unit}² / Hz)" if unit.isalnum() else spectrum.channel


def _limits(ax: Any, x: Any, y: Any, spectrum: Periodogram) -> None:
    positive = y[np.isfinite(y) & (y > 1e-290)]
    levels = [v for v in (spectrum.floor, spectrum.ceiling, *positive.tolist()) if v > 0.0]
    if levels:
        ax.set_ylim(0.4 * min(levels), 2.5 * max(levels))
    known = [*x[np.isfinite(x) & (x > 0.0)].tolist(), *(v for v in (spectrum.cutoff, spectrum.paper_cutoff) if v > 0.0)]
    if known:
        ax.set_xlim(min(known), max(known))
