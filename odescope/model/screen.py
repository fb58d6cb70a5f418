"""What a model or a result shows of itself at a prompt: no more than a screen."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

WIDTH = 120
EQUATION_LINES, SENTENCE_LINES = 26, 12  # and a blank line between, and where more is


def screen(equations: Sequence[str], sentences: Sequence[str], more: str) -> str:
    """Return equations and sentences, wrapped, and cut where they would pass a screen.

    Args:
        equations: lines of text.
        sentences: about them.
        more: where the rest is to be had.
    """
    parts = [_cut(equations, EQUATION_LINES), _cut(sentences, SENTENCE_LINES)]
    shown = "\n\n".join("\n".join(part) for part in parts if part)
    return f"{shown}\n(more: {more})" if any(len(part) and part[-1] == "..." for part in parts) else shown


def _cut(texts: Sequence[str], most: int) -> list[str]:
    lines = [line for text in texts for line in textwrap.wrap(text, WIDTH, subsequent_indent="    ") or [""]]
    return lines if len(lines) <= most else [*lines[: most - 1], "..."]
