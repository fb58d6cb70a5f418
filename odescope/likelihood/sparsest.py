"""The fewest terms and functions that say what a relation says: selection by least squares on the smoothed states.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.imitation import DEARER, Choice, Imitated, Placed
from odescope.likelihood.unexplained import NOTHING_LEFT, unexplained
from odescope.parallel.kernels import kernel

LOOKED_AT = 400  # samples
SHORTLIST = 6  # functions of which constants are fitted, and plain terms left out
COUPLES = 2  # of functions without constants, the same
FUNCTIONS = 2  # of a relation
STEPS, FEWER_STEPS = 40, 12  # of the fit of constants, at the end and while terms are left out
COARSER = 3  # points of a grid from one that is looked at to the next: a fit goes on from there
SMALL = 1e-14  # share of what is said that rounding leaves
SAME = 1e-8  # the same, of what says it in other words
ROUNDING = 1e-12  # length, of 1, below which what others leave of a row is rounding


@dataclass(frozen=True)
class Sparse:
    """What stands for a relation: rows of the base by number, functions, and the sum of squares they leave.

    `placed` holds a function for every suspicion, one without terms where there is none. `missed` is relative to what
    the relation says, and no less than the share of it that is not known.
    """

    kept: tuple[int, ...]
    placed: tuple[Placed, ...]
    missed: float

    @property
    def dear(self) -> float:
        """The sum of squares, doubled for every coefficient and constant."""
        return self.missed * DEARER ** (len(self.kept) + sum(p.choice.size for p in self.placed))


def sparse(
    imitated: Imitated, choices: Sequence[Sequence[Choice]], bases: Sequence[Sequence[int]], bar: tuple[float, int]
) -> list[Sparse]:
    """Return what says a relation with fewer terms and functions that still leave little, the best first.

    What a model says is its own imitation where it is not the law: which of those that come near to it is right the
    record has to say.

    Args:
        imitated: what the relation says, with all that may stand beside functions.
        choices: the functions for every suspicion, of which one at most is taken.
        bases: rows of the base to begin with beside one function, one choice of them after the other.
        bar: share of what is said that is not known, and the number of terms that say it now.
    """
    seen = _thinned(imitated)
    unknown, terms = max(bar[0], SMALL), bar[1] + 1
    small = [[c for c in among if c.size < terms] for among in choices]
    none = Sparse(tuple(range(len(seen.base))), (Placed(Choice()),) * len(choices), np.inf)
    best = _leaner(seen, _fitted(seen, none, STEPS, unknown), unknown)
    found = [best, *(_leaner(seen, one, unknown) for one in _couples(seen, small, bases, unknown))]
    for _ in range(FUNCTIONS):
        tried = _promising(seen, small, best.placed, bases, unknown)
        ends = [_leaner(seen, _fitted(seen, one, STEPS, unknown), unknown) for one in tried]
        found += ends
        if best is (best := min((best, *ends), key=lambda one: one.dear)):
            break
    distinct = {(one.kept, tuple(p.choice for p in one.placed)): one for one in found}
    return _shortlisted((one for one in distinct.values() if one.dear < unknown * DEARER**terms), unknown)


def grown(imitated: Imitated, choices: Sequence[Sequence[Choice]], bar: tuple[float, int]) -> list[Sparse]:
    """Return what says a relation with one function and, of many plain terms, the fewest beside it, the best first.

    A function is recognised beside the right terms alone, and these may be products: a flow times a concentration.

    Args:
        imitated: what the relation says, with all plain terms.
        choices: the functions for every suspicion, of which one at most is taken.
        bar: share of what is said that is not known, and the number of terms that say it now.
    """
    seen, unknown, terms = _thinned(imitated), max(bar[0], SMALL), bar[1] + 1
    said, base, found = _unit(seen.said[None])[0], _unit(seen.base), list[Sparse]()
    none = (Placed(Choice()),) * len(choices)
    for k, choice in ((k, c) for k, among in enumerate(choices) for c in among):
        points, columns = seen.samples.on_grid(choice)
        tried = list[Sparse]()
        for values, here in list(zip(points, columns, strict=True))[::COARSER]:
            rows = np.vstack([base, _unit(here)])
            kept, missed = _growth(said, rows, range(len(base), len(rows)), unknown)
            placed = (*none[:k], Placed(choice, values), *none[k + 1 :])
            tried.append(Sparse(tuple(r for r in kept if r < len(base)), placed, missed + unknown))
        found += sorted(tried, key=lambda one: one.dear)[:1]
    best = sorted(found, key=lambda one: one.dear)[:SHORTLIST]
    ends = [_leaner(seen, _fitted(seen, one, STEPS, unknown), unknown) for one in best]
    return sorted((e for e in ends if e.dear < unknown * DEARER**terms), key=lambda one: one.dear)


def beside(imitated: Imitated, given: Sequence[int], unknown: float) -> list[int]:
    """Return the rows of a base, of those that are given and others, that say a relation with the fewest terms.

    Args:
        imitated: what the relation says.
        given: rows to begin with.
        unknown: share of what is said that is not known.
    """
    seen, unknown = _thinned(imitated), max(unknown, SMALL)
    kept, missed = _growth(_unit(seen.said[None])[0], _unit(seen.base), given, unknown)
    return list(_leaner(seen, Sparse(tuple(kept), (), missed + unknown), unknown).kept)


def _thinned(imitated: Imitated) -> Imitated:
    every = -(-len(imitated.said) // LOOKED_AT)
    return Imitated(imitated.said[::every], imitated.base[:, ::every], imitated.samples.thinned(every))


def _unit(rows: FloatArray) -> FloatArray:
    """Return rows (b, N) of length 1."""
    scaled: FloatArray = rows / np.maximum(np.linalg.norm(rows, axis=1), 1e-300)[:, None]
    return scaled


def _growth(said: FloatArray, rows: FloatArray, given: Sequence[int], unknown: float) -> tuple[list[int], float]:
    """Return which rows say what is said, those given and others, and the share that they leave.

    Rows come one by one or in couples, neither of which may say much alone, while each halves what is left.

    Args:
        said: (N,) of length 1.
        rows: (b, N), each of length 1.
        given: rows to begin with.
        unknown: share of what is said that is not known.
    """
    kept, left = _grown(np.vstack([rows, said]), np.array(given, dtype=np.int64), unknown, DEARER)
    return kept.tolist(), float(left)


@kernel()
def _grown(rest: FloatArray, given: IntArray, unknown: float, dearer: float) -> tuple[IntArray, float]:
    """Return the rows that `_growth` keeps, and the share that they leave.

    Args:
        rest: (b + 1, N) the rows, what is said last; overwritten by what the rows that are kept leave of each.
        given: rows to begin with.
        unknown: share of what is said that is not known.
        dearer: times less that one row more has to leave.
    """
    b = len(rest) - 1
    kept, count = np.empty(b, dtype=np.int64), 0
    there = np.zeros(b, dtype=np.bool_)
    coming = [given[k] for k in range(len(given))]
    while True:
        for k in coming:
            kept[count], there[k] = k, True
            count += 1
            size = np.sqrt(np.dot(rest[k], rest[k]))
            if size > ROUNDING:
                own = rest[k] / size
                for i in range(b + 1):
                    rest[i] -= np.dot(rest[i], own) * own
        products = np.dot(rest, rest.T)
        left = max(products[b, b], 0.0)
        least, one, two = left + unknown, -1, -1
        for i in range(b):
            if there[i] or not products[i, i] > NOTHING_LEFT:
                continue
            alone = products[i, b] ** 2 / products[i, i]
            dear = (max(left - alone, 0.0) + unknown) * dearer
            if dear < least:
                least, one, two = dear, i, i
            for j in range(i):
                if there[j] or not products[j, j] > NOTHING_LEFT:
                    continue
                scale = np.sqrt(products[i, i] * products[j, j])
                both, other = products[i, j] / scale, products[j, b] ** 2 / products[j, j]
                apart = 1.0 - both**2
                if apart > NOTHING_LEFT:
                    together = alone + other - 2.0 * both * products[i, b] * products[j, b] / scale
                    dear = (max(left - together / apart, 0.0) + unknown) * dearer**2
                    if dear < least:
                        least, one, two = dear, j, i
        if one < 0:
            return kept[:count], left
        coming = [one] if one == two else [one, two]


def _promising(
    imitated: Imitated,
    choices: Sequence[Sequence[Choice]],
    placed: Sequence[Placed],
    bases: Sequence[Sequence[int]],
    unknown: float,
) -> list[Sparse]:
    """Return what comes near with one function more, each beside few terms or all, the best first.

    Beside all terms that may stand there many functions come near; beside few the right one does.

    Args:
        imitated: what the relation says.
        choices: the functions for every suspicion.
        placed: those that stand there.
        bases: rows of the base that may stand beside them.
        unknown: share of what is said that is not known.
    """
    found, whole = list[Sparse](), max(float(imitated.said @ imitated.said), 1e-300)
    for rows in bases:
        seen = replace(imitated, base=imitated.base[list(rows)])
        for k, among in enumerate(choices):
            if placed[k].choice.terms:
                continue
            for missed, one in seen.ranked(among, placed):
                left = missed / whole + unknown
                found.append(Sparse(tuple(rows), (*placed[:k], one, *placed[k + 1 :]), left))
    return _shortlisted(found, unknown)


def _shortlisted(found: Iterable[Sparse], unknown: float) -> list[Sparse]:
    """Return the best, and those beside them that leave nothing, the best first.

    What leaves nothing is no imitation, however much of what is said is not known.
    """
    ranked = sorted(found, key=lambda one: one.dear)
    same = [one for one in ranked[SHORTLIST:] if one.missed < unknown + SAME]
    return [*ranked[:SHORTLIST], *same[:SHORTLIST]]


def _couples(
    imitated: Imitated, choices: Sequence[Sequence[Choice]], bases: Sequence[Sequence[int]], unknown: float
) -> list[Sparse]:
    """Return the best two functions without constants, of two suspicions, beside few terms.

    Neither may come near alone, so that one after the other would not find them.

    Args:
        imitated: what the relation says.
        choices: the functions for every suspicion.
        bases: rows of the base that may stand beside them, all of them last.
        unknown: share of what is said that is not known.
    """
    none, found = Placed(Choice()), list[Sparse]()
    plain = [(k, Placed(c)) for k, among in enumerate(choices) for c in among if c.size == 1 and not c.constants]
    pairs = [(a, b) for a, b in combinations(plain, 2) if a[0] != b[0] and a[1].choice != b[1].choice]
    if not pairs:
        return []
    columns = {placed.choice: imitated.samples.at(placed)[0] for _, placed in plain}
    both = np.array([[columns[one.choice], columns[other.choice]] for (_, one), (_, other) in pairs])
    whole = max(float(imitated.said @ imitated.said), 1e-300)
    for rows in ((), *bases[:-1]):
        there, rest = imitated.beside(imitated.base[list(rows)])
        missed = np.sum(unexplained(rest, there, both) ** 2, axis=1) / whole + unknown
        for ((j, one), (k, other)), left in zip(pairs, missed.tolist(), strict=True):
            placed = tuple(one if i == j else other if i == k else none for i in range(len(choices)))
            found.append(Sparse(tuple(rows), placed, left))
    return sorted(found, key=lambda s: s.dear)[:COUPLES]


def _leaner(imitated: Imitated, found: Sparse, unknown: float) -> Sparse:
    """Return what is left where every row of the base goes that is worth less than a coefficient.

    Of what says the same in other words only a row goes without which it still does.

    Args:
        imitated: what the relation says.
        found: rows and functions.
        unknown: share of what is said that is not known.
    """
    off = found.missed - unknown
    hidden = min(unknown, SAME) if off < SAME else unknown
    found = replace(found, missed=off + hidden)
    while True:
        fewer = [replace(found, kept=tuple(k for k in found.kept if k != gone)) for gone in found.kept]
        ends = (_fitted(imitated, one, FEWER_STEPS, hidden) for one in fewer)
        best = min(ends, key=lambda one: one.dear, default=found)
        if not best.dear < found.dear:
            return _fitted(imitated, found, STEPS, unknown)
        found = best


def _fitted(imitated: Imitated, found: Sparse, steps: int, unknown: float) -> Sparse:
    """Return the same with the constants of its functions fitted.

    Args:
        imitated: what the relation says.
        found: rows and functions.
        steps: of the fit.
        unknown: share of what is said that is not known.
    """
    size = max(float(imitated.said @ imitated.said), 1e-300)
    squares, placed = imitated.fitted(found.placed, imitated.beside(imitated.base[list(found.kept)]), steps)
    return Sparse(found.kept, placed, squares / size + unknown)
