"""Console tables from the same plain data as the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from odescope.model.model import Model
from odescope.model.notes import share
from odescope.model.scores import PathScore
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
    return _equations_text(report, model) + held_out + "".join(_free_runs(report.at_work.runs))


def _free_runs(runs: Sequence[RunShown]) -> Iterator[str]:
    for run in runs[:LISTED]:
        which = "free run" if len(runs) == 1 else f"free run of recording {run.recording}"
        ended = f"; {run.ended}" if run.ended else ""
        yield f"{which}: {run.valid_time:.4g} of {run.duration:.4g} s with the record{ended}\n"
    if len(runs) > LISTED:
        stay = sum(run.valid_time >= run.duration for run in runs)
        yield f"free runs of all {len(runs)} recordings tried: {stay} stay with their record to its end\n"


def _equations_text(report: Report, model: Model) -> str:
    """Return a row an equation; of mechanisms without what is known only of relations that were searched for."""
    from rich.table import Table

    table = Table(title_justify="left", box=None, pad_edge=False)
    headings = ("target", "terms") if model.mechanisms else ("target", "terms", "chosen among", "R² held out")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "target" else "right")
    if model.mechanisms:
        for target, relation in zip(model.targets, model.relations, strict=True):
            table.add_row(target, str(len(relation.terms)))
        return _shown(table)
    for searched, coefficients in zip(report.searches, report.coefficients, strict=False):
        score = None if model.scores is None else model.scores.targets.get(searched.target)
        held_out = "–" if score is None or score.r2_held_out is None else share(score.r2_held_out)
        table.add_row(searched.target, str(len(coefficients)), str(searched.kept), held_out)
    return _shown(table) if table.rows else ""


def _held_out(step: PathScore) -> str:
    apart = f" ± {step.spread:.2g}" if step.spread else ""
    return "" if step.error is None else f"free-run error, held out: {step.error:.2g}{apart} standard deviations\n"


def _shown(table: object) -> str:
    from rich.console import Console

    console = Console()
    with console.capture() as shown:
        console.print(table)
    return shown.get()
