"""A model as LaTeX; how its terms are written stands in library/latex.py."""

from __future__ import annotations

from odescope.model.display import quotient_latex
from odescope.model.model import Model


def to_latex(model: Model) -> str:
    """Return the explicit equations as LaTeX, one a line, to six significant digits."""
    return " \\\\\n".join(quotient_latex(q) for q in model.quotients)


write = to_latex
