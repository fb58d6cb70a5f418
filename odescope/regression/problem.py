"""The regression problem of one target: its library on the signals, mapped to rows and factored fold by fold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.errors import InputError, NoModelError
from odescope.library.candidates import Library
from odescope.library.product import Product
from odescope.library.tape import Tape, evaluate, write_tape
from odescope.parallel.workers import Threads, Workers
from odescope.regression.factor import Factor, factorise, merge
from odescope.regression.rows import Block, BlockValues, RowChoice, RowMap, cut_blocks
from odescope.signals.estimate import Signals

PIECES = 40  # of all rows, at least, that a bootstrap draws from
MOST_PIECES = 16  # of a fold, to twice as many, that are kept apart: of very many, neighbours are merged
LARGEST_CANDIDATE = 1e140  # sums of squares must not overflow


@dataclass(frozen=True, eq=False)
class LibraryRows:
    """What makes rows of signals, wherever these are: a library and the map of its values.

    The tape's outputs are the m candidates, then what multiplies the target in those that hold it.
    """

    terms: tuple[Product, ...]
    tape: Tape
    row_map: RowMap

    def factors(self, columns: FloatArray, parts: int) -> list[Factor]:
        """Return the factors of so many runs of rows of a block of signals (names, n).

        Raises:
            InputError: a candidate is not finite, or too large, on the block.
        """
        values = evaluate(self.tape, columns)[: len(self.terms)]
        _refuse(self.terms, _Seen.of(values))
        rows = self.row_map.rows(values)
        return [factorise([part]) for part in np.array_split(rows, parts) if len(part)]


@dataclass(frozen=True, eq=False)
class OnBlocks:
    """Some outputs of a tape on each block of the signals, evaluated when asked for: no library stands in memory."""

    tape: Tape
    signals: Signals
    blocks: tuple[Block, ...]
    outputs: slice

    def __len__(self) -> int:
        return len(self.blocks)

    def __getitem__(self, block: int) -> FloatArray:
        """Return the values (outputs, n_b) on a block."""
        here = self.blocks[block]
        values = evaluate(self.tape, self.signals.columns[here.record][:, here.start : here.stop])
        return values[self.outputs]


@dataclass(frozen=True, eq=False)
class Problem:
    """One target's candidates on the signals, and the factors of the folds.

    `own` lists the k candidates that hold the target, `pieces` are the factors of runs of rows within the blocks,
    `dependent` what was left out because it is a combination of others on these data. `folds` are, by number, the
    factors of all the data, `sample` those of the signals where these are but a sample of the data.
    """

    target: str
    library: LibraryRows
    own: tuple[int, ...]
    left: int
    signals: Signals
    blocks: tuple[Block, ...]
    folds: Mapping[int, Factor]
    pieces: tuple[Factor, ...]
    dependent: tuple[tuple[Product, tuple[Product, ...]], ...] = ()
    sample: Mapping[int, Factor] | None = None

    @property
    def terms(self) -> tuple[Product, ...]:
        """The m candidates."""
        return self.library.terms

    @property
    def with_dependent(self) -> tuple[Product, ...]:
        """The candidates, and combinations of others without the target: with these fewer terms may say the same."""
        return (*self.terms, *(product for product, _ in self.dependent if product.factor is None))

    @property
    def row_map(self) -> RowMap:
        """The map from samples to rows."""
        return self.library.row_map

    @cached_property
    def factor(self) -> Factor:
        """The factor of all rows."""
        return merge(list(self.folds.values()))

    @cached_property
    def training(self) -> Mapping[int, Factor]:
        """For each fold the factor of all others; the whole where there is but one fold."""
        if len(self.folds) == 1:
            return self.folds
        return {out: merge([f for k, f in self.folds.items() if k != out]) for out in self.folds}

    @property
    def most_held_out(self) -> float:
        """The largest part of the target's power that one fold of the signals holds, 1 where there is but one."""
        held: dict[int, float] = {}
        for k, block in enumerate(self.blocks):
            held[block.fold] = held.get(block.fold, 0.0) + float(np.sum(self.measured(k) ** 2))
        return max(held.values()) / max(sum(held.values()), 1e-300)

    @property
    def in_one_fold(self) -> Problem:
        """The same problem with nothing held out: relations are fitted on all that they are tried on."""
        blocks = tuple(replace(b, fold=0) for b in self.blocks)
        sample = None if self.sample is None else {0: merge(list(self.sample.values()))}
        return replace(self, blocks=blocks, folds={0: self.factor}, sample=sample)

    @property
    def samples(self) -> int:
        """Samples of the signals in all blocks."""
        return self.signals.samples

    def evaluated(self, block: int) -> FloatArray:
        """Return the values of the candidates on a block, then what multiplies the target in `own`, (m + k, n_b)."""
        return OnBlocks(self.library.tape, self.signals, self.blocks, slice(None))[block]

    @property
    def values(self) -> BlockValues:
        """The values of the candidates on each block, (m, n_b)."""
        return OnBlocks(self.library.tape, self.signals, self.blocks, slice(0, len(self.terms)))

    def measured(self, block: int) -> FloatArray:
        """Return the target on a block, (n_b,)."""
        b = self.blocks[block]
        target: FloatArray = self.signals.columns[b.record][self.signals.row(self.target), b.start : b.stop]
        return target


