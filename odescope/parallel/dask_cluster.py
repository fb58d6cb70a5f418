"""The workers of a Dask cluster, and how a place where tasks run is opened."""

from __future__ import annotations

import asyncio
import logging
import math
import re
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from itertools import takewhile
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from odescope.errors import InputError, OdescopeError, WorkersLostError
from odescope.parallel.local_processes import local_client
from odescope.parallel.workers import PATIENCE, Threads, Workers, nothing, run_while_wanted

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")
R = TypeVar("R")

# Tasks under way for each thread of the cluster: enough that none waits for its next, few enough that none pile up.
AHEAD_OF_CLUSTER = 4
# Seconds: for a scheduler to answer, for its first worker to come, and for a cluster to stay without any.
CONNECT = 10.0
FIRST_WORKER = 30.0
DESERTED = 60.0
# Seconds between two looks at a cluster from which no result comes, and at how many threads it has.
LOOK = 5.0
# A task that raises what odescope did not foresee (no memory left, a disk that is full) may fare better elsewhere.
RETRIES = 2


@dataclass(frozen=True)
class Cluster:
    """Runs tasks on the workers of a Dask scheduler; a worker that dies costs its tasks, which run again elsewhere.

    Attributes:
        client: a connected `distributed.Client`.
        address: of the scheduler, for messages.
    """

    remote: ClassVar[bool] = True
    client: Client
    address: str

    @property
    def count(self) -> int:
        """The threads of all workers; workers may come and go."""
        with self._connected():
            return sum(self.client.nthreads().values())

    def at_most(self, count: int) -> Cluster:
        """Return the cluster: tasks do not share this process's memory."""
        return self

    def map(
        self,
        function: Callable[..., R],
        items: Iterable[T],
        *shared: object,
        alone: bool = False,
        check: Callable[[], None] = nothing,
    ) -> Generator[R, None, None]:
        """Yield function(item, *shared) in order (see `Workers.map`); `alone` makes no difference here.

        What is shared is the result of a task of its own, not scattered data: the scheduler knows how to make it
        again, so that it outlives every worker that holds it.
        """
        most = self._most_ahead()
        pending: deque[Any] = deque()
        results: deque[R] = deque()
        common = self._submit(_unpacked, _packed((_version(), function, shared)))
        try:
            for item in items:
                check()
                pending.append(self._submit(_task, _packed(item), common))
                while len(pending) + len(results) >= most():
                    yield self._next(pending, results, check)
            while pending or results:
                yield self._next(pending, results, check)
        finally:
            if self.client.status == "running":
                self.client.cancel([common, *pending])

    def _submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        with self._connected():
            return self.client.submit(function, *arguments, pure=False, retries=RETRIES)

    def _next(self, pending: deque[Any], results: deque[R], check: Callable[[], None]) -> R:
        """Return the next result; all that are ready come in one message, as each message takes milliseconds."""
        while not results:  # what was ready may be lost again, with the worker that held it
            self._wait(pending[0], check)
            with self._connected():
                ready = list(takewhile(lambda future: future.status == "finished", pending))
                results.extend(self.client.gather(ready))
            for _ in ready:
                pending.popleft()
        result = results.popleft()
        if isinstance(result, _Refusal):
            raise result.error
        return result

    def _wait(self, future: Any, check: Callable[[], None]) -> None:
        """Return when the future is finished; raise what its task raised."""
        from distributed import KilledWorker

        looked = peopled = time.monotonic()
        finished = threading.Event()
        future.add_done_callback(lambda _: finished.set())  # asking Dask again and again would leave garbage each time
        while True:
            if finished.wait(PATIENCE) or future.done():
                with suppress(TimeoutError):  # what was ready may be lost again
                    error = future.exception(timeout=LOOK)
                    break
            check()
            if (now := time.monotonic()) >= looked + LOOK:
                looked, peopled = now, now if self.count else peopled
                if now - peopled >= DESERTED:
                    raise WorkersLostError(
                        f"the scheduler at {self.address} has had no worker for {now - peopled:.0f} s; start workers "
                        f"(dask worker {self.address}) and run the same command again: it resumes"
                    )
        if isinstance(error, KilledWorker):
            raise WorkersLostError(
                "several workers died one after the other of the same task, mostly for want of memory; give each "
                "worker more of it, or start fewer on a machine, and run the same command again: it resumes"
            ) from error
        if error is not None:
            raise error.with_traceback(future.traceback())
        if future.cancelled():
            raise self._lost()

    def _most_ahead(self) -> Callable[[], int]:
        """Return what says how many tasks may be under way; it asks the scheduler anew every few seconds."""
        asked, most = -math.inf, 0

        def known() -> int:
            nonlocal asked, most
            if time.monotonic() > asked + LOOK:
                most = AHEAD_OF_CLUSTER * max(self.count, 1)
                asked = time.monotonic()
            return most

        return known

    @contextmanager
    def _connected(self) -> Iterator[None]:
        """Say in one way what Dask says in many: that the scheduler is out of reach."""
        try:
            yield
        except Exception as error:
            if isinstance(error, OSError | CancelledError) or self.client.status != "running":
                raise self._lost() from error
            raise

    def _lost(self) -> WorkersLostError:
        return WorkersLostError(
            f"the connection to the scheduler at {self.address} is lost: it was stopped, or the network is down; "
            "start it again, and its workers, and run the same command again: it resumes"
        )


