"""A model as MathML, which browsers typeset without scripts; how its terms are written stands in library/mathml.py."""

from __future__ import annotations

from odescope.library.mathml import math
from odescope.model.display import quotient_mathml
from odescope.model.model import Model


def to_mathml(model: Model) -> str:
    """Return the explicit equations as MathML, one a line, to six significant digits."""
    return "\n".join(math(quotient_mathml(q)) for q in model.quotients)


write = to_mathml
