"""The report: a result as plain data, and renderers that turn the data into a page, figures and console tables.

data          what a report holds, and what report.json may say
assemble      from a result to the data, by way of recorded, searches, at_work, reproduce, units and downsample
figures/      from the data to figures, drawn in processes of their own beside the identification
page, console from the data to HTML and to tables
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

_HOMES = {
    "assemble": ("read_report", "summary", "to_json_text"),
    "page": ("to_html",),
    "figures.notebook": (
        "plot_accuracy",
        "plot_candidates",
        "plot_correlation",
        "plot_derivatives",
        "plot_free_run",
        "plot_path",
        "plot_signals",
        "plot_spectra",
        "plot_targets",
    ),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME)

if TYPE_CHECKING:
    from odescope.report.assemble import read_report as read_report
    from odescope.report.assemble import summary as summary
    from odescope.report.assemble import to_json_text as to_json_text
    from odescope.report.figures.notebook import plot_accuracy as plot_accuracy
    from odescope.report.figures.notebook import plot_candidates as plot_candidates
    from odescope.report.figures.notebook import plot_correlation as plot_correlation
    from odescope.report.figures.notebook import plot_derivatives as plot_derivatives
    from odescope.report.figures.notebook import plot_free_run as plot_free_run
    from odescope.report.figures.notebook import plot_path as plot_path
    from odescope.report.figures.notebook import plot_signals as plot_signals
    from odescope.report.figures.notebook import plot_spectra as plot_spectra
    from odescope.report.figures.notebook import plot_targets as plot_targets
    from odescope.report.page import to_html as to_html


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'odescope.report' has no attribute {name!r}")
    found: object = getattr(import_module(f"odescope.report.{_HOME[name]}"), name)
    return found
