"""What searches may cost: evaluations are counted, not seconds, so that a study gives the same model on any machine."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from odescope.events import Monitor
from odescope.likelihood.program import Program
from odescope.likelihood.segments import Segments

OPERATIONS = 1e9  # of the kernel in a unit of budget: about half a second of two cores of 2024
INSTRUCTION = 4.0  # operations that an instruction of the tape stands for: some are sines


@dataclass(eq=False)
class Budget:
    """Counts what evaluations cost; the one thing here that changes, shared by all who evaluate for one search.

    Attributes:
        limit: units that may be spent; a unit is about half a second of two cores.
        monitor: asked at every evaluation whether to stop.
        deadline: of the clock (`time.time`), None for none.
        spent: units so far.
    """

    limit: float = float("inf")
    monitor: Monitor = field(default_factory=Monitor)
    deadline: float | None = None
    spent: float = 0.0

    def __getstate__(self) -> dict[str, object]:
        """Return what is copied to another process: whom a run tells stays behind."""
        return self.__dict__ | {"monitor": Monitor()}

    def spend(self, segments: Segments, program: Program, free: int, steps: int) -> None:
        """Count one evaluation.

        Args:
            segments: that are integrated.
            program: of the mechanisms on the tape.
            free: number of parameters.
            steps: of RK4, over all averages.
        """
        n, targets = len(program.following), program.targets
        width = n + free
        a_stage = INSTRUCTION * (len(program.tape.instructions.code) + len(program.places.slot)) + width * targets * (
            n + targets + 4
        )
        an_average = 0.5 * len(segments.noise) * width**2
        self.spent += (4.0 * steps * a_stage + float(segments.count.sum()) * an_average) / OPERATIONS

    @property
    def late(self) -> bool:
        """Whether the clock has struck."""
        return self.deadline is not None and time.time() > self.deadline

    @property
    def over(self) -> bool:
        """Whether whoever searches has to come to an end."""
        return self.spent > self.limit or self.late

    def part(self, share: float) -> Budget:
        """Return a budget of a share of the limit, with nothing spent."""
        return Budget(share * self.limit, self.monitor, self.deadline)

    def rest(self, least: float) -> Budget:
        """Return a budget of what is left of the limit, or of this share of it if that is more, with nothing spent."""
        return self.part(max(1.0 - self.spent / self.limit, least))
