"""The regression problem of one target: its library on the signals, mapped to rows and factored fold by fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, NoModelError
from odescope.library.candidates import Library, split_target
from odescope.library.expression import ONE, Term
from odescope.library.tape import evaluate, write_tape
from odescope.regression.factor import Factor, factorise, merge
from odescope.regression.rows import Block, RowChoice, RowMap, cut_blocks
from odescope.signals.estimate import Signals

PIECES = 40  # of all rows, at least, that a bootstrap draws from
LARGEST_CANDIDATE = 1e140  # sums of squares must not overflow


@dataclass(frozen=True, eq=False)
class Problem:
    """One target's candidates, their values, and the factors of the folds.

    Shapes, one array a block: values (m, n_b) of the candidates, multipliers (k, n_b) of the target's own terms,
    measured (n_b,) of the target. `own` lists the k candidates that hold the target, `rests` the candidates without any
    target, `pieces` are the factors of runs of rows within the blocks, `dependent` what was left out because it is a
    combination of others on these data.
    """

    target: str
    terms: tuple[Term, ...]
    rests: tuple[Term, ...]
    own: tuple[int, ...]
    left: int
    blocks: tuple[Block, ...]
    values: tuple[FloatArray, ...]
    multipliers: tuple[FloatArray, ...]
    measured: tuple[FloatArray, ...]
    row_map: RowMap
    folds: tuple[Factor, ...]
    pieces: tuple[Factor, ...]
    dependent: tuple[tuple[Term, tuple[Term, ...]], ...] = ()

    @cached_property
    def factor(self) -> Factor:
        """The factor of all rows."""
        return merge(self.folds)

    @cached_property
    def training(self) -> tuple[Factor, ...]:
        """For each fold the factor of all others; the whole where there is but one fold."""
        if len(self.folds) == 1:
            return self.folds
        return tuple(merge([f for k, f in enumerate(self.folds) if k != out]) for out in range(len(self.folds)))

    @cached_property
    def samples(self) -> int:
        """Samples in all blocks."""
        return sum(len(m) for m in self.measured)

    def residual(self, block: int, xi: FloatArray) -> FloatArray | None:
        """Return target minus prediction over a block, (n_b,), or None where the denominator changes sign.

        The prediction solves the relation for the target: -(terms without it) / (what multiplies it).
        """
        multiplier = xi[list(self.own)] @ self.multipliers[block]
        if not multiplier.min() * multiplier.max() > 0.0:
            return None
        relation: FloatArray = (xi @ self.values[block]) / multiplier
        return relation


def pose(signals: Signals, target: str, order: int, library: Library, choice: RowChoice) -> Problem:
    """Return the regression problem of one target.

    Raises:
        InputError: no candidate holds the target, a candidate is not finite on the data, or there are fewer samples
            than candidates.
        NoModelError: a candidate vanishes on all data and nothing is left without it.
    """
    split = [split_target(term, signals.targets) for term in library]
    if not any(name == target for name, _ in split):
        raise InputError(f"no candidate term of the library holds the target {target}")
    if signals.samples < len(library):
        raise InputError(
            f"after filtering, {signals.samples} samples cannot decide between {len(library)} candidate terms for"
            f" {target}: record longer, or shrink the library ([library] degree, basis or rules)"
        )
    blocks = cut_blocks(signals)
    held = [rest for name, rest in split if name == target]
    tape = write_tape(signals.names, [*library, *held])
    whole = [evaluate(tape, signals.columns[b.record][:, b.start : b.stop]) for b in blocks]
    keep = _usable(library, whole)
    terms = tuple(library.terms[j] for j in keep)
    own = tuple(k for k, j in enumerate(keep) if split[j][0] == target)
    if not own:
        raise NoModelError("library", f"every candidate that holds {target} vanishes on the data")
    values = tuple(np.ascontiguousarray(w[list(keep)]) for w in whole)
    place = {j: len(library) + k for k, j in enumerate(j for j, (name, _) in enumerate(split) if name == target)}
    multipliers = tuple(w[[place[keep[k]] for k in own]] for w in whole)
    left = next((k for k in own if split[keep[k]][1] == ONE), own[0])
    row = signals.row(target)
    measured = tuple(signals.columns[b.record][row, b.start : b.stop] for b in blocks)
    row_map = choice.row_map(signals, order, blocks, values, left)
    parts = -(-PIECES // len(blocks))
    rows = ((b.fold, row_map.rows(b, v)) for b, v in zip(blocks, values, strict=True))
    pieces = [(fold, factorise([part])) for fold, whole in rows for part in np.array_split(whole, parts) if len(part)]
    folds = tuple(merge([f for fold, f in pieces if fold == n]) for n in sorted({b.fold for b in blocks}))
    rests = tuple(split[j][1] for j in keep)
    factors = folds, tuple(f for _, f in pieces)
    problem = Problem(target, terms, rests, own, left, blocks, values, multipliers, measured, row_map, *factors)
    dependent = _dependent(problem, signals.targets)
    if not dependent:
        return problem
    left_out = {term for term, _ in dependent}
    smaller = Library(tuple(t for t in library if t not in left_out))
    return replace(pose(signals, target, order, smaller, choice), dependent=dependent)


def _dependent(problem: Problem, targets: Sequence[str]) -> tuple[tuple[Term, tuple[Term, ...]], ...]:
    """Return candidates that are combinations of those before them, and these: without a target, then with this one.

    Those with the target are compared by what multiplies it: a combination of both kinds is no nuisance but what is
    looked for. Samples are compared, since of rows there may be fewer than candidates.
    """
    plain = [j for j, term in enumerate(problem.terms) if not term.names & set(targets)]
    found: list[tuple[Term, tuple[Term, ...]]] = []
    for columns, values in ((plain, [v[plain] for v in problem.values]), (problem.own, problem.multipliers)):
        if not columns:
            continue
        terms = [problem.terms[j] for j in columns]
        factor = factorise(np.ascontiguousarray(v.T) for v in values)
        found += [(terms[j], tuple(terms[k] for k in others)) for j, others in factor.dependent()]
    return tuple(found)


def _usable(library: Library, whole: list[FloatArray]) -> tuple[int, ...]:
    """Return the candidates that are not zero everywhere; refuse those that are not finite."""
    keep = []
    for j, term in enumerate(library):
        bad = sum(int(np.count_nonzero(~np.isfinite(w[j]))) for w in whole)
        if bad:
            raise InputError(
                f"the candidate {term} has no finite value on {bad} samples: its functions do not suit the range of"
                " the data; leave it out of the basis"
            )
        largest = max(float(np.abs(w[j]).max()) for w in whole)
        if largest > LARGEST_CANDIDATE:
            raise InputError(
                f"the candidate {term} reaches {largest:.3g} on the data, too large to compute with:"
                " measure in a larger unit, or leave it out of the basis"
            )
        if largest > 0.0:
            keep.append(j)
    return tuple(keep)
