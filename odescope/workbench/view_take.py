"""The page of what can be taken away: exports in every language, the study, the report, the figures."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

from nicegui import ui

from odescope.errors import InputError, OdescopeError
from odescope.export.exported import export_names, exported
from odescope.export.model_file import read_model
from odescope.export.program_files import NAME, ProgramFiles
from odescope.files import write_files
from odescope.report.result_names import FIGURES, MODEL, PATH, PATH_MODEL, PATH_TABLE, RESULT_FILES
from odescope.workbench.frame import Workbench, aside, button, complaint, link, panel, show_result, stored, text

EXPORTS = "exports"  # the folder beside the files of a result
LONGEST_SHOWN = 40_000  # characters


async def take_page(bench: Workbench, name: str) -> None:
    """Make the page of what a result can be taken away as."""
    await show_result(bench, "take", name, _result)


def _result(bench: Workbench, name: str) -> None:
    """Show a result as code, and its files.

    Raises:
        InputError: it lies outside of the folder.
    """
    place = bench.folder.inside(name)
    bench.folder.check(place / MODEL)
    ExportView(bench, place)
    _files(bench, place)


class ExportView:
    """A choice of languages, and the model in the one that is chosen."""

    def __init__(self, bench: Workbench, place: Path) -> None:
        """Offer the languages."""
        self._bench, self._place = bench, place
        with panel("The model as code", "What runs the model elsewhere, or shows it to people.", "first"):
            self._to = ui.select(export_names(), value="python", label="language", on_change=self._show)
            self._to.props("dense outlined options-dense").classes("narrow")
            with ui.element("div").classes("actions"):
                self._save = button("Write into the folder", self._write, main=True)
                self._download = button("Download", self._send)
            self._told = ui.element("div").props("role=status")
            self._shown = ui.element("div")
        self._found = ProgramFiles({})
        ui.timer(0.01, self._show, once=True)

    async def _show(self) -> None:
        to = str(self._to.value)
        self._told.clear()
        self._shown.clear()
        try:
            found = await aside(self._exported, to)
        except OdescopeError as error:
            self._enable(False)
            with self._told:
                complaint(str(error))
            return
        if to != self._to.value:
            return
        self._found = found
        self._enable(True)
        with self._told:
            for note in found.notes:
                text("p", note)
        with self._shown:
            for name, content in found.files.items():
                if isinstance(content, str):
                    text("h3", name)
                    text("pre", content[:LONGEST_SHOWN], "formula code").props("tabindex=0")
                else:
                    text("p", f"{name}, {len(content):,} bytes")

    def _exported(self, to: str) -> ProgramFiles:
        """Return the model in a language; called beside the server's thread."""
        return exported(read_model(self._place / MODEL), to, NAME)

    def _enable(self, there: bool) -> None:
        self._save.set_enabled(there)
        self._download.set_enabled(there)

    def _write(self) -> None:
        target = self._place / EXPORTS / str(self._to.value)
        self._told.clear()
        with self._told:
            try:
                self._bench.folder.check(target)
                (self._place / EXPORTS).mkdir(exist_ok=True)
                write_files(target, self._found.files)
            except (InputError, OSError) as error:
                complaint(str(error))
                return
            text("p", f"wrote {self._bench.folder.name(target)}/: {', '.join(self._found.files)}", "good")

    def _send(self) -> None:
        (name, content), *more = self._found.files.items()
        if more:
            packed = io.BytesIO()
            with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
                for file, own in self._found.files.items():
                    archive.writestr(file, own)
            ui.download(packed.getvalue(), f"{self._to.value}.zip")
        else:
            ui.download(content.encode() if isinstance(content, str) else content, name)


def _files(bench: Workbench, place: Path) -> None:
    """List the files of the result."""
    name = bench.folder.name(place)
    with panel("Its files", "As the command line writes them: they lie in the folder already."):
        for file in (*RESULT_FILES, PATH_TABLE):
            if (place / file).is_file():
                with ui.element("p"):
                    link(file, stored(name, file), new_tab=True)
        shorter = sorted((place / PATH).glob(f"*{PATH_MODEL}"), key=lambda p: int(p.name.removesuffix(PATH_MODEL)))
        _linked("Models on the path from many terms to few", name, shorter)
        _linked("Figures", name, sorted((place / FIGURES).glob("*.*")))


def _linked(heading: str, result: str, files: Sequence[Path]) -> None:
    """Link the files of a folder within a result under a heading, if there are any."""
    if files:
        text("h3", heading)
        with ui.element("p").classes("actions"):
            for file in files:
                link(file.name, stored(result, f"{file.parent.name}/{file.name}"), new_tab=True)
