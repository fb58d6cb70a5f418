"""What the gaps that process noise leaves between segments go with: dry friction, or an input that acts late.

docs/method.md, Process noise.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.mechanism import Mechanism
from odescope.likelihood.evidence import between, in_blocks
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace

CLEAR = 0.1  # least correlation of what is missing with its cause that is worth a word
SURE = 12.0  # least squared ratio of that correlation to its spread between blocks of the record


@dataclass(frozen=True)
class Lacking:
    """What a target lacks.

    Attributes:
        target: its number.
        cause: a velocity, with whose sign it goes, or an input, with whose rate it does.
        correlation: of the two, the other causes and the states taken out.
        friction: whether it is the former.
    """

    target: int
    cause: str
    correlation: float
    friction: bool


def lacking(space: SearchSpace, found: Fit) -> list[Lacking]:
    """Return what a model lacks and what that goes with, dry friction first, for each target.

    The gaps of the highest state of every coordinate are what its target lacks, summed over a segment. What goes with
    the sign of a velocity is dry friction; what goes with the rate of an input is a delay.

    Args:
        space: data in segments with process noise between them, and the candidates.
        found: the model.
    """
    segments, names, following = space.segments, space.frame.variables, space.frame.following
    program, none = space.program(found.present), np.zeros(0, dtype=np.int64)
    last = space.evaluator.integrate(program, found.theta[found.present], none, found.x0).last
    joints = np.flatnonzero(segments.joined)
    begin = found.x0[joints + 1]
    gaps = begin - last[joints]
    here = [space.mechanisms[k] for k in found.present]
    velocities = [int(np.flatnonzero(following == j)[0]) for j in range(len(following)) if (following == j).any()]
    moving = [j for j in (int(following[v]) for v in velocities) if not has_dry_friction(here, names[j])]
    rates = np.diff(segments.inputs[segments.start, 0], axis=0, append=0.0)[joints]
    causes = np.column_stack([*(np.sign(begin[:, j]) for j in moving), rates])
    called = [*(names[j] for j in moving), *names[len(following) :]]
    told = list[Lacking]()
    for i in np.flatnonzero(following < 0):
        for k, correlation in enumerate(_goes_with(gaps[:, i], causes, begin)):
            friction = k < len(moving)
            if correlation is not None and not (friction and correlation >= 0.0):  # friction is against the motion
                told.append(Lacking(-1 - int(following[i]), called[k], correlation, friction))
    return told


def has_dry_friction(mechanisms: Iterable[Mechanism], velocity: str) -> bool:
    """Say whether some term changes sign with a velocity, abruptly or smoothly."""
    terms = (p.product.term for m in mechanisms for p in m.parts)
    return any(velocity in t.names and any(f in t.text for f in ("sign(", "tanh(")) for t in terms)


def _goes_with(gaps: FloatArray, causes: FloatArray, states: FloatArray) -> list[float | None]:
    """Return the correlation with each cause, the others and the states taken out, where it is clear between blocks."""
    shares: list[float | None] = []
    for k in range(causes.shape[1]):
        others = np.column_stack([np.ones(len(causes)), states, np.delete(causes, k, axis=1)])
        both = np.column_stack([gaps, causes[:, k]])
        rest = both - others @ np.linalg.lstsq(others, both, rcond=None)[0]
        scale = float(np.sqrt(np.prod(np.sum(rest**2, axis=0))))
        if not scale > 0.0:
            shares.append(None)
            continue
        blocks = in_blocks(rest[:, :1] * rest[:, 1:] / scale)
        share = float(blocks.sum())
        sure = len(blocks) > 1 and share**2 > SURE * float(between(blocks)[0])
        shares.append(share if sure and abs(share) > CLEAR else None)
    return shares