class Pieces:
    """Collects factors of pieces of the data by the number of their fold.

    However many come, few stand in memory: beyond a number, each that is kept is merged from as many as its neighbours.
    """

    def __init__(self) -> None:
        self._kept: dict[int, list[Factor]] = {}
        self._span: dict[int, int] = {}  # factors that make one that is kept
        self._open: dict[int, int] = {}  # factors that the last one is made of so far

    def take(self, factors: Iterable[tuple[int, Factor]]) -> None:
        """Add factors with their folds."""
        for fold, factor in factors:
            kept, span = self._kept.setdefault(fold, []), self._span.setdefault(fold, 1)
            if kept and self._open[fold] < span:
                kept[-1] = merge([kept[-1], factor])
                self._open[fold] += 1
                continue
            if len(kept) == 2 * MOST_PIECES:
                kept[:] = [merge(kept[k : k + 2]) for k in range(0, len(kept), 2)]
                self._span[fold] = 2 * span
            kept.append(factor)
            self._open[fold] = 1

    def folds(self) -> dict[int, Factor]:
        """Return the factor of every fold."""
        return {fold: merge(self._kept[fold]) for fold in sorted(self._kept)}

    def all(self) -> tuple[Factor, ...]:
        """Return the factors, fold by fold."""
        return tuple(f for fold in sorted(self._kept) for f in self._kept[fold])


def pose(
    signals: Signals,
    target: str,
    order: int,
    library: Library,
    choice: RowChoice,
    folds: Sequence[int] | None = None,
) -> Problem:
    """Return the regression problem of one target.

    Args:
        signals: what it is posed on.
        target: whose equation is looked for.
        order: of that equation.
        library: the candidates.
        choice: what makes rows of samples.
        folds: the fold of each record, see `cut_blocks`.

    Raises:
        InputError: no candidate holds the target, a candidate is not finite on the data, or there are fewer samples
            than candidates.
        NoModelError: a candidate vanishes on all data and nothing is left without it.
    """
    candidates = library.products(signals.targets)
    if not any(c.factor == target for c in candidates):
        raise InputError(f"no candidate term of the library holds the target {target}")
    if signals.samples < len(candidates):
        raise InputError(
            f"after filtering, {signals.samples} samples cannot decide between {len(candidates)} candidate terms for"
            f" {target}: record longer, or shrink the library: [library] degree, rules or a basis"
        )
    blocks = cut_blocks(signals, folds)
    kept, dependent = _kept(signals, target, candidates, blocks)
    own = tuple(k for k, c in enumerate(kept) if c.factor == target)
    if not own:
        raise NoModelError("library", f"every candidate that holds {target} vanishes on the data")
    left = next((k for k in own if kept[k].bare), own[0])
    tape = write_tape(signals.names, [*(c.expanded for c in kept), *(kept[k].term for k in own)])
    values = OnBlocks(tape, signals, blocks, slice(0, len(kept)))
    rows = LibraryRows(kept, tape, choice.row_map(signals, order, blocks, values, left))
    pieces = Pieces()
    pieces.take(factored(rows, signals, blocks, pieces_a_block(len(blocks)), Threads()))
    return Problem(target, rows, own, left, signals, blocks, pieces.folds(), pieces.all(), dependent)


