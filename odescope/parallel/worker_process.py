"""The program of one worker process on this machine: python -m odescope.parallel.worker_process ADDRESS FOLDER."""

from __future__ import annotations

import asyncio
import os
import sys
import threading


def _leave_with_the_parent() -> None:
    """End at once when the pipe from the parent closes, be it that all is over or that the parent died."""
    sys.stdin.buffer.read()
    os._exit(0)


async def _serve(address: str, folder: str) -> None:
    from distributed import Worker

    async with Worker(
        address, nthreads=1, memory_limit=0, dashboard=False, local_directory=folder, host="127.0.0.1"
    ) as worker:
        await worker.finished()


if __name__ == "__main__":
    threading.Thread(target=_leave_with_the_parent, daemon=True).start()
    asyncio.run(_serve(*sys.argv[1:3]))
