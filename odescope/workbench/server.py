"""The server of a workbench: on the loopback address alone, behind its guard, until it is interrupted."""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from nicegui import app as pages_app
from nicegui import run, ui

from odescope.errors import InputError
from odescope.workbench.access import HOST, Access, Guard
from odescope.workbench.folder import Folder
from odescope.workbench.jobs import Jobs
from odescope.workbench.pages import add_pages

RECONNECT = 30.0  # seconds that a page which lost its connection is kept
FIRST_PORT, PORTS = 20_000, 12_000  # of folders: below those that systems give to connections


def serve(folder: Folder, port: int, opened: Callable[[str], None]) -> None:
    """Serve the workbench of a folder until an interrupt comes; runs that it began go on.

    Args:
        folder: all that it sees.
        port: on the loopback address; 0 for that of the folder, or a free one where it is taken.
        opened: called with the address once it can be opened.

    Raises:
        InputError: the port is taken.
    """
    bound = _bound(port) if port else _bound_for(folder.root)
    access = Access(bound.getsockname()[1])
    inner = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    run.process_pool_start_method = "spawn"
    jobs = Jobs(folder)
    add_pages(folder, jobs)
    ui.run_with(
        inner,
        title="odescope",
        favicon=FAVICON,
        language="en-US",
        tailwind=False,
        show_welcome_message=False,
        reconnect_timeout=RECONNECT,
        binding_refresh_interval=None,
    )
    pages_app.on_startup(lambda: opened(access.address))
    guard = Guard(inner, access)
    config = uvicorn.Config(
        guard,
        log_level="warning",
        access_log=False,
        timeout_graceful_shutdown=1,
        server_header=False,
        ws_max_size=2**22,
    )
    uvicorn.Server(config).run(sockets=[bound])


def home_port(root: Path) -> int:
    """Return the port of a folder, by its path: a page that is open from before finds the workbench there again."""
    return FIRST_PORT + int.from_bytes(sha256(os.fsencode(root)).digest()[:8], "big") % PORTS


def _bound_for(root: Path) -> socket.socket:
    try:
        return _bound(home_port(root))
    except InputError:
        return _bound(0)


def _bound(port: int) -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere this would take the port from who has it; here from connections that ended
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((HOST, port))
        found.listen()  # now it is nobody else's
    except OSError as error:
        found.close()
        taken = "is taken: another workbench may run there" if error.errno == errno.EADDRINUSE else error.strerror
        raise InputError(f"port {port} {taken}; name another with --port, or none for a free one") from error
    return found


FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="6" fill="#18181b"/>'
    '<path d="M3 20c4 0 4-12 8-12s4 16 8 16 4-9 10-9" fill="none" stroke="#56B4E9" stroke-width="3"/></svg>'
)
