"""Figures of the library and the candidates: correlations, the signed grid, accuracy over size (the paper's 4, 5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator

from odescope.report.data import Searched
from odescope.report.figures.labels import Labels
from odescope.report.figures.style import WIDTH, axes, legend, page, plain, product, style
from odescope.report.palette import BLUE, GREY, ORANGE, PALE, VERMILLION

SIZE = 6.8  # points, of the labels
CELL = 0.155  # inches, of the grid
ABREAST = 4  # panels of the accuracy beside each other, at most
LETTER = 0.056  # inches, about, of one letter of a label
SPACE = "\u2002\u2002"  # of a letter's width, and unlike plain ones not run together in SVG
DIVERGING = ((0.0, "#0a4a73"), (0.25, "#5aa3d0"), (0.5, "#ffffff"), (0.75, "#f0b04a"), (1.0, "#8a3d00"))


def draw_correlation(searched: Searched) -> Figure:
    """Return the matrix of correlations between the candidate terms."""
    data = searched.correlations
    count = max(len(data.terms), 1)
    labels = [f"{product(t, 34)}{SPACE}{k}" for k, t in enumerate(data.terms, start=1)]
    size = 6.5 if count <= 40 else 4.2
    margin = min(LETTER * max(map(len, labels), default=1) * size / 7.5 + 0.15, 2.6)
    side = min(WIDTH - margin - 0.9, max(CELL * count, 1.5))
    head = 0.25
    figure = page(head + side + 0.12)
    with style():
        ax = axes(figure, margin, head, side, side)
        colours = LinearSegmentedColormap.from_list("signed", DIVERGING)
        values = np.array(data.percent, dtype=np.float64).reshape(len(data.terms), -1) / 100.0
        image = ax.imshow(
            values if values.size else np.zeros((1, 1)), cmap=colours, vmin=-1, vmax=1, interpolation="none"
        )
        frame(ax)
        written = Labels(ax)
        for k, label in enumerate(labels):
            written.above(k, str(k + 1), size)
            written.before(k, label, size)
        ax.add_artist(written)
        bar = axes(figure, margin + side + 0.15, head, 0.12, min(side, 2.0))
        figure.colorbar(image, cax=bar, ticks=[-1, -0.5, 0, 0.5, 1])
        bar.tick_params(labelsize=6.5, length=2)
    return figure


def draw_candidates(searched: Searched) -> Figure:
    """Return the implicit models as a grid of signs, one a row; families apart, the chosen one marked."""
    rows, columns = searched.rows, [product(t, 34) for t in searched.columns]
    texts = [SPACE.join((str(r.rank), product(r.guess, 30), f"{r.rmse:.4g}")) for r in rows]
    unit = f" ({plain(searched.unit, 12)})" if searched.unit else ""
    heading = SPACE.join(("rank", "guess", f"RMSE{unit}"))
    left = min(LETTER * max(map(len, (*texts, heading))) + 0.15, 3.6)
    head = LETTER * 0.95 * max(map(len, columns), default=1) + 0.12
    cell = min(CELL, (WIDTH - left - 0.75) / max(len(columns), 1))
    wide, high = cell * max(len(columns), 1), CELL * max(len(rows), 1)
    figure = page(head + high + 0.15)
    signs = np.array([[{"+": 1, "-": -1}.get(s, 0) for s in row.signs] for row in rows], dtype=np.int64)
    signs = signs.reshape(len(rows), len(columns)) if rows and columns else np.zeros((1, 1), dtype=np.int64)
    with style():
        ax = axes(figure, left, head, wide, high)
        shown = np.ma.masked_equal(signs, 0)
        ax.imshow(
            shown, cmap=ListedColormap([BLUE, ORANGE]), vmin=-1, vmax=1, interpolation="none", aspect="auto", zorder=2
        )
        for sign, mark, colour in ((1, "+", "#000000"), (-1, "_", "#ffffff")):
            up, across = np.nonzero(signs == sign)
            ax.plot(
                across, up, linestyle="none", marker=mark, markersize=4.5, color=colour, markeredgewidth=0.9, zorder=3
            )
        for k, row in enumerate(rows):
            if row.chosen:
                ax.axhspan(k - 0.5, k + 0.5, color=PALE, zorder=0.5, linewidth=0)
                ax.plot([-0.5, len(columns) - 0.5], [k - 0.5, k - 0.5], color="#000000", linewidth=0.9, zorder=4)
                ax.plot([-0.5, len(columns) - 0.5], [k + 0.5, k + 0.5], color="#000000", linewidth=0.9, zorder=4)
            elif k and row.family != rows[k - 1].family:
                ax.axhline(k - 0.5, color=GREY, linewidth=0.6, zorder=1)
        frame(ax)
        written = Labels(ax)
        for k, label in enumerate(columns):
            written.above(k, label, SIZE, upright=False)
        for k, text in enumerate((heading, *texts), start=-1):
            written.before(k, text, SIZE)
        for k, text in enumerate(_families(searched), start=-1):
            written.behind(k, text, SIZE)
        ax.add_artist(written)
        ax.set_xlim(-0.5, max(len(columns), 1) - 0.5)
        ax.set_ylim(max(len(rows), 1) - 0.5, -0.5)
    return figure


def frame(ax: Axes) -> None:
    """Leave of axes their frame alone; `Labels` stand in for its ticks."""
    ax.set_xticks([])
    ax.set_yticks([])
    for spine in ax.spines.values():
        spine.set_visible(True)


def _families(searched: Searched) -> list[str]:
    """Return what stands behind every row: the number of the family at its first, and which row was chosen."""
    said, last = ["family"], 0
    for row in searched.rows:
        number = "" if row.family == last else str(row.family)
        said.append(SPACE.join(filter(None, (number, "◀ chosen" if row.chosen else ""))))
        last = row.family
    return said


def draw_accuracy(searches: Sequence[Searched]) -> Figure:
    """Return the held-out error of every candidate over its number of terms, one panel a target."""
    across = min(max(len(searches), 1), ABREAST)
    gap, left, row, high = 0.62, 0.62, 2.4, 1.92
    figure = page(0.35 + row * max(-(-len(searches) // across), 1))
    wide = (WIDTH - left - 0.15 - (across - 1) * gap) / across
    with style():
        for k, searched in enumerate(searches):
            ax = axes(figure, left + (k % across) * (wide + gap), 0.35 + (k // across) * row, wide, high)
            others = [p for p in searched.points if not p.chosen]
            ax.plot(
                [p.terms for p in others], [p.rmse for p in others], linestyle="none", marker="o", markersize=4,
                markerfacecolor="none", markeredgecolor=BLUE, markeredgewidth=0.8, label="candidate",
            )  # fmt: skip
            ax.plot(
                [p.terms for p in searched.points if p.chosen], [p.rmse for p in searched.points if p.chosen],
                linestyle="none", marker="D", markersize=7, color=VERMILLION, markeredgecolor="#000000", label="chosen",
            )  # fmt: skip
            if all(p.rmse > 0.0 for p in searched.points):
                ax.set_yscale("log")
                ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=8))
                ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
                ax.minorticks_off()
            ax.xaxis.set_major_locator(MaxNLocator(8, integer=True))
            unit = f" ({plain(searched.unit, 12)})" if searched.unit else ""
            ax.set_ylabel(f"held-out RMSE of {plain(searched.target, 20)}{unit}", labelpad=3, fontsize=7)
            ax.set_xlabel("terms of the implicit model", labelpad=2)
            ax.margins(0.06)
            ax.grid(axis="y", linewidth=0.4, color="#e5e7eb")
            if k == 0:
                legend(figure, ax)
    return figure
