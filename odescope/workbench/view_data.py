"""The page of data: what is in a log, as pictures and in words, and a study drafted from a look at it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from nicegui import ui

from odescope.errors import InputError
from odescope.files import write_file
from odescope.report.page import in_bytes
from odescope.study.draft import Drafted
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
from odescope.workbench.log_study import alike, drafted_from, in_order, study_of
from odescope.workbench.long_chart import LongChart, LongLine, LongPlot

MOST_PANELS = 40
PAUSE = 0.2  # seconds without another tick before the logs are looked at


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
        await SeenView(bench, name).show()


def _picture(log: LogFile) -> None:
    """Draw all columns that there is room for."""
    labels = list(log.lines)[:MOST_PANELS]
    plots = [LongPlot(label, (LongLine(label, "estimated", log.lines[label]),)) for label in labels]
    LongChart(plots, log.axis, f"lines over {log.axis}: {', '.join(labels)}", legend=False)
    if len(log.lines) > len(labels):
        text("p", f"{len(log.lines) - len(labels)} more columns found no room.", "about")


class SeenView:
    """What the columns of a log look like, or of several with the same columns, and the study that is offered."""

    def __init__(self, bench: Workbench, name: str) -> None:
        """Begin with one log."""
        self._bench, self._name, self._asked = bench, name, 0
        self._ticks = dict[str, ui.checkbox]()
        self._others = ui.element("div")
        self._said, self._seen = text("p", "").props("role=status"), ui.element("div")

    async def show(self) -> None:
        """Offer the logs that go with this one, and say what it looks like.

        Raises:
            InputError: its columns cannot be read.
        """
        await self._look()
        others = await aside(alike, self._bench.folder, self._name)
        if others:
            with self._others:
                self._offer(others)

    def _offer(self, others: Sequence[str]) -> None:
        """Make a box for every log that has the same columns."""
        one = len(others) == 1
        told_ = f"{len(others)} other {'log' if one else 'logs'} here {'has' if one else 'have'} these columns"
        with ui.element("fieldset").classes("channel ticks"):
            text("legend", f"{told_}: one study of several recordings?")
            for other in others:
                self._ticks[other] = ui.checkbox(other, on_change=self._look).props("dense")
            if not one:
                with ui.element("div").classes("actions"):
                    button("Tick all", lambda: self._tick(True))
                    button("Tick none", lambda: self._tick(False))

    def _tick(self, value: bool) -> None:
        for box in self._ticks.values():
            box.set_value(value)

    def _chosen(self) -> list[str]:
        """Return the logs of the study, in the order in which the folder lists them."""
        return in_order([self._name, *(other for other, box in self._ticks.items() if box.value)])

    async def _look(self) -> None:
        """Look at what is chosen, and say what was seen."""
        self._asked += 1
        mine = self._asked
        self._seen.clear()
        self._said.set_text("looking at the columns …")
        await asyncio.sleep(PAUSE if mine > 1 else 0.0)
        if mine != self._asked:
            return
        folder, names = self._bench.folder, self._chosen()
        try:
            drafted, wrong = await drafted_from([folder.inside(name) for name in names]), ""
        except InputError as error:
            drafted, wrong = None, str(error)
        if mine != self._asked:  # ticked on meanwhile
            return
        self._said.set_text("" if drafted is None else _sampled(names, drafted))
        with self._seen:
            if drafted is None:
                complaint(wrong)
            else:
                self._show(names, drafted)

    def _show(self, names: Sequence[str], drafted: Drafted) -> None:
        """Say what was seen, and offer the study."""
        folder, several = self._bench.folder, len(names) > 1
        table("Columns", ("column", "unit", "may be", "because"), _rows(drafted))

        def begin() -> None:
            target, there = study_of(folder, names)
            if not there:
                write_file(target, drafted.text)
            ui.navigate.to(address("study", folder.name(target)))

        target, there = study_of(folder, names)
        with ui.element("div").classes("actions"):
            if there:
                button("Open their study" if several else "Open its study", told(begin), main=True)
            else:
                button(f"Make a study of {'them' if several else 'it'}", told(begin), main=True)
            if several:
                text("span", folder.name(target), "about")


def _sampled(names: Sequence[str], drafted: Drafted) -> str:
    return f"{len(names)} logs: {drafted.sampled}" if len(names) > 1 else drafted.sampled


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
