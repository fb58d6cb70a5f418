"""Many short labels as one artist: matplotlib shapes each text by itself, a millisecond and more a label.

Here letters are set one after the other by their advances, which for labels is all it takes. A vector file still gets
text, pixels get the outlines of the letters, all filled at once.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ft2font import LoadFlags
from matplotlib.path import Path
from matplotlib.transforms import IdentityTransform

from odescope.arrays import FloatArray

FONT = "DejaVu Sans"
PAD = 3.0  # points between a label and the frame
MIDDLE = 0.27  # of the size: how far the middle of a line of text is above its foot


class Labels(Artist):
    """Labels around axes whose cells are counted from zero: above columns, before and behind rows."""

    def __init__(self, ax: Axes) -> None:
        super().__init__()
        self._around = ax
        self.set_zorder(5.0)
        self._labels: list[tuple[str, float, str, float]] = []

    def above(self, column: int, text: str, size: float, upright: bool = True) -> None:
        """Write above a column, from below upwards unless upright.

        Args:
            column: counted from zero.
            text: on one line.
            size: of the letters in points.
            upright: whether it reads from left to right.
        """
        self._labels.append(("above" if upright else "rising", column, text, size))

    def before(self, row: int, text: str, size: float) -> None:
        """Write before a row.

        Args:
            row: counted from zero; -1 is above the first.
            text: on one line.
            size: of the letters in points.
        """
        self._labels.append(("before", row, text, size))

    def behind(self, row: int, text: str, size: float) -> None:
        """Write behind a row.

        Args:
            row: as in `before`.
            text: on one line.
            size: of the letters in points.
        """
        self._labels.append(("behind", row, text, size))

    def draw(self, renderer: RendererBase) -> None:
        """Draw all labels."""
        outlines = []
        for place, cell, text, size in self._labels:
            if not text:
                continue
            scale = _pixels(renderer, size)
            x, y, angle = self._foot(renderer, place, cell, text, scale)
            if hasattr(renderer, "writer"):  # of SVG, which counts from the top
                graphics = renderer.new_gc()
                renderer.draw_text(
                    graphics, x, renderer.get_canvas_width_height()[1] - y, text, FontProperties(FONT, size=size), angle
                )
            else:
                outlines += _placed(text, x, y, angle, scale)
        if outlines:
            graphics = renderer.new_gc()
            graphics.set_linewidth(0.0)
            path = Path.make_compound_path(*outlines)
            renderer.draw_path(graphics, path, IdentityTransform(), (0.0, 0.0, 0.0, 1.0))
            graphics.restore()

    def _foot(
        self, renderer: RendererBase, place: str, cell: float, text: str, scale: float
    ) -> tuple[float, float, float]:
        """Return where a label begins, in pixels from below, and its angle."""
        box = self._around.bbox
        pad = _pixels(renderer, PAD)
        across, up = self._around.transData.transform((cell, cell))
        length = scale * sum(_letter(c)[1] for c in text)
        if place == "above":
            return across - 0.5 * length, box.y1 + pad, 0.0
        if place == "rising":
            return across + MIDDLE * scale, box.y1 + pad, 90.0
        left = box.x0 - pad - length if place == "before" else box.x1 + pad
        return left, up - MIDDLE * scale, 0.0


def _pixels(renderer: RendererBase, points: float) -> float:
    pixels: Any = renderer.points_to_pixels(points)  # typed as whatever arrays are made of
    return float(pixels)


@cache
def _letter(letter: str) -> tuple[FloatArray, float, Any]:
    """Return the outline of a letter, its advance, both over the size of the font, and the outline's codes."""
    font = get_font(findfont(FONT))
    font.set_size(100.0, 72)
    glyph = font.load_char(ord(letter), flags=LoadFlags.NO_HINTING)
    vertices, codes = font.get_path()
    return np.asarray(vertices) / 100.0, float(glyph.linearHoriAdvance) / 6_553_600.0, codes


def _placed(text: str, x: float, y: float, angle: float, scale: float) -> list[Path]:
    found, at = [], 0.0
    for letter in text:
        vertices, advance, codes = _letter(letter)
        if len(vertices):
            along, up = scale * (vertices[:, 0] + at), scale * vertices[:, 1]
            turned = (along, up) if angle == 0.0 else (-up, along)
            found.append(Path(np.column_stack([x + turned[0], y + turned[1]]), codes))
        at += advance
    return found
