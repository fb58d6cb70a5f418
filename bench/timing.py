"""What the benchmarks of speed share: alternating runs, their spread, ratios, and what a command costs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Timing:
    """Seconds of repeated runs, each times `scale` where only a part of the work was run."""

    seconds: tuple[float, ...]
    scale: float = 1.0

    @property
    def median(self) -> float:
        """Median, scaled."""
        return float(np.median(self.seconds)) * self.scale

    @property
    def best(self) -> float:
        """Least, scaled: what the work costs when nothing else runs."""
        return min(self.seconds) * self.scale

    @property
    def text(self) -> str:
        """Median and range for a table."""
        low, high = self.best, max(self.seconds) * self.scale
        spread = f" ({duration(low)} to {duration(high)})" if len(self.seconds) > 1 else ""
        return duration(self.median) + spread + ("" if self.scale == 1.0 else ", scaled")


@dataclass(frozen=True)
class Row:
    """One line of the table: ours beside peers; `target` in seconds, `ratio` the peer's anchor over the target.

    `limit` says what is in the way where the target is missed. Without times of the peer, `absent` says why.
    """

    work: str
    ours: Timing
    target: float
    peer: str
    theirs: Timing | None
    ratio: float | None = None
    limit: str = ""
    absent: str = "PySINDy not installed"

    @property
    def ratios(self) -> np.ndarray:
        """Peer over ours: run by run where both were repeated, else over every run of ours."""
        if self.theirs is None:
            return np.zeros(0)
        count = min(len(self.ours.seconds), len(self.theirs.seconds))
        theirs = np.array(self.theirs.seconds[:count]) if count > 1 else np.array(self.theirs.seconds[0])
        ours = np.array(self.ours.seconds[:count] if count > 1 else self.ours.seconds)
        return theirs * self.theirs.scale / (ours * self.ours.scale)

    @property
    def met(self) -> str:
        """Whether the target is met: in seconds, or at least as a ratio to the peer on the same machine."""
        if self.ours.median < self.target:
            return "yes"
        if self.ratio is not None and self.theirs is not None and np.median(self.ratios) >= self.ratio:
            return "as a ratio"
        return "best run" if self.ours.best < self.target else "no"

    @property
    def cells(self) -> tuple[str, ...]:
        """The line's cells."""
        if self.theirs is None:
            peer, ratio = f"{self.peer}: {self.absent}", ""
        else:
            r = self.ratios
            peer = f"{self.peer}: {self.theirs.text}"
            ratio = figures(np.median(r)) + (f" ({figures(r.min())} to {figures(r.max())})" if len(r) > 1 else "")
        wanted = duration(self.target) + (f"; {figures(self.ratio)}" if self.ratio else "")
        return self.work, self.ours.text, wanted, peer, ratio, self.met


def duration(seconds: float) -> str:
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if seconds * factor >= 1.0 or unit == "µs":
            return f"{figures(seconds * factor)} {unit}"
    raise AssertionError


def figures(value: float) -> str:
    """Three significant figures, thousands apart."""
    rounded = float(f"{value:.3g}")
    return f"{rounded:,.0f}".replace(",", " ") if rounded >= 100 else f"{rounded:g}"


def once(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def alternate(works: Mapping[str, Callable[[], object] | None], repeats: int) -> dict[str, Timing]:
    """Time all in turn, round after round, so that a busy moment of the machine hits them alike; one round warms up."""
    kept = {name: work for name, work in works.items() if work is not None}
    for work in kept.values():
        work()
    rounds = [{name: once(work) for name, work in kept.items()} for _ in range(repeats)]
    return {name: Timing(tuple(r[name] for r in rounds)) for name in kept}


# Run by a Python that has imported nothing: a process begins with the peak memory of the one that started it.
LAUNCH = """
import json, resource, subprocess, sys, time
begin = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
seconds, used = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
kilobytes = used.ru_maxrss / (1024 if sys.platform == "darwin" else 1)
print(json.dumps([done.returncode, seconds, used.ru_utime + used.ru_stime, kilobytes / 1e3, done.stdout]))
"""


@dataclass(frozen=True)
class Process:
    """A command run as a process of its own: wall and processor seconds, peak memory in MB, what it printed."""

    seconds: float
    busy: float
    megabytes: float
    output: str


def command(arguments: Sequence[str], **environment: str) -> Process:
    launched = subprocess.run(
        [sys.executable, "-I", "-S", "-c", LAUNCH, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        env=os.environ | environment,
    )
    code, *found = json.loads(launched.stdout)
    if code:
        raise RuntimeError(f"{' '.join(arguments)} ended with {code}")
    return Process(*found)


def slope(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def table(head: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> str:
    rule = ["---:" if k in right else "---" for k in range(len(head))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *rows)).replace("| --", "|--")
