"""The site: docs/ as it stands, with pages of reference that are made from the package; .ci/site builds it."""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from command_reference import command_reference
from python_reference import as_parameters, python_reference, short_signature
from scores_reference import scores_reference
from sphinx.application import Sphinx
from study_reference import study_reference

import odescope

project = "odescope"
author = "odescope developers"
project_copyright = author
release = version = odescope.__version__
root_doc = "index"
exclude_patterns = ["site", "studies"]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
nitpicky = False

myst_enable_extensions = ["deflist", "attrs_block"]
myst_heading_anchors = 4
smartquotes_action = "D"  # dashes alone: a prime is a derivative
# Notebooks are shown as they are stored, without what they print; "force" runs them.
nb_execution_mode = "off"

default_role = "py:obj"  # docstrings set names in single backticks, as Markdown does
autodoc_typehints = "signature"
autodoc_type_aliases = {name: name for name in ("ArrayLike", "FloatArray", "IntArray", "Table")}
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100
toc_object_entries = False

html_theme = "furo"
html_title = f"odescope {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"footer_icons": []}

MADE = {
    "commands": command_reference,
    "scores": scores_reference,
    "study options": study_reference,
    "Python names": python_reference,
}


def _made(app: Sphinx, name: str, source: list[str]) -> None:
    """Put what is made in the place of its comment, which a forge does not show, and the navigation under the index."""
    source[0] = re.sub(r"^<!-- made: (.*) -->$", lambda m: MADE[m[1]](), source[0], flags=re.MULTILINE)
    if name == root_doc:
        source[0] += _navigation(source[0])


def _navigation(index: str) -> str:
    """Return the navigation of the site: the sections of the index, with the pages that each lists."""
    trees = []
    for heading, section in re.findall(r"^## (.+)\n((?:(?!## ).*\n)*)", index, re.MULTILINE):
        pages = "\n".join(re.findall(r"^- \[.*?\]\((.*?)\)", section, re.MULTILINE))
        trees.append(f"\n```{{toctree}}\n:hidden:\n:caption: {heading}\n\n{pages}\n```\n")
    return "".join(trees)


def setup(app: Sphinx) -> None:
    """Connect what is made to the reading of pages."""
    app.connect("source-read", _made)
    app.connect("autodoc-process-docstring", as_parameters, priority=400)  # before napoleon reads the sections
    app.connect("autodoc-process-signature", short_signature)
