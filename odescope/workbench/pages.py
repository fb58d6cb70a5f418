"""The pages of the workbench by their addresses, and the files of results that they lead to."""

from __future__ import annotations

from fastapi import HTTPException
from fastapi.responses import FileResponse, RedirectResponse
from nicegui import app, ui

from odescope.errors import InputError
from odescope.report.result_names import MODEL, NO_MODEL
from odescope.workbench.access import STORED_POLICY
from odescope.workbench.folder import Folder
from odescope.workbench.frame import Workbench
from odescope.workbench.jobs import Jobs
from odescope.workbench.view_data import data_page
from odescope.workbench.view_look import look_page
from odescope.workbench.view_run import run_page
from odescope.workbench.view_study import study_page
from odescope.workbench.view_take import take_page
from odescope.workbench.view_try import try_page


def add_pages(folder: Folder, jobs: Jobs) -> None:
    """Add the pages of a folder to the application."""
    bench = Workbench(folder, jobs)

    @app.get("/")
    def start() -> RedirectResponse:
        return RedirectResponse("/data")

    @app.get("/stored/{name:path}")
    def stored(name: str) -> FileResponse:
        """Return a file of a result; a page among them is shown without scripts."""
        try:
            path = folder.inside(name)
        except InputError as error:
            raise HTTPException(404, str(error)) from error
        of_results = any((place / known).is_file() for place in path.parents for known in (MODEL, NO_MODEL))
        if not (path.is_file() and of_results and path.is_relative_to(folder.root)):
            raise HTTPException(404, "there is no such file among the results")
        return FileResponse(path, headers={"content-security-policy": STORED_POLICY, "cache-control": "no-store"})

    @ui.page("/data")
    async def data(name: str = "") -> None:
        await data_page(bench, name)

    @ui.page("/study")
    async def study(name: str = "") -> None:
        await study_page(bench, name)

    @ui.page("/run")
    async def run(name: str = "") -> None:
        await run_page(bench, name)

    @ui.page("/look")
    async def look(name: str = "") -> None:
        await look_page(bench, name)

    @ui.page("/try")
    async def try_(name: str = "") -> None:
        await try_page(bench, name)

    @ui.page("/take")
    async def take(name: str = "") -> None:
        await take_page(bench, name)
