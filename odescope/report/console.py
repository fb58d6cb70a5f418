"""Console tables from the same plain data as the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from odescope.model.model import Model
from odescope.model.recorded_time import counted_in, told_unit
from odescope.model.scores import PathScore
from odescope.model.worth import share
from odescope.recordings.headings import TimeUnit
from odescope.report.assemble import model_of
from odescope.report.data import Report, RunShown

LISTED = 6  # recordings


def table_text(report: Report) -> str:
    """Return Table 2 as text: truth, paper, odescope."""
    from rich.table import Table

    table = Table(title="Table 2: truth, paper, odescope (denominators start with 1)", title_justify="left")
    for heading in ("target", "term", "truth", "paper", "odescope"):
        table.add_column(heading, justify="left" if heading in ("target", "term") else "right")
    for row in report.table:
        values = ["missing" if v is None else f"{v:.5g}" for v in (row.truth, row.paper, row.found)]
        table.add_row(row.target, row.term, *values)
    return _shown(table)


def trust_text(report: Report) -> str:
    """Return what held-out data and the free run say of every equation, as text."""
    model = model_of(report)
    held_out = "" if model.scores is None else "".join(_held_out(step) for step in model.scores.path if step.chosen)
    return _equations_text(report, model) + held_out + "".join(_free_runs(report.at_work.runs, told_unit(model)))


def _free_runs(runs: Sequence[RunShown], unit: TimeUnit) -> Iterator[str]:
    for run in runs[:LISTED]:
        which = "free run" if len(runs) == 1 else f"free run of recording {run.recording}"
        ended = f"; {run.ended}" if run.ended else ""
        yield f"{which}: {counted_in(run.valid_time, unit):.4g} of {_tried(run, unit)} with the record{ended}\n"
    if len(runs) > LISTED:
        stay = sum(run.valid_time >= run.duration for run in runs)
        whole = all(run.recorded <= run.duration for run in runs)
        far = "to its end" if whole else "for all that was tried of it"
        yield f"free runs of all {len(runs)} recordings tried: {stay} stay with their record {far}\n"


def _tried(run: RunShown, unit: TimeUnit) -> str:
    """Return for how long a model was run, and of how long a recording where that is but the first part."""
    tried, recorded = (f"{counted_in(t, unit):.4g} {unit}" for t in (run.duration, run.recorded))
    return tried if run.recorded <= run.duration else f"the first {tried}, of {recorded},"


def _equations_text(report: Report, model: Model) -> str:
    """Return a row an equation: its terms beside the target, and what it explains where nothing else tells of it.

    What is held out of a target is noisy: beside a free run over it, it says next to nothing.
    """
    from rich.table import Table

    told = model.scores
    run = model.mechanisms or (told is not None and any(step.chosen for step in told.path))
    scores = {} if told is None or run else told.targets
    searched = {s.target for s in report.searches}
    judged = {t: s.telling_r2 for t, s in scores.items() if s.r2_held_out is not None and t in searched}
    table = Table(title_justify="left", box=None, pad_edge=False)
    for heading in ("target", "terms", *(("R² held out",) if judged else ())):
        table.add_column(heading, justify="left" if heading == "target" else "right")
    for target, relation in zip(model.targets, model.relations, strict=True):
        r2 = judged.get(target)
        share_of = "–" if r2 is None else share(r2)
        table.add_row(target, str(len(relation.terms) - 1), *((share_of,) if judged else ()))
    return _shown(table)


def _held_out(step: PathScore) -> str:
    if step.error is None:
        return ""
    if step.lost:
        return "free-run error, held out: 1, the largest that counts: free runs lose the record\n"
    apart = f" ± {step.spread:.2g}" if step.spread else ""
    return f"free-run error, held out: {step.error:.2g}{apart} standard deviations\n"


def _shown(table: object) -> str:
    from rich.console import Console

    console = Console()
    with console.capture() as shown:
        console.print(table)
    return shown.get()
