"""The figures for a notebook: each takes a result and returns a matplotlib figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odescope.errors import InputError, check_kind, nearest
from odescope.pipeline.identification import Identification
from odescope.report.at_work import targets_chart
from odescope.report.data import Searched
from odescope.report.figures.draw_grids import draw_accuracy, draw_candidates, draw_correlation
from odescope.report.figures.draw_lines import draw_chart, draw_spectra
from odescope.report.figures.draw_path import draw_path
from odescope.report.figures.draw_thumbnails import draw_thumbnails
from odescope.report.free_runs import runs_over, thumbnails
from odescope.report.recorded import Truth, derivatives_chart, signals_chart, spectra
from odescope.report.searches import searched

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_signals(result: Identification) -> Figure:
    """Return the channels as recorded and as filtered, and the inputs (the paper's Fig. 2)."""
    check_kind(result, Identification, "what is drawn")
    return draw_chart(signals_chart(result))


def plot_spectra(result: Identification) -> Figure:
    """Return the periodograms with noise floor, noise ceiling, the chosen cutoff and the paper's (Fig. 1)."""
    check_kind(result, Identification, "what is drawn")
    return draw_spectra(spectra(result))


def plot_derivatives(result: Identification, truth: Truth | None = None) -> Figure:
    """Return the estimated derivatives, beside the true ones where they are given (Fig. 3).

    Args:
        result: of a record of one run, where the truth is given.
        truth: true derivatives by name, one value a sample of the record.
    """
    check_kind(result, Identification, "what is drawn")
    return draw_chart(derivatives_chart(result, truth))


def plot_correlation(result: Identification, target: str | None = None) -> Figure:
    """Return the correlations between the candidate terms of a target, by default the first (Fig. 4)."""
    check_kind(result, Identification, "what is drawn")
    return draw_correlation(_of(result, target))


def plot_candidates(result: Identification, target: str | None = None) -> Figure:
    """Return the candidate relations of a target, by default the first, as a grid of signs (Fig. 5)."""
    check_kind(result, Identification, "what is drawn")
    return draw_candidates(_of(result, target))


def plot_accuracy(result: Identification) -> Figure:
    """Return the held-out error of every candidate over its number of terms, the chosen ones marked."""
    check_kind(result, Identification, "what is drawn")
    return draw_accuracy(searched(result))


def plot_path(result: Identification) -> Figure:
    """Return the held-out free-run error of every model on the path over its number of terms, the chosen one marked."""
    check_kind(result, Identification, "what is drawn")
    scores = result.model.scores
    if scores is None or not scores.path:
        raise InputError("the result has no path of models: the likelihood stage makes one of a model that it follows")
    return draw_path(scores.path)


def plot_targets(result: Identification, truth: Truth | None = None) -> Figure:
    """Return the predicted beside the estimated targets over all the data (Fig. 6)."""
    check_kind(result, Identification, "what is drawn")
    return draw_chart(targets_chart(result, truth)[0])


def plot_free_run(result: Identification) -> Figure:
    """Return the free runs of the model from the start of every recording, beside what was measured (Fig. 7)."""
    check_kind(result, Identification, "what is drawn")
    return draw_thumbnails(thumbnails(result, runs_over(result)))


def _of(result: Identification, target: str | None) -> Searched:
    found = {s.target: s for s in searched(result)}
    if target is None:
        return next(iter(found.values()))
    if target not in found:
        raise InputError(f"the result has no target {target!r}; {nearest(target, found)}")
    return found[target]
