"""Every figure of the report: where it belongs, what it is called, what to look for in it, how it is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from odescope.model.scores import PathScore
from odescope.report.data import Chart, Observed, Periodogram, Report, Searched, Thumbnails

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Kind = Literal["chart", "thumbnails", "spectra", "correlation", "candidates", "accuracy", "path"]
Drawable = Chart | Thumbnails | Searched | tuple[Periodogram, ...] | tuple[Searched, ...] | tuple[PathScore, ...]
_TYPES: dict[Kind, Any] = {
    "chart": Chart,
    "thumbnails": Thumbnails,
    "spectra": tuple[Periodogram, ...],
    "correlation": Searched,
    "candidates": Searched,
    "accuracy": tuple[Searched, ...],
    "path": tuple[PathScore, ...],
}


@dataclass(frozen=True)
class Picture:
    """A figure: its file's name, the section it stands in, its alternative text, its caption, and what is drawn."""

    name: str
    section: str
    alternative: str
    caption: str
    kind: Kind
    data: Drawable

    @property
    def job(self) -> bytes:
        """All that drawing takes: equal jobs give equal figures."""
        return msgspec.msgpack.encode((self.name, self.kind, msgspec.msgpack.encode(self.data)))


def draw(kind: Kind, data: Drawable) -> Figure:
    """Return the figure of a kind for its data."""
    from odescope.report.figures import draw_grids, draw_lines
    from odescope.report.figures.draw_path import draw_path
    from odescope.report.figures.draw_thumbnails import draw_thumbnails

    how: dict[Kind, Any] = {
        "chart": draw_lines.draw_chart,
        "thumbnails": draw_thumbnails,
        "spectra": draw_lines.draw_spectra,
        "correlation": draw_grids.draw_correlation,
        "candidates": draw_grids.draw_candidates,
        "accuracy": draw_grids.draw_accuracy,
        "path": draw_path,
    }
    figure: Figure = how[kind](data)
    return figure


def draw_job(job: bytes) -> tuple[str, bytes]:
    """Return the SVG and the PNG of a picture's job."""
    from odescope.report.figures.style import saved

    name, kind, data = msgspec.msgpack.decode(job, type=tuple[str, Kind, bytes])
    return saved(draw(kind, msgspec.msgpack.decode(data, type=_TYPES[kind])), name)


def pictures(report: Report) -> tuple[Picture, ...]:
    """Return the figures of a report in the order of its page; nothing is drawn yet."""
    from odescope.report.assemble import model_of

    model = model_of(report)
    scores = model.scores
    path = () if scores is None or len(scores.path) < 2 else (_path(scores.path),)
    early = early_pictures(report.observed, report.searches, other_form=bool(model.mechanisms))
    return (_free_runs(report), *early, *path, _targets(report))


def early_pictures(
    observed: Observed, searches: tuple[Searched, ...], *, other_form: bool = False
) -> tuple[Picture, ...]:
    """Return the figures that do not show the model at work.

    Args:
        observed: the record.
        searches: for relations, if any.
        other_form: whether the model is of another form than what was searched for.
    """
    return (
        _signals(observed),
        _spectra(observed),
        _derivatives(observed),
        *(_correlation(k, s) for k, s in enumerate(searches, start=1)),
        *(_candidates(k, s, other_form) for k, s in enumerate(searches, start=1)),
        *((_accuracy(searches),) if searches else ()),
    )


def _signals(observed: Observed) -> Picture:
    names = ", ".join(c.name for c in observed.recorded.coordinates)
    drivers = ", ".join(d.name for d in observed.recorded.inputs)
    gated = any(line.role == "gated" for panel in observed.recorded.chart.panels for line in panel.wide)
    return Picture(
        "signals",
        "data",
        f"Line plots over time of {names} as recorded and filtered"
        + (f", and of the input {drivers}" if drivers else "")
        + ", and of what the filter removed",
        "Left: what was recorded (broad, grey) and what the filter kept (narrow, blue)"
        + (", and the samples that do not count (crosses; at the edge, where they are far off)" if gated else "")
        + ". Right, on its own scale:"
        " what the"
        " filter removed. It should be shapeless noise of even breadth; bursts where the motion turns sharply mean that"
        " the cutoff is too low." + _left_out(observed.recorded.chart),
        "chart",
        observed.recorded.chart,
    )


def _spectra(observed: Observed) -> Picture:
    return Picture(
        "spectra",
        "cutoff",
        "Periodogram of each channel over frequency, both logarithmic, with noise floor, noise ceiling and two cutoffs;"
        " the numbers stand in the table",
        "Power of each channel over frequency. To the left is the motion, to the right the flat noise; everything"
        " to the"
        " right of the chosen cutoff was thrown away. A good cutoff stands near where the power sinks into the"
        " noise floor;"
        " peaks far to its right are motion that was lost, or a disturbance.",
        "spectra",
        observed.spectra,
    )


def _derivatives(observed: Observed) -> Picture:
    true = any(line.role == "truth" for panel in observed.derivatives.panels for line in panel.wide)
    return Picture(
        "derivatives",
        "cutoff",
        "Line plots over time of the estimated derivatives" + (" beside the true ones" if true else ""),
        "Derivatives estimated from the filtered record"
        + (
            " (blue) and the true ones of the simulation (black, dotted). Where the two part, usually at the sharpest"
            " peaks, the regression has been told something false."
            if true
            else ". They should look like a motion, not like noise: steady ripples at the cutoff frequency are noise"
            " that the filter let through."
        )
        + _left_out(observed.derivatives),
        "chart",
        observed.derivatives,
    )


