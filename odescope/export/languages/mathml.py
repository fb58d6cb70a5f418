"""A model as MathML, which browsers typeset without scripts; how its terms are written stands in library/mathml.py."""

from __future__ import annotations

from odescope.errors import check_kind
from odescope.library.mathml import math
from odescope.model.display import equation_mathml, parameters_mathml
from odescope.model.mechanism_display import mechanisms_mathml
from odescope.model.model import Model


def to_mathml(model: Model) -> str:
    """Return mechanisms, where there are any, and the equations as MathML, one a line.

    Coefficients of equations have six significant digits, those of mechanisms as many as their standard errors allow.
    """
    check_kind(model, Model, "what is written")
    formulas = [
        *mechanisms_mathml(model.shown_mechanisms, model.names),
        *map(equation_mathml, model.equations),
        *parameters_mathml(model.parameters),
    ]
    return "\n".join(math(formula) for formula in formulas)


write = to_mathml
