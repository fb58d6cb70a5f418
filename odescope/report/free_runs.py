"""Free runs from the start of every recording as plain data: thumbnails, and how long each stays."""

from __future__ import annotations

from odescope.model.scores import FreeRun
from odescope.pipeline.evaluation import free_run_scores
from odescope.pipeline.identification import Identification
from odescope.recordings.coordinate import Coordinate
from odescope.report.data import Panel, RunShown, Stays, Thumbnail, Thumbnails, side_by_side
from odescope.report.downsample import line_of
from odescope.report.recorded import MOST_PANELS, WHOLE, labels, near
from odescope.validation.free_runs import FreeRunOf, beside, free_runs

MOST_ROWS = 20  # of panels
WORDY = 6  # recordings: of more, thumbnails are too narrow for many words


def runs_over(result: Identification) -> tuple[FreeRunOf, ...]:
    """Return the free runs of a result; a draft's are made here."""
    return result.free_runs or free_runs(result.model, result.records)


def scores_of(result: Identification, runs: tuple[FreeRunOf, ...]) -> tuple[FreeRun, ...]:
    """Return how free runs of a result went."""
    known = () if result.model.scores is None else result.model.scores.free_runs
    over = result.records if result.cleaned is None else result.cleaned
    return known or free_run_scores(result.model, runs, over, result.signals)


def runs_shown(result: Identification, runs: tuple[FreeRunOf, ...]) -> tuple[RunShown, ...]:
    """Return how long free runs stay with their recordings, as the table of the page has it."""
    units = {c.name: c.unit or ("rad" if c.angle else "") for c in result.model.coordinates}
    return tuple(
        RunShown(
            recording=score.recording,
            source=of.record.source or "",
            duration=score.duration,
            recorded=score.recorded or score.duration,
            valid_time=score.valid_time,
            ended=score.ended or "",
            coordinates=tuple(
                Stays(coordinate=name, unit=units[name], valid_time=c.valid_time, fit=c.fit, rmse=c.rmse)
                for name, c in score.coordinates.items()
            ),
        )
        for of, score in zip(runs, scores_of(result, runs), strict=True)
    )


def thumbnails(result: Identification, runs: tuple[FreeRunOf, ...]) -> Thumbnails:
    """Return as many free runs as there is room for, those that part from their recording soonest among them."""
    scores, coordinates = scores_of(result, runs), result.model.coordinates[:MOST_PANELS]
    most = max(6 * (MOST_ROWS // max(len(coordinates), 1)), 6)
    soonest = sorted(range(len(runs)), key=lambda k: scores[k].valid_time / max(scores[k].duration, 1e-300))
    shown = sorted(soonest[:most])
    label, pixels = labels(result), WHOLE // side_by_side(len(shown))
    found = []
    for of, score in ((runs[k], scores[k]) for k in shown):
        panels = tuple(_panel(of, c, label[c.name], pixels) for c in coordinates)
        mark = None if score.stays else score.valid_time
        found.append(Thumbnail(title=_title(score, len(runs)), panels=panels, mark=mark))
    return Thumbnails(runs=tuple(found), left_out=len(runs) - len(shown))


def _title(score: FreeRun, runs: int) -> str:
    """Return how a run went in the few words that there is room for above a thumbnail."""
    if runs > WORDY:
        return f"{score.recording}: " + ("whole" if score.stays else f"{score.valid_time:.2g} s")
    if score.stays:
        went = "stays to the end" if score.recorded is None else f"stays for all {score.duration:.4g} s tried"
    else:
        went = f"parts after {score.valid_time:.2g} s" if not score.ended else f"ended after {score.valid_time:.2g} s"
    return went if runs == 1 else f"recording {score.recording}: {went}"


def _panel(of: FreeRunOf, c: Coordinate, label: str, pixels: int) -> Panel:
    there = of.record.counted(c.name) > 0.0
    t, measured = (of.record.t - of.record.t[0])[there], of.record.column(c.name)[there]
    if not len(measured):
        return Panel(label=label, wide=())
    (_, predicted), _ = beside(c, of, 0.0)
    followed = near([t[: len(predicted)]], [predicted], [measured])
    return Panel(
        label=label,
        wide=(
            line_of("measured", "recorded", [t], [measured], pixels),
            line_of("free run", "model", *followed, pixels),
        ),
    )