def pieces_a_block(blocks: int) -> int:
    """Return how many pieces of every block make enough for a bootstrap."""
    return -(-PIECES // blocks)


def factored(
    rows: LibraryRows, signals: Signals, blocks: Sequence[Block], parts: int, workers: Workers
) -> Iterator[tuple[int, Factor]]:
    """Yield the factors of so many pieces of every block, with the number of its fold.

    Args:
        rows: what makes rows of signals.
        signals: columns of every record.
        blocks: stretches of the records.
        parts: pieces a block.
        workers: where it is factored.
    """
    for block, found in zip(
        blocks,
        workers.map(lambda b: rows.factors(signals.columns[b.record][:, b.start : b.stop], parts), blocks),
        strict=True,
    ):
        yield from ((block.fold, factor) for factor in found)


@dataclass(frozen=True, eq=False)
class _Seen:
    """How many values of each candidate are not finite, and the largest of the others, (m,)."""

    bad: IntArray
    largest: FloatArray

    @staticmethod
    def of(values: FloatArray) -> _Seen:
        size = np.abs(values)
        fine = np.isfinite(size)
        return _Seen((~fine).sum(axis=1), np.where(fine, size, 0.0).max(axis=1))


def _kept(
    signals: Signals,
    target: str,
    candidates: tuple[Product, ...],
    blocks: Sequence[Block],
) -> tuple[tuple[Product, ...], tuple[tuple[Product, tuple[Product, ...]], ...]]:
    """Return the candidates that are used, and those that are combinations of others, with these.

    Those with the target are compared by what multiplies it: a combination of both kinds is no nuisance but what is
    looked for. Samples are compared, since of rows there may be fewer than candidates.
    """
    plain = [j for j, c in enumerate(candidates) if c.factor is None]
    own = [j for j, c in enumerate(candidates) if c.factor == target]
    tape = write_tape(signals.names, [*(c.expanded for c in candidates), *(candidates[j].term for j in own)])

    def survey(block: Block) -> tuple[_Seen, tuple[Factor, Factor] | None]:
        values = evaluate(tape, signals.columns[block.record][:, block.start : block.stop])
        seen = _Seen.of(values[: len(candidates)])
        if seen.bad.any() or seen.largest.max() > LARGEST_CANDIDATE:
            return seen, None
        return seen, (factorise([values[plain].T]), factorise([values[len(candidates) :].T]))

    surveys = list(Threads().map(survey, blocks))
    seen = _Seen(np.sum([s.bad for s, _ in surveys], axis=0), np.max([s.largest for s, _ in surveys], axis=0))
    _refuse(candidates, seen)
    dependent: list[tuple[Product, tuple[Product, ...]]] = []
    for group, place in ((plain, 0), (own, 1)):
        live = [k for k, j in enumerate(group) if seen.largest[j] > 0.0]
        if not live:
            continue
        terms = [candidates[group[k]] for k in live]
        whole = merge([factors[place] for _, factors in surveys if factors is not None]).restrict(live)
        dependent += [(terms[k], tuple(terms[other] for other in others)) for k, others in whole.dependent()]
    left_out = {term for term, _ in dependent}
    kept = (c for j, c in enumerate(candidates) if seen.largest[j] > 0.0 and c not in left_out)
    return tuple(kept), tuple(dependent)


def _refuse(terms: Sequence[Product], seen: _Seen) -> None:
    """Refuse candidates that are not finite, or too large to square."""
    for term, bad, largest in zip(terms, seen.bad.tolist(), seen.largest.tolist(), strict=True):
        if bad:
            raise InputError(
                f"the candidate {term} has no finite value on {bad} samples: its functions do not suit the range of"
                " the data; leave it out of the basis"
            )
        if largest > LARGEST_CANDIDATE:
            raise InputError(
                f"the candidate {term} reaches {largest:.3g} on the data, too large to compute with:"
                " measure in a larger unit, or leave it out of the basis"
            )