@contextmanager
def open_workers(cluster: str | None = None) -> Iterator[Workers]:
    """Open a place where tasks run, and close it afterwards; a scheduler that was there before stays.

    What runs it is not imported again by the new processes of "local", so that a script needs no guard.

    Args:
        cluster: None: the threads of this process; "local": one single-threaded process a core; "tcp://HOST:PORT" or
            "tls://HOST:PORT": the Dask scheduler there (certificates from Dask's own configuration).

    Raises:
        InputError: another text; Dask is not installed; no scheduler answers; it has no worker, or runs another
            version of odescope.
    """
    if cluster is None:
        yield Threads()
        return
    if cluster != "local" and not re.fullmatch(r"(tcp|tls)://\S+:\d+", cluster):
        raise InputError(
            f"a cluster is local, or the address that `dask scheduler` prints, as in tcp://HOST:8786; {cluster!r} came"
        )
    try:
        import dask
        import distributed  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"cluster {cluster} needs Dask, which is not installed ({error}); pip install 'odescope[cluster]'"
        ) from error
    # The warning advises to scatter large arguments, which would then be lost with the worker that holds them.
    unwarned = {"distributed.admin.large-graph-warning-threshold": sys.maxsize}
    with _quiet(), dask.config.set(unwarned), local_client() if cluster == "local" else _remote(cluster) as client:
        yield Cluster(client, cluster)


@contextmanager
def _remote(address: str) -> Iterator[Client]:
    """Connect to a scheduler that runs, and check that its workers can be used."""
    from distributed import Client
    from distributed.utils import LoopRunner

    try:
        server = LoopRunner().run_sync(_server, address)
    except Exception as error:  # whatever listens there may say anything
        raise InputError(
            f"no Dask scheduler answers at {address} within {CONNECT:.0f} s ({str(error) or 'no answer'}); start one "
            "(dask scheduler) and give the address that it prints"
        ) from error
    if server != "Scheduler":
        raise InputError(f"at {address} answers a Dask {server.lower()}; give the address that `dask scheduler` prints")
    with closing(Client(address, timeout=CONNECT, set_as_default=False)) as client:
        try:
            client.wait_for_workers(1, timeout=FIRST_WORKER)
        except TimeoutError as error:
            raise InputError(
                f"the scheduler at {address} has no worker after {FIRST_WORKER:.0f} s; start one: dask worker {address}"
            ) from error
        _check_versions(client.get_versions(packages=["odescope"]))
        yield client


async def _server(address: str) -> str:
    """Return what kind of Dask server answers; a client by itself would wait for other servers without end."""
    from distributed.core import rpc
    from distributed.security import Security

    async with rpc(address, timeout=CONNECT, connection_args=Security().get_connection_args("client")) as server:
        return str((await asyncio.wait_for(server.identity(), CONNECT))["type"])


def _check_versions(versions: dict[str, Any]) -> None:
    """Raise where another odescope runs; the scheduler reads tasks, and so needs it as well."""
    places = {"the scheduler": versions["scheduler"]}
    places |= {f"the worker {address}": found for address, found in versions["workers"].items()}
    for place, found in places.items():
        _check_version(place, found["packages"]["odescope"], _version())


@cache
def _version() -> str:
    return version("odescope")


def _check_version(place: str, there: str | None, here: str) -> None:
    if there != here:
        found = f"runs odescope {there}" if there else "has no odescope"
        raise InputError(
            f"{place} {found}, and this is odescope {here}, whose results could differ; install odescope=={here} "
            "wherever the scheduler and its workers run, and start them again"
        )


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Dask logs off standard error: what matters of it is raised."""
    names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] in ("distributed", "tornado", "asyncio")]
    levels = {logging.getLogger(name): logging.getLogger(name).level for name in names}
    for logger in levels:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)


@dataclass(frozen=True)
class _Refusal:
    """An error meant for the user: returned, as Dask would run a task that raises again."""

    error: OdescopeError


def _task(item: Any, common: tuple[str, Callable[..., Any], tuple[Any, ...]]) -> Any:
    """Run one task, on a worker."""
    from threadpoolctl import threadpool_limits

    here, function, shared = common
    unpacked = _unpacked(item)
    # For good, not for this task alone: where a task ends, others may still run in other threads of the worker.
    threadpool_limits(1, "blas")
    try:
        _check_version(f"a worker on {socket.gethostname()}", _version(), here)  # it may have come later
        return run_while_wanted(_cancelled(), function, unpacked, *shared)
    except OdescopeError as error:
        return _Refusal(error)


def _cancelled() -> Callable[[], bool]:
    """Return what says whether the client has cancelled the task that runs: Dask itself lets it run to its end."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def cancelled() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    return cancelled


def _packed(value: Any) -> Any:
    """Return a value as bytes that Dask passes on unread, in an array: of bytes proper it makes many slow copies."""
    import cloudpickle
    import numpy as np

    return np.frombuffer(cloudpickle.dumps(value), dtype=np.uint8)


def _unpacked(packed: Any) -> Any:
    import cloudpickle

    return cloudpickle.loads(packed)
