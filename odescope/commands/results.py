"""A result in memory to files: what the identify command writes, from Python."""

from __future__ import annotations

from pathlib import Path

from odescope.commands.files import WRITTEN, check_writable, refuse_foreign, result_files, write_results
from odescope.errors import as_path, check_kind
from odescope.files import write_files
from odescope.pipeline.identification import Identification
from odescope.study.toml import moved


def save_result(result: Identification, folder: Path | str) -> None:
    """Write a result to a folder as the identify command does, but for its report: see `write_report`.

    Those are model.json, candidates.csv, study.toml, and the models on the path from many terms to few.

    Raises:
        InputError: the folder cannot be written, or holds files called like results that are none.
    """
    check_kind(result, Identification, "what is saved")
    folder = as_path(folder, "a folder for results")
    check_writable(folder)
    refuse_foreign(folder, WRITTEN)
    write_results(folder, result_files(result, moved(result.study, Path(), folder), {}))


def write_report(result: Identification, folder: Path | str, title: str = "Identification") -> None:
    """Write report.html, report.json and the figures of a result to a folder.

    Args:
        result: what `identify` returned.
        folder: made where it is not there.
        title: heading of the report.

    Raises:
        InputError: the folder cannot be written, or holds files called like results that are none.
    """
    from odescope.report.assemble import summary
    from odescope.report.figures.catalogue import pictures
    from odescope.report.figures.processes import painters
    from odescope.report.page import report_files

    check_kind(result, Identification, "what is reported")
    folder = as_path(folder, "a folder for a report")
    check_writable(folder)
    refuse_foreign(folder, WRITTEN)
    report = summary(result, title)
    with painters() as painter:
        write_files(folder, report_files(report, painter.paint(pictures(report))))
