"""This machine as a Dask cluster: worker processes that are started anew and never import the script that asks.

`multiprocessing`, by which Dask starts processes itself, imports the main script again in each of them, so that one
without a guard would run there once more. Here a worker is `python -m odescope.parallel.worker_process`; functions and
classes of the script travel by value.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from typing import IO, TYPE_CHECKING

from odescope.errors import InputError, WorkersLostError

if TYPE_CHECKING:
    from distributed import Client

FIRST_WORKER = 60.0  # seconds for the processes to come
GRACE = 0.5  # seconds for one to end when all is over, before it is killed
LOOK = 0.2  # seconds between two looks at whether one has died
AGAIN = 1.0  # seconds before another is started in its place


@contextmanager
def local_client() -> Iterator[Client]:
    """Start one single-threaded worker process a core, without limits on memory: the machine has its own.

    Raises:
        InputError: it is not known which Python runs.
        WorkersLostError: no process comes to work.
    """
    from distributed import Client, LocalCluster

    count = os.cpu_count() or 1
    scheduler = LocalCluster(
        n_workers=0,
        protocol="tcp://",
        host="127.0.0.1",
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # its server is there all the same, by itself at 8787
        silence_logs=logging.CRITICAL,
    )
    with (
        closing(scheduler),
        tempfile.TemporaryFile() as errors,
        worker_processes(scheduler.scheduler_address, count, errors),
        closing(Client(scheduler, set_as_default=False)) as client,
    ):
        try:
            client.wait_for_workers(count, timeout=FIRST_WORKER)
        except TimeoutError as error:
            if not client.nthreads():
                raise WorkersLostError(f"no worker process could be started{_last_line(errors)}") from error
        yield client


def _last_line(errors: IO[bytes]) -> str:
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines()
    return f": {lines[-1]}" if lines else ""


@contextmanager
def worker_processes(address: str, count: int, errors: IO[bytes]) -> Iterator[None]:
    """Keep worker processes running; none outlives this block, nor the process that it runs in.

    One that dies is replaced. Each holds the end of a pipe, and ends when the other end closes.

    Args:
        address: of the scheduler.
        count: of the processes.
        errors: what they write to standard error.
    """
    if not sys.executable:
        raise InputError("a local cluster starts Python anew, and sys.executable does not say where it is: set it")
    over = threading.Event()

    with tempfile.TemporaryDirectory(prefix="odescope-", ignore_cleanup_errors=True) as folder:

        def start() -> subprocess.Popen[bytes]:
            return _started(address, folder, errors)

        processes = [start() for _ in range(count)]

        def replace_the_dead() -> None:
            while not over.wait(LOOK):
                for k, process in enumerate(processes):
                    if process.poll() is not None and not over.wait(AGAIN):
                        _end(process)
                        processes[k] = start()

        watch = threading.Thread(target=replace_the_dead, daemon=True)
        watch.start()
        try:
            yield
        finally:
            over.set()
            watch.join()
            for process in processes:
                _close(process)
            for process in processes:
                _end(process)


def _close(process: subprocess.Popen[bytes]) -> None:
    """Close the pipe that keeps a process running."""
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process, and wait until it is gone."""
    _close(process)
    try:
        process.wait(GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _started(address: str, folder: str, errors: IO[bytes]) -> subprocess.Popen[bytes]:
    import dask

    # Modules beside the script are found as they are here; -P, since the working directory is none of those places.
    path = os.pathsep.join(os.path.abspath(place) for place in sys.path)
    threads = {key: str(value) for key, value in dask.config.get("distributed.nanny.pre-spawn-environ", {}).items()}
    windows = sys.platform == "win32"
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "odescope.parallel.worker_process", address, folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=errors,
        env={**threads, **os.environ, "PYTHONPATH": path},
        # A Ctrl-C of the terminal goes to whoever started them, and only from there to them.
        start_new_session=not windows,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0) if windows else 0,
    )
