"""A model as LaTeX; how its terms are written stands in library/latex.py."""

from __future__ import annotations

from odescope.model.display import equation_latex, parameters_latex
from odescope.model.mechanism_display import mechanisms_latex
from odescope.model.model import Model


def to_latex(model: Model) -> str:
    """Return mechanisms, where there are any, and the equations as LaTeX, one a line.

    Coefficients of equations have six significant digits, those of mechanisms as many as their standard errors allow.
    What stands above the arrow of a reaction needs amsmath.
    """
    lines = [
        *mechanisms_latex(model.shown_mechanisms, model.names),
        *map(equation_latex, model.equations),
        *parameters_latex(model.parameters),
    ]
    return " \\\\\n".join(lines)


write = to_latex
