"""Where tasks run: the protocol of all places, and the threads of this process."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol, TypeVar

from odescope.errors import Stopped

T = TypeVar("T")
R = TypeVar("R")

# Tasks under way for each thread: enough that none waits for its next, few enough that none pile up.
AHEAD_OF_THREADS = 2
# Seconds between two looks at whether to stop, while a result is waited for.
PATIENCE = 0.2


def nothing() -> None:
    """Check nothing."""


class Workers(Protocol):
    """A place where tasks run.

    `remote` says whether that is elsewhere: there, data are read where they lie, not sent.
    """

    remote: ClassVar[bool]

    @property
    def count(self) -> int:
        """How many tasks run at once."""

    def map(
        self,
        function: Callable[..., R],
        items: Iterable[T],
        *shared: object,
        alone: bool = False,
        check: Callable[[], None] = nothing,
    ) -> Generator[R, None, None]:
        """Yield function(item, *shared) for every item, in the order of the items.

        Items are taken lazily, a bounded number ahead of what is asked for. Tasks are pure: they may run twice, and
        change neither the item nor what is shared. When the iterator is closed, tasks that have not begun are dropped,
        and those that run end where they call `check_wanted`.

        Args:
            function: what a task computes.
            items: one a task.
            shared: large arguments common to all tasks; a cluster is sent them once.
            alone: each task keeps a whole machine busy by itself: in this process they run one after the other, on a
                cluster all at once.
            check: called several times a second while a result is waited for; what it raises ends all tasks.

        Raises:
            WorkersLostError: the cluster is gone, or its workers die on a task.
        """

    def at_most(self, count: int) -> Workers:
        """Return the same place, where tasks that share its memory run at most so many at once."""


_task = threading.local()


def check_wanted() -> None:
    """Raise Stopped in a task for whose result nobody waits any more; long tasks call it between their steps."""
    unwanted: Callable[[], bool] | None = getattr(_task, "unwanted", None)
    if unwanted is not None and unwanted():
        raise Stopped("nobody waits for this task any more")


def run_while_wanted(unwanted: Callable[[], bool], function: Callable[..., R], item: object, *shared: object) -> R:
    """Return function(item, *shared), which `check_wanted` ends when it is no longer wanted.

    Args:
        unwanted: whether it is not.
        function: what the task computes.
        item: of the task.
        shared: with other tasks.
    """
    before = getattr(_task, "unwanted", None)
    _task.unwanted = unwanted
    try:
        return function(item, *shared)
    finally:
        _task.unwanted = before


@dataclass(frozen=True)
class Threads:
    """Runs tasks in threads of this process; each call of `map` has its own."""

    remote: ClassVar[bool] = False
    count: int = field(default_factory=lambda: os.cpu_count() or 1)

    def at_most(self, count: int) -> Threads:
        """Return so many threads, or as many as these."""
        return replace(self, count=min(self.count, count))

    def map(
        self,
        function: Callable[..., R],
        items: Iterable[T],
        *shared: object,
        alone: bool = False,
        check: Callable[[], None] = nothing,
    ) -> Generator[R, None, None]:
        """Yield function(item, *shared) in order (see `Workers.map`); with `alone`, in the thread of the caller."""
        if alone:
            for item in items:
                check_wanted()
                check()
                yield function(item, *shared)
            return
        pending: deque[Future[R]] = deque()
        pool, closed = ThreadPoolExecutor(self.count), threading.Event()
        outer: Callable[[], bool] | None = getattr(_task, "unwanted", None)

        def unwanted() -> bool:
            return closed.is_set() or (outer is not None and outer())

        def checked() -> None:
            check_wanted()
            check()

        try:
            for item in items:
                checked()
                pending.append(pool.submit(run_while_wanted, unwanted, function, item, *shared))
                if len(pending) >= AHEAD_OF_THREADS * self.count:
                    yield _awaited(pending.popleft(), checked)
            while pending:
                yield _awaited(pending.popleft(), checked)
        finally:  # whoever stops early does not wait for what runs
            closed.set()
            pool.shutdown(wait=False, cancel_futures=True)


def _awaited(future: Future[R], check: Callable[[], None]) -> R:
    while True:
        try:
            return future.result(timeout=PATIENCE)
        except TimeoutError:
            if future.done():  # the task's own
                raise
            check()
