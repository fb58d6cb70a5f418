"""The languages of `export.languages` by the names under which odescope offers them to scripts."""

from odescope.export.languages.latex import write as to_latex
from odescope.export.languages.mathml import write as to_mathml
from odescope.export.languages.python import write as to_python
from odescope.export.languages.text import write as to_text

__all__ = ["to_latex", "to_mathml", "to_python", "to_text"]
