"""What the time stamps of recordings were found to be like."""

from __future__ import annotations

import msgspec

UNEVEN = 0.8  # of the points of a grid: where fewer rows were taken, they are at no even times


class TimeScore(msgspec.Struct, frozen=True):
    """What the time stamps of the recordings were found to be like, and what was done about it.

    Of `rows` rows `disordered` were sorted and `doubled` merged with others; `jitter` is the largest of clocks whose
    stamps were smoothed, in sample periods. `missing` counts, by name, the samples of a coordinate that were not
    measured, and the gaps they are in; `samples` how many each coordinate should have. `bridged` has, by name, the
    longest gap of an input in samples, and how far a straight line over as many is off elsewhere, in its standard
    deviations. `scatter` is the largest of recordings whose samples were taken off even times, in sample periods. `cut`
    counts the gaps at which recordings were cut, `unseen` those of them that were for what an input did in them; the
    others were too long, or all were to be `split`. `short` counts the rows beside these that were left out, in pieces
    too short to use. `clocked` inputs change at even times alone, whenever they were read. `coarse` are the seconds
    that a clock ticked by while several rows came; 0 for none.
    """

    rows: int
    disordered: int
    doubled: int
    jitter: float
    samples: int
    missing: dict[str, tuple[int, int]]
    bridged: dict[str, tuple[int, float]] = {}
    scatter: float = 0.0
    cut: int = 0
    short: int = 0
    clocked: tuple[str, ...] = ()
    unseen: int = 0
    split: bool = False
    coarse: float = 0.0

    @property
    def uneven(self) -> bool:
        """Whether rows came when it mattered, at no even times: nobody lost what is between them."""
        return self.rows < UNEVEN * self.samples

    @property
    def lost(self) -> dict[str, tuple[int, int]]:
        """By name, the samples of a coordinate that others have and it has not, and the gaps they are in."""
        without = min((missing for missing, _ in self.missing.values()), default=0) if self.uneven else 0
        return {name: (n - without, gaps) for name, (n, gaps) in self.missing.items() if n > without}
