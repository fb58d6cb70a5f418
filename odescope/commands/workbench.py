"""The workbench: the command that opens it."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path

from odescope.errors import InputError


def open_workbench(folder: Path, port: int, show: bool) -> None:
    """Serve the workbench of a folder, and open it in a browser.

    Args:
        folder: all that it sees.
        port: on the loopback address; 0 for a free one.
        show: whether a browser is opened.

    Raises:
        InputError: there is no such folder, the port is taken, or the packages of the page are not installed.
    """
    try:
        from odescope.workbench.folder import Folder
        from odescope.workbench.server import serve
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("odescope"):
            raise
        raise InputError(f"the workbench needs {error.name}: pip install odescope[web]") from error
    place = Folder.of(folder)

    def opened(address: str) -> None:
        print(f"the workbench of {place.root}\n  {address}\nends with Ctrl-C; runs go on", file=sys.stderr, flush=True)
        if show:
            webbrowser.open(address)

    serve(place, port, opened)
