"""The page of data: what is in a log, as pictures and in words, and a study drafted from a look at it."""

from __future__ import annotations

import asyncio
from functools import lru_cache
from pathlib import Path

from nicegui import run, ui
from nicegui.run import SubprocessException

from odescope.errors import InputError
from odescope.files import write_file
from odescope.report.page import in_bytes
from odescope.study.draft import Drafted, draft
from odescope.workbench.frame import (
    Listed,
    Workbench,
    address,
    aside,
    button,
    complaint,
    panel,
    show_one,
    table,
    text,
    told,
)
from odescope.workbench.log_file import LogFile, open_log
from odescope.workbench.long_chart import LongChart, LongLine, LongPlot

MOST_PANELS = 40
SMALL = 20_000_000  # bytes of a file that is looked at in no time
DRAFTED: dict[tuple[Path, int, int], Drafted] = {}  # by the file, when it was changed and its size


@lru_cache(maxsize=3)
def _opened(path: Path, *_: int) -> LogFile:
    return open_log(path)


def log_of(path: Path) -> LogFile:
    """Return a log for looking at; one that was looked at and has not changed is at hand.

    Raises:
        InputError: it cannot be read.
    """
    try:
        about = path.stat()
    except OSError as error:
        raise InputError(f"no such file: {path.name}") from error
    return _opened(path, about.st_mtime_ns, about.st_size)


async def data_page(bench: Workbench, name: str) -> None:
    """Make the page of a log."""
    begin = f"Put a CSV, Parquet or MATLAB file into {bench.folder.root}, and reload this page."
    listed = Listed("Logs", bench.folder.logs(), begin, "data")
    await show_one(bench, "data", listed, name, _log)


async def _log(bench: Workbench, name: str) -> None:
    """Show a log: its picture first, which is there sooner than what it looks like.

    Raises:
        InputError: it lies outside of the folder, or cannot be read.
    """
    path = bench.folder.inside(name)
    facts = text("p", "reading …", "about")
    await ui.context.client.connected(timeout=30)
    try:
        log = await aside(log_of, path)
    except InputError:
        facts.delete()
        raise
    facts.set_text(f"{log.rows:,} rows, {len(log.labels)} columns, {in_bytes(path.stat().st_size)}")
    _picture(log)
    with panel("What it looks like", "Each column, and what may be made of it in a study."):
        await _seen(bench, path)


def _picture(log: LogFile) -> None:
    """Draw all columns that there is room for."""
    labels = list(log.lines)[:MOST_PANELS]
    plots = [LongPlot(label, (LongLine(label, "estimated", log.lines[label]),)) for label in labels]
    LongChart(plots, log.axis, f"lines over {log.axis}: {', '.join(labels)}", legend=False)
    if len(log.lines) > len(labels):
        text("p", f"{len(log.lines) - len(labels)} more columns found no room.", "about")


async def _seen(bench: Workbench, path: Path) -> None:
    """Say what the columns look like, and offer the study."""
    waiting = text("p", "looking at the columns …", "about")
    target = path.parent / f"{path.name.removesuffix('.gz').rpartition('.')[0]}.toml"
    try:
        drafted = await _drafted(path)
    except InputError as error:
        waiting.delete()
        complaint(str(error))
        return
    waiting.delete()
    text("p", drafted.sampled)
    table("Columns", ("column", "unit", "may be", "because"), _rows(drafted))
    with ui.element("div").classes("actions"):
        if target.exists():
            button("Open its study", lambda: ui.navigate.to(address("study", bench.folder.name(target))), main=True)
        else:

            def begin() -> None:
                write_file(target, drafted.text)
                ui.navigate.to(address("study", bench.folder.name(target)))

            button("Make a study of it", told(begin), main=True)


async def _drafted(path: Path) -> Drafted:
    """Return the study of a log; one that was drafted from the file as it is now is at hand.

    Raises:
        InputError: there is nothing to identify in it.
        asyncio.CancelledError: the server ends.
    """
    about = path.stat()
    known = (path, about.st_mtime_ns, about.st_size)
    if known not in DRAFTED:
        DRAFTED[known] = await _draft(path)
    return DRAFTED[known]


async def _draft(path: Path) -> Drafted:
    """Draft the study of a log; a long look is taken in another process, since it would hold up the pages of this.

    Raises:
        InputError: there is nothing to identify in it.
        asyncio.CancelledError: the server ends.
    """
    if path.stat().st_size < SMALL:
        return await aside(draft, [path], [path], path.parent)
    try:
        found = await run.cpu_bound(draft, [path], [path], path.parent)
    except SubprocessException as error:
        raise InputError(error.original_message) from error
    if found is None:
        raise asyncio.CancelledError
    return found


def _rows(drafted: Drafted) -> list[tuple[str, str, str, str]]:
    shown = [
        (
            s.heading.label,
            "deg" if s.degrees else s.heading.unit or "",
            {"coordinate": f"a coordinate of order {s.order}", "input": "an input"}.get(s.role, "left out"),
            s.why,
        )
        for s in drafted.seen
    ]
    return [*shown, *((label, "", "left out", why) for label, why in drafted.unused.items())]
