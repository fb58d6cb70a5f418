"""Where tasks run: in the threads of this process, or on the workers of a Dask cluster."""

from __future__ import annotations

import asyncio
import logging
import math
import os
import re
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from itertools import takewhile
from typing import Any, ClassVar, Protocol, TypeVar

from odescope.errors import InputError, OdescopeError, WorkersLostError

T = TypeVar("T")
R = TypeVar("R")

# Tasks under way for each that runs: enough that no thread waits for its next, few enough that none pile up.
AHEAD_OF_THREADS = 2
AHEAD_OF_CLUSTER = 4
# Seconds: for a scheduler to answer, for its first worker to come, and for a cluster to stay without any.
CONNECT = 10.0
FIRST_WORKER = 30.0
DESERTED = 60.0
# Seconds between two looks at a cluster from which no result comes, and at how many threads it has.
LOOK = 5.0
# Seconds for a local worker to end its task when all is over, before it is killed.
GRACE = 0.5
# A task that raises what odescope did not foresee (no memory left, a disk that is full) may fare better elsewhere.
RETRIES = 2


class Workers(Protocol):
    """A place where tasks run.

    `remote` says whether that is elsewhere: there, data are read where they lie, not sent.
    """

    remote: ClassVar[bool]

    @property
    def count(self) -> int:
        """How many tasks run at once."""

    def map(self, function: Callable[..., R], items: Iterable[T], *shared: Any, alone: bool = False) -> Iterator[R]:
        """Yield function(item, *shared) for every item, in the order of the items.

        Items are taken lazily, a bounded number ahead of what is asked for. Tasks are pure: they may run twice, and
        change neither the item nor what is shared.

        Args:
            function: what a task computes.
            items: one a task.
            shared: large arguments common to all tasks; a cluster is sent them once.
            alone: each task keeps a whole machine busy by itself: in this process they run one after the other, on a
                cluster all at once.

        Raises:
            WorkersLostError: the cluster is gone, or its workers die on a task.
        """


@dataclass(frozen=True)
class Threads:
    """Runs tasks in threads of this process; each call of `map` has its own."""

    remote: ClassVar[bool] = False
    count: int = field(default_factory=lambda: os.cpu_count() or 1)

    def map(self, function: Callable[..., R], items: Iterable[T], *shared: Any, alone: bool = False) -> Iterator[R]:
        """Yield function(item, *shared) in order (see `Workers.map`); with `alone`, in the thread of the caller."""
        if alone:
            for item in items:
                yield function(item, *shared)
            return
        pending: deque[Future[R]] = deque()
        pool = ThreadPoolExecutor(self.count)
        try:
            for item in items:
                pending.append(pool.submit(function, item, *shared))
                if len(pending) >= AHEAD_OF_THREADS * self.count:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:  # whoever stops early does not wait for what runs
            pool.shutdown(wait=False, cancel_futures=True)


@dataclass(frozen=True)
class Cluster:
    """Runs tasks on the workers of a Dask scheduler; a worker that dies costs its tasks, which run again elsewhere.

    Attributes:
        client: a connected `distributed.Client`.
        address: of the scheduler, for messages.
    """

    remote: ClassVar[bool] = True
    client: Any
    address: str

    @property
    def count(self) -> int:
        """The threads of all workers; workers may come and go."""
        with self._connected():
            return sum(self.client.nthreads().values())

    def map(self, function: Callable[..., R], items: Iterable[T], *shared: Any, alone: bool = False) -> Iterator[R]:
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
                pending.append(self._submit(_task, _packed(item), common))
                while len(pending) + len(results) >= most():
                    yield self._next(pending, results)
            while pending or results:
                yield self._next(pending, results)
        finally:
            if self.client.status == "running":
                self.client.cancel([common, *pending])

    def _submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        with self._connected():
            return self.client.submit(function, *arguments, pure=False, retries=RETRIES)

    def _next(self, pending: deque[Any], results: deque[R]) -> R:
        """Return the next result; all that are ready come in one message, as each message takes milliseconds."""
        while not results:  # what was ready may be lost again, with the worker that held it
            self._wait(pending[0])
            with self._connected():
                ready = list(takewhile(lambda future: future.status == "finished", pending))
                results.extend(self.client.gather(ready))
            for _ in ready:
                pending.popleft()
        result = results.popleft()
        if isinstance(result, _Refusal):
            raise result.error
        return result

    def _wait(self, future: Any) -> None:
        """Return when the future is finished; raise what its task raised."""
        from distributed import KilledWorker

        deserted = 0.0
        while True:
            try:
                error = future.exception(timeout=LOOK)
                break
            except TimeoutError:
                deserted = 0.0 if self.count else deserted + LOOK
                if deserted >= DESERTED:
                    raise WorkersLostError(
                        f"the scheduler at {self.address} has had no worker for {deserted:.0f} s; start workers "
                        f"(dask worker {self.address}) and run the same command again: it resumes"
                    ) from None
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
def workers(cluster: str | None = None) -> Iterator[Workers]:
    """Open a place where tasks run, and close it afterwards; a scheduler that was there before stays.

    A script that asks for "local" guards its entry by `if __name__ == "__main__":`, as the new processes import it.

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
    with _quiet(), dask.config.set(unwarned), _local() if cluster == "local" else _remote(cluster) as client:
        yield Cluster(client, cluster)


@contextmanager
def _local() -> Iterator[Any]:
    """Start one worker process a core, without limits on memory: the machine has its own."""
    from distributed import Client, LocalCluster

    cluster = LocalCluster(
        n_workers=os.cpu_count(),
        threads_per_worker=1,
        memory_limit=0,
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # its server is there all the same, by itself at 8787
        silence_logs=logging.CRITICAL,
    )
    try:
        with closing(Client(cluster, set_as_default=False)) as client:
            yield client
    finally:
        cluster.sync(_stop, list(cluster.workers.values()))
        cluster.close()


async def _stop(nannies: list[Any]) -> None:
    """Stop worker processes; by itself a cluster would give a task four seconds to end, also after Ctrl-C."""
    await asyncio.gather(*(nanny.close(timeout=GRACE) for nanny in nannies))


@contextmanager
def _remote(address: str) -> Iterator[Any]:
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
        return function(unpacked, *shared)
    except OdescopeError as error:
        return _Refusal(error)


def _packed(value: Any) -> Any:
    """Return a value as bytes that Dask passes on unread, in an array: of bytes proper it makes many slow copies."""
    import cloudpickle
    import numpy as np

    return np.frombuffer(cloudpickle.dumps(value), dtype=np.uint8)


def _unpacked(packed: Any) -> Any:
    import cloudpickle

    return cloudpickle.loads(packed)
