"""How figures look, and how they become SVG and PNG: one palette, no global state left behind.

Colours are those of Okabe and Ito, which survive colour blindness; lines also differ in style and lightness, so that
they survive grey printing.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from odescope.arrays import FloatArray
from odescope.library.numerals import raised
from odescope.report.data import Line, Role
from odescope.report.palette import BLACK, BLUE, GREEN, RECORDED, VERMILLION

WIDTH = 7.2  # inches
RESOLUTION = 130  # dots per inch of the PNG
LONGEST = 40  # characters of a label

LINES: dict[Role, dict[str, Any]] = {
    "recorded": {"color": RECORDED, "linewidth": 1.6, "zorder": 1.8},
    "gated": {
        "color": VERMILLION,
        "linestyle": "none",
        "marker": "x",
        "markersize": 3.2,
        "markeredgewidth": 0.8,
        "zorder": 2.6,
    },
    "estimated": {"color": BLUE, "linewidth": 1.0, "zorder": 2.0},
    "truth": {"color": BLACK, "linewidth": 0.9, "linestyle": (0, (1, 1.6)), "zorder": 2.2},
    "model": {"color": VERMILLION, "linewidth": 1.1, "linestyle": (0, (4, 1.6)), "zorder": 2.4},
    "refitted": {"color": GREEN, "linewidth": 1.0, "linestyle": (0, (4, 1.4, 1, 1.4)), "zorder": 2.3},
}

_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#52525b",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "axes.grid": False,
    "axes.unicode_minus": True,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "text.parse_math": False,
    "svg.fonttype": "none",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.dpi": 100.0,
}
_FAMILY = "'DejaVu Sans', Verdana, sans-serif"


@contextmanager
def style(salt: str | None = None) -> Iterator[None]:
    """Draw in the report's style, whatever the user's own is; equal salts make equal ids in an SVG."""
    with mpl.rc_context(_STYLE | {"svg.hashsalt": salt}):
        yield


def page(height: float) -> Figure:
    """Return an empty figure of the report's width; height in inches."""
    return Figure(figsize=(WIDTH, height))


def axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Return axes placed in inches: nothing is laid out twice.

    Args:
        figure: that they belong to.
        left: from the left edge of the figure.
        top: from its top.
        width: of the axes.
        height: of the axes.
    """
    wide, high = figure.get_size_inches()
    return figure.add_axes((left / wide, 1.0 - (top + height) / high, width / wide, height / high))


def draw(ax: Axes, lines: Sequence[Line]) -> None:
    """Draw lines by their roles."""
    for line in lines:
        ax.plot(numbers(line.x), numbers(line.y), label=plain(line.label), solid_capstyle="round", **LINES[line.role])


def numbers(values: Sequence[float | None]) -> FloatArray:
    """Return numbers as an array, NaN where there is none."""
    return np.array(values, dtype=np.float64)


def plain(text: str, longest: int = LONGEST) -> str:
    """Return text that any XML and any font can bear: one line, no control characters, not too long."""
    clean = "".join(c if c.isprintable() else " " for c in text)
    clean = " ".join(clean.split())
    return clean if len(clean) <= longest else clean[: longest - 1] + "…"


def product(text: str, longest: int = LONGEST) -> str:
    """Return a term for a label: dots between the factors, small powers raised."""
    powers = re.sub(r"\*\*(-?\d+)(?![\d.])", lambda m: raised(int(m[1])), text)
    return plain(powers.replace("**", "^").replace("*", "·"), longest)


def decades(value: float, _: float | None) -> str:
    """Return the label of a tick on a logarithmic axis of many decades."""
    return f"10{raised(round(float(np.log10(value))))}" if value > 0.0 else ""


def legend(figure: Figure, ax: Axes, columns: int = 4) -> None:
    """Put the legend of some axes at the head of a figure.

    Args:
        figure: where it goes.
        ax: whose lines it names.
        columns: at most.
    """
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.085, 1.0), ncols=columns, handlelength=2.4)


def saved(figure: Figure, name: str) -> tuple[str, bytes]:
    """Return a figure as SVG, the same each time, and as PNG."""
    vector, raster = io.StringIO(), io.BytesIO()
    with style(salt=name), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of letters that a font lacks: the reader's own fonts may have them
        FigureCanvasSVG(figure).print_svg(vector, metadata={"Date": None, "Creator": None})  # type: ignore[no-untyped-call]
        figure.set_dpi(RESOLUTION)
        FigureCanvasAgg(figure).print_png(  # type: ignore[no-untyped-call]
            raster, pil_kwargs={"compress_level": 3}, metadata={"Software": None}
        )
    return _compact(vector.getvalue()), raster.getvalue()


def _compact(svg: str) -> str:
    """Return an SVG without what only its maker needs: group names, long lists of fonts, six digits."""
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r"'DejaVu Sans', [^;\"]*sans-serif", _FAMILY, svg)
    svg = re.sub(r' d="([^"]*)"', lambda m: f' d="{_short(m[1])}"', svg)
    return re.sub(r'(<use [^>]*?)x="([^"]*)" y="([^"]*)"', _placed, svg)


def _short(path: str) -> str:
    return re.sub(r"\s*\n\s*", "", re.sub(r"(\d+\.\d)\d+", r"\1", path)).strip()


def _placed(match: re.Match[str]) -> str:
    return f'{match[1]}x="{float(match[2]):.1f}" y="{float(match[3]):.1f}"'
