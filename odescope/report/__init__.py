"""The report: a result as plain data, and renderers that turn the data into a page, figures and console tables.

data          what a report holds, and what report.json may say
assemble      from a result to the data, by way of recorded, searches, at_work, reproduce, units and downsample
figures/      from the data to figures, drawn in processes of their own beside the identification
page, console from the data to HTML and to tables
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    "assemble": ("read_report", "summary", "to_json_text"),
    "page": ("to_html",),
    "figures.plots": (
        "plot_accuracy",
        "plot_candidates",
        "plot_correlation",
        "plot_derivatives",
        "plot_free_run",
        "plot_signals",
        "plot_spectra",
        "plot_targets",
    ),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'odescope.report' has no attribute {name!r}")
    return getattr(import_module(f"odescope.report.{_HOME[name]}"), name)
