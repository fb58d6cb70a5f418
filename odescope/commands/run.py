"""One run of a study, from its options to the files of its results: what the command line, the demo and others call."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from odescope.arrays import FloatArray
from odescope.commands.files import (
    WRITTEN,
    check_writable,
    refuse_foreign,
    refuse_overwriting,
    result_files,
    write_results,
)
from odescope.errors import InputError, Stopped
from odescope.events import Event, FilesWritten, Monitor, Note, Progress, StageBegan
from odescope.files import write_files
from odescope.likelihood.kernel import integrate
from odescope.model.model import Model
from odescope.parallel.kernels import compiled
from odescope.pipeline.identification import DraftReady, Identification, NothingFound, identify
from odescope.report.assemble import observed, read_report, summary
from odescope.report.data import Observed, Report, TableRow
from odescope.report.figures.catalogue import early_pictures, pictures
from odescope.report.figures.processes import Painters, painters
from odescope.report.no_model import no_model_html
from odescope.report.page import report_files
from odescope.report.place import reads_results
from odescope.report.result_names import FACTORS, FIGURES, NO_MODEL, PATH_TABLE, REPORT, REPORT_PAGE, RESULT_FILES
from odescope.report.searches import searched
from odescope.study.options import Study
from odescope.study.toml import moved, study_toml


@dataclass(frozen=True)
class Reference:
    """What a log is known to hold, where it was simulated.

    Attributes:
        signals: makes the true states and targets by name, (N,) each, one value a sample.
        table: makes the rows that set a model beside the truth.
    """

    signals: Callable[[], Mapping[str, FloatArray]] = dict
    table: Callable[[Model], Sequence[TableRow]] = lambda _: ()


UNKNOWN = Reference()
SILENT = Monitor()


@dataclass(frozen=True, eq=False)
class RunResult:
    """What a run came to: the result, its report, and the folder that holds the files."""

    result: Identification
    report: Report
    folder: Path


def run_study(
    study: Study,
    folder: Path,
    out: Path,
    *,
    title: str = "Identification",
    source: Path | None = None,
    reference: Reference = UNKNOWN,
    monitor: Monitor = SILENT,
    cluster: str | None = None,
) -> RunResult:
    """Identify a study, draw its report, and write the files of both to a folder.

    It tells the events of `identify`, then `FilesWritten`; files appear all at once. Where the run ends without a
    model, a page says what was found until then; the results of earlier runs stay as they are.

    Args:
        study: the options, with the files to read.
        folder: that the study's files are relative to.
        out: folder for the results, made where it is not there.
        title: heading of the report.
        source: the file that the study was read from, or that options were given for: it is not overwritten.
        reference: for a simulated log, the truth.
        monitor: whom to tell, and whom to ask whether to stop.
        cluster: see `identify`.

    Raises:
        InputError: the data or the study are wrong, the folder cannot be written, or a result would take the place of
            a file that it is made from.
        NoModelError: the data support no model.
        Stopped: the monitor said so, or an interrupt came; the message says what is kept.
    """
    check_writable(out)
    resolved = moved(study, folder, out)
    _refuse_own_sources(study, resolved, folder, out, source)
    refuse_foreign(out, WRITTEN)
    if study.likelihood.enabled and not compiled(integrate):
        monitor.tell(Note("compiling the kernels, once: this takes about a minute"))
    with painters() as painter:
        watch = _Watch(title, out, reference, painter, monitor)
        try:
            placed = _placed(study, folder)
            result = identify(placed, watch=watch.tell, stop=monitor.stop, cluster=cluster, store=out / FACTORS)
            monitor.tell(StageBegan("report"))
            report = summary(
                result, title, dict(reference.signals()), reference.table(result.model), watch.seen_in(result)
            )
            files = report_files(report, painter.paint(pictures(report)))
            monitor.check()
            written = result_files(result, moved(result.study, Path(), out), files)
            write_results(out, written)
        except (KeyboardInterrupt, Stopped):
            raise Stopped(_stopped(watch.progress, out)) from None
    monitor.tell(FilesWritten(out, _names(written)))
    return RunResult(result, report, out)


def _names(written: Iterable[str]) -> tuple[str, ...]:
    """Return the names of files, those in a folder as one."""
    return tuple(dict.fromkeys(name.partition("/")[0] + "/" * ("/" in name) for name in written))


@dataclass
class _Watch:
    """Passes on what a run tells, draws what the likelihood does not change while that runs, and keeps what it needs.

    Attributes:
        title: heading of the report.
        out: folder for the results.
        reference: for a simulated log, the truth.
        painter: draws figures.
        monitor: whom to tell.
        progress: what was told of it.
        drafts: that were told, and what the report says of the record of each.
    """

    title: str
    out: Path
    reference: Reference
    painter: Painters
    monitor: Monitor
    progress: list[Progress] = field(default_factory=list)
    drafts: list[tuple[Identification, Observed]] = field(default_factory=list)

    def tell(self, event: Event) -> None:
        """Hear an event of the run."""
        if isinstance(event, DraftReady):
            known = observed(event.result, dict(self.reference.signals()))
            self.drafts.append((event.result, known))
            self.painter.begin(early_pictures(known, searched(event.result)))
        elif isinstance(event, Progress):
            self.progress.append(event)
        self.monitor.tell(event)
        if isinstance(event, NothingFound):
            write_files(self.out, {NO_MODEL: no_model_html(event, self.title, self.painter.paint)})
            self.monitor.tell(FilesWritten(self.out, (NO_MODEL,)))

    def seen_in(self, result: Identification) -> Observed | None:
        """Return what was said early of the record that a result is of; None where that was another, or none.

        Versions of inputs and forcings compete, so that the last draft may be of a study that lost.
        """
        for draft, known in self.drafts:
            same = draft.signals is result.signals and draft.searched == result.searched and draft.study == result.study
            if same:
                return known
        return None


def results_at(given: Path) -> Path:
    """Return the folder of results that a path stands for: itself, or that of one of its files.

    Raises:
        InputError: it is another file.
    """
    if not given.is_file():
        return given
    if given.name not in (*RESULT_FILES, PATH_TABLE):
        raise InputError(
            f"{given} is no folder of results: expected one that odescope identify or odescope demo wrote, or the"
            f" {REPORT} in it"
        )
    return given.parent


def draw_again(folder: Path, out: Path, monitor: Monitor = SILENT) -> None:
    """Draw report.html and its figures again from the report.json of a folder.

    Args:
        folder: results of an earlier run.
        out: folder for report.html and the figures.
        monitor: whom to tell, and whom to ask whether to stop.

    Raises:
        InputError: there is no report to draw, or the folder cannot be written.
    """
    stored = read_report(folder / REPORT)
    check_writable(out)
    refuse_foreign(out, WRITTEN)
    monitor.tell(StageBegan("report"))
    with painters() as painter:
        files = report_files(stored, painter.paint(pictures(stored)))
    monitor.check()
    write_files(out, {name: content for name, content in files.items() if name != REPORT})
    monitor.tell(FilesWritten(out, (REPORT_PAGE, f"{FIGURES}/")))


def _placed(study: Study, folder: Path) -> Study:
    """Return the study with its files relative to the working directory."""
    files = tuple(str(folder / f) for f in study.data.files)
    return msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, files=files))


def _refuse_own_sources(study: Study, resolved: Study, folder: Path, out: Path, source: Path | None) -> None:
    """Refuse to overwrite what the results are made from, or to write where the next run would read them as data.

    A study that is its own resolved form may be overwritten.
    """
    if reads_results(study.data.files, folder, out):
        raise InputError(
            f"the data come from {out}: the next run would read results there as data; name another folder with --out"
        )
    read = [folder / f for f in study.data.files]
    if source is not None:
        own = source.suffix.lower() == ".toml" and source.read_text(encoding="utf-8") == study_toml(resolved)
        read += [] if own else [source]
    refuse_overwriting([out / name for name in RESULT_FILES], read)


def _stopped(progress: Sequence[Progress], out: Path) -> str:
    """Say what is kept of a run that was stopped."""
    said = "stopped before any result was written"
    last = next((p for p in reversed(progress) if p.stage == "recordings"), None)
    if last is None or not (out / FACTORS).is_dir():
        return f"{said}; with --seconds 60 a run ends by itself with the best model that it has by then"
    return f"{said}; {last.done} of {last.total} {last.part}s are kept: the same command goes on from there"
