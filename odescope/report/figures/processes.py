"""Drawing in processes of their own: they load matplotlib while the identification runs, and then share the figures.

Loading and drawing one after the other would double the time of the demo. What can be drawn before the likelihood stage
is handed over as a draft; a figure of the report whose data are those of the draft, byte for byte, is then there.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from queue import SimpleQueue
from typing import IO

from odescope.report.figures.catalogue import Picture, draw_job

MOST = 3  # processes
Drawn = dict[str, tuple[str, bytes]]  # name of a figure -> SVG, PNG


class Painters:
    """Draws pictures, each job once; jobs wait in a queue for one of the processes."""

    def __init__(self, idle: SimpleQueue[subprocess.Popen[bytes]], pool: ThreadPoolExecutor) -> None:
        self._idle, self._pool = idle, pool
        self._begun: dict[bytes, Future[tuple[str, bytes]]] = {}
        self.closed = False

    def begin(self, pictures: Sequence[Picture]) -> None:
        """Hand over pictures that are likely to be wanted."""
        for job in [p.job for p in pictures]:
            if job not in self._begun:
                self._begun[job] = self._pool.submit(self._drawn, job)

    def paint(self, pictures: Sequence[Picture]) -> Drawn:
        """Return pictures drawn, by name."""
        self.begin(pictures)
        return {p.name: self._begun[p.job].result() for p in pictures}

    def _drawn(self, job: bytes) -> tuple[str, bytes]:
        child = self._idle.get()
        try:
            assert child.stdin is not None
            assert child.stdout is not None
            _send(child.stdin, job)
            svg, png = _receive(child.stdout), _receive(child.stdout)
        except OSError:
            svg, png = None, None
        finally:
            self._idle.put(child)
        if self.closed:
            return "", b""  # nobody waits for it
        # A process that may not start, or was killed: draw here, where errors show.
        return draw_job(job) if svg is None or png is None else (svg.decode(), png)


@contextmanager
def painters() -> Iterator[Painters]:
    """Start the processes, and end them at the end."""
    # -P: modules are not looked for in the working directory, where a user's own may be called like one of Python's.
    command = [sys.executable, "-P", "-m", "odescope.report.figures.processes"]
    idle: SimpleQueue[subprocess.Popen[bytes]] = SimpleQueue()
    running = []
    count = min(MOST, os.cpu_count() or 1)
    for _ in range(count):
        child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        running.append(child)
        idle.put(child)
    pool = ThreadPoolExecutor(count)
    painting = Painters(idle, pool)
    try:
        yield painting
    finally:
        painting.closed = True
        pool.shutdown(wait=False, cancel_futures=True)
        for child in running:
            child.kill()  # they hold nothing that could be lost
        pool.shutdown(wait=True)
        for child in running:
            child.communicate()


def _send(pipe: IO[bytes], message: bytes) -> None:
    pipe.write(len(message).to_bytes(8, "big") + message)
    pipe.flush()


def _receive(pipe: IO[bytes]) -> bytes | None:
    """Return the next message, None where the other end is gone."""
    head = pipe.read(8)
    message = pipe.read(int.from_bytes(head, "big"))
    return message if len(head) == 8 and len(message) == int.from_bytes(head, "big") else None


def _serve() -> None:
    """Load all that drawing takes, then draw one job after the other."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that waits for this one decides
    if hasattr(os, "nice"):
        os.nice(10)  # the answer is waited for first

    while (job := _receive(sys.stdin.buffer)) is not None:
        svg, png = draw_job(job)
        _send(sys.stdout.buffer, svg.encode())
        _send(sys.stdout.buffer, png)


if __name__ == "__main__":
    _serve()