def _correlation(number: int, searched: Searched) -> Picture:
    more = searched.correlations.left_out
    return Picture(
        f"correlation-{number}",
        "correlations",
        f"Matrix of the correlations between {len(searched.correlations.terms)} candidate terms for {searched.target}",
        f"Correlation between the candidate terms for {searched.target} (about zero, as the regression sees them). Pale"
        " is good: two terms that are dark where their row and column meet say nearly the same on these data, and the"
        " data can hardly tell which of them is real."
        + (f" The {more} terms that are least alike found no room here." if more else ""),
        "correlation",
        searched,
    )


def _candidates(number: int, searched: Searched, other_form: bool) -> Picture:
    changed = "" if searched.adopted else " The model above is none of these: it has a term that this library lacks."
    if other_form and not searched.adopted:
        changed = " The model above is none of these: another form was preferred to relations."
    return Picture(
        f"candidates-{number}",
        "candidates",
        f"Grid of signs: {len(searched.rows)} candidate relations for {searched.target} by {len(searched.columns)}"
        f" terms",
        f"The best candidate relations for {searched.target}, one a row: the term that served as guess, the error of"
        f" the"
        f" predicted {searched.target} on held-out data, and the sign of every coefficient (orange + positive, blue −"
        f" negative, the target's own being positive). Lines part families that predict alike. Trust a model whose"
        " neighbours hold the same columns with the same signs; doubt one whose error the next rows share with other"
        f" terms.{changed}",
        "candidates",
        searched,
    )


def _accuracy(searches: tuple[Searched, ...]) -> Picture:
    return Picture(
        "accuracy",
        "candidates",
        "Held-out error of every candidate over its number of terms, the chosen one marked",
        "Error on held-out data over the number of terms, each circle a candidate. The chosen one (diamond) should"
        " stand"
        " at the foot of the cliff: left of it the error is much larger, right of it more terms gain next to nothing.",
        "accuracy",
        searches,
    )


def _path(path: tuple[PathScore, ...]) -> Picture:
    return Picture(
        "path-of-models",
        "path",
        f"Held-out free-run error of {len(path)} models over their number of terms, with error bars, the chosen one"
        " marked; the numbers stand in the table",
        "Error of free runs over what was held out, in standard deviations of what was measured, over the number of"
        " terms: each circle is a model, fitted without what is held out, that lacks what the one to its right needed"
        " least. The bars say how far the error differs from stretch to stretch. Left of the chosen one (diamond) the"
        " error should rise, right of it more terms should gain next to nothing; where it falls on to the right end,"
        " something is still missing from the library. Free runs of a chaotic system part from the record whatever the"
        " model: there all errors are large and tell little.",
        "path",
        path,
    )


def _targets(report: Report) -> Picture:
    work = report.at_work
    honest = (
        " The dash-dotted line has not seen what it predicts: the same terms, every part of the data by coefficients"
        " that were regressed on the other parts. The dashed line is the model as reported, which has seen it all; the"
        " terms were chosen with all of it in both."
        if work.held_out
        else " Nothing here is held out: the model has seen all of it."
    )
    return Picture(
        "targets",
        "work",
        "Line plots over time of the predicted beside the estimated targets, with a close-up",
        "The targets as estimated from the record and as the model predicts them from the states and inputs at the same"
        f" instant; close up where they are largest.{honest} Look for peaks that the prediction misses in one direction"
        f" only.{_left_out(work.targets)}",
        "chart",
        work.targets,
    )


def _free_runs(report: Report) -> Picture:
    work = report.at_work
    several = len(work.runs) > 1
    whole = sum(run.valid_time >= run.duration for run in work.runs)
    parted = whole < len(work.runs)
    driven = bool(report.observed.recorded.inputs)
    return Picture(
        "free-run",
        "answer",
        "Line plots over time of every coordinate: free runs of the model beside what was measured, in"
        f" {len(work.free_runs.runs)} recording{'s' if several else ''}; {whole} of {len(work.runs)} free runs stay"
        " with their recording to its end, the numbers stand in a table below",
        f"The model left to itself: {'each run' if several else 'the run'} starts where the recording does, from a"
        f" state fitted to its first stretch, and sees nothing{' but the input' if driven else ''} after that. The"
        " coefficients were fitted to these recordings."
        + (" Above each is its number, and how long the model stays with it." if several else "")
        + (
            " A free run has parted (vertical line) where its error passes 30 % of the spread of what was measured. A"
            " chaotic system must part from its record some time, however good the model: look how long it stays, and"
            " whether it moves alike afterwards."
            if parted
            else ""
        )
        + (
            f" {work.free_runs.left_out} more recordings, which the model stays with no shorter, found no room here."
            if work.free_runs.left_out
            else ""
        ),
        "thumbnails",
        work.free_runs,
    )


def _left_out(chart: Chart) -> str:
    return f" {chart.left_out} more found no room here." if chart.left_out else ""
