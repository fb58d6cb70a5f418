"""What every stage is given, and the search through all supports of a regression problem, as the study wants it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from odescope.events import Monitor, StageBegan
from odescope.likelihood.budget import Budget
from odescope.parallel.memory import peak_bytes
from odescope.parallel.workers import Workers
from odescope.regression.problem import Problem
from odescope.regression.proposers import Support
from odescope.selection.sweep import Sweep, nested_libraries, sweep
from odescope.study.options import Study

SEARCHES = 4.0  # times the budget of a search, for all that an identification makes
FIRST_LOOK = 1.0  # units of budget
WIDE = 330  # candidates of a target: the paper's library by degree has so many


@dataclass(frozen=True, eq=False)
class Work:
    """What every stage is given: the study, whom to tell, who computes; and the book of what the stages took.

    `deadline` is when searches end by the clock (`time.time`), None for never. `seconds` is the time of each stage,
    `memory` the most that the process had held, in bytes, when it ended. `searches` counts what all searches took.
    """

    study: Study
    monitor: Monitor
    workers: Workers
    deadline: float | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    memory: dict[str, int | None] = field(default_factory=dict)
    searches: Budget = field(default_factory=Budget)

    @property
    def left(self) -> float:
        """Units of budget that another search may take: what others left, and always enough for a first look."""
        return max(self.searches.limit - self.searches.spent, FIRST_LOOK)

    @property
    def late(self) -> bool:
        """Whether the clock has struck: what may wait is then left undone."""
        return self.deadline is not None and time.time() > self.deadline

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Tell that a stage begins, and book what it took; a stage may have several parts.

        Raises:
            Stopped: the run is to end.
        """
        self.monitor.check()
        self.monitor.tell(StageBegan(name))
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
        self.memory[name] = peak_bytes()


def swept(work: Work, problem: Problem) -> Sweep:
    """Return all the supports that are found for a target.

    Where candidates are very many, only those that hold the target are left-hand sides: one of them is in every
    relation for it, and what all the others find takes many times as long.
    """
    proposers, check = work.study.regression.proposers, work.monitor.check
    guesses = problem.own if len(problem.terms) > WIDE else None
    return sweep(problem.factor, problem.terms, nested(work.study, problem), proposers, check, guesses)


def nested(study: Study, problem: Problem) -> tuple[Support, ...]:
    """Return the sets of columns that are searched in."""
    whole = (tuple(range(len(problem.terms))),)
    return nested_libraries(problem.terms, problem.own) if study.regression.nested else whole
