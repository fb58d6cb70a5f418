"""What a notebook shows of a model, and in plain words how far to trust it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from odescope.library.mathml import math
from odescope.model.explicit import explicit
from odescope.model.model import Model
from odescope.model.notes import trust


def model_html(model: Model, notes: Sequence[str] = ()) -> str:
    """Return the equations in MathML with what is known of their worth; all text is escaped."""
    equations = "".join(f"<p>{math(q.mathml)}</p>" for q in explicit(model))
    said = "".join(f"<li>{escape(line)}</li>" for line in (*trust(model.scores), *notes))
    return f"<div>{equations}{f'<ul>{said}</ul>' if said else ''}</div>"


def model_latex(model: Model) -> str:
    """Return the equations as displayed LaTeX, one a line."""
    return "$$\\begin{gathered}\n" + " \\\\\n".join(q.latex for q in explicit(model)) + "\n\\end{gathered}$$"
