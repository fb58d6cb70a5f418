"""SINDy-PI: every column a guess, every proposer, and the consensus among what they find (paper, 2.4 and 4.3, 4.4)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import sub

import numpy as np

from odescope.arrays import BoolArray, IntArray
from odescope.library.product import Product
from odescope.parallel.workers import Threads, nothing
from odescope.regression.factor import Factor
from odescope.regression.proposers import Proposer, Support


@dataclass(frozen=True)
class Sweep:
    """Distinct supports of implicit relations, guess included, and the guesses that found each."""

    supports: tuple[Support, ...]
    guesses: tuple[tuple[int, ...], ...]
    width: int

    def activation(self) -> BoolArray:
        """Return the activation vectors, (supports, m)."""
        active = np.zeros((len(self.supports), self.width), dtype=np.bool_)
        for row, support in enumerate(self.supports):
            active[row, list(support)] = True
        return active

    def distances(self) -> IntArray:
        """Return the activation distance (L1) between every two supports, (supports, supports)."""
        active = self.activation().astype(np.float64)  # whole numbers have no fast product of matrices
        ones = active.sum(axis=1)
        distance: IntArray = (ones[:, None] + ones[None, :] - 2.0 * active @ active.T).astype(np.int64)
        return distance

    def clusters(self, distance: float = 2.0) -> IntArray:
        """Return a label for each support: average linkage on the activation distance, cut at `distance`."""
        if len(self.supports) < 2:
            return np.ones(len(self.supports), dtype=np.int64)
        # Imported here: it costs a quarter of a second that commands without a sweep need not wait for.
        from scipy.cluster.hierarchy import fcluster, linkage
        from scipy.spatial.distance import squareform

        tree = linkage(squareform(self.distances()), "average")
        labels: IntArray = fcluster(tree, distance, "distance").astype(np.int64)
        return labels

    def including(self, support: Support) -> Sweep:
        """Return the sweep with one support more, as if every column of it had been the guess."""
        others = self.restrict([k for k, found in enumerate(self.supports) if found != support])
        return Sweep((*others.supports, support), (*others.guesses, support), self.width)

    def restrict(self, keep: Sequence[int]) -> Sweep:
        """Return the sweep with these supports only."""
        return Sweep(tuple(self.supports[k] for k in keep), tuple(self.guesses[k] for k in keep), self.width)


def sweep(
    factor: Factor,
    terms: Sequence[Product],
    nested: Sequence[Support],
    proposers: Sequence[Proposer],
    check: Callable[[], None] = nothing,
    guesses: Iterable[int] | None = None,
) -> Sweep:
    """Return all supports that the proposers find with each column in turn as the left-hand side, (15).

    Args:
        factor: of the library.
        terms: the library's m products.
        nested: sets of columns to search in, the whole library among them (see `nested_libraries`).
        proposers: searched with, one after the other.
        check: called several times a second; what it raises ends the sweep.
        guesses: columns for the left-hand side; None for all.
    """
    quotients = Quotients(terms)
    found: dict[Support, dict[int, None]] = {}

    def search(guess: int) -> list[Support]:
        return [
            support
            for columns in nested
            if guess in columns
            for p in proposers
            for support in p.supports(factor, guess, columns)
        ]

    sides = list(range(factor.width) if guesses is None else guesses)
    for guess, supports in zip(sides, Threads().map(search, sides, check=check), strict=True):
        for support in dict.fromkeys(supports):
            divided = quotients.primitive((*support, guess))
            found.setdefault(tuple(sorted(divided.values())), {})[divided[guess]] = None
    return Sweep(tuple(found), tuple(tuple(g) for g in found.values()), factor.width)


def nested_libraries(terms: Sequence[Product], own: Sequence[int]) -> tuple[Support, ...]:
    """Return the columns up to each total degree, and those without a product of the target.

    A true relation times any function is a relation too, and a rich library holds several such multiples: their
    mixtures hide the simple one. A smaller library holds fewer.

    Args:
        terms: the library's m products.
        own: columns that hold the target.
    """
    degrees = [p.degree for p in terms]
    sets = [tuple(j for j, d in enumerate(degrees) if d <= limit) for limit in sorted(set(degrees)) if limit > 0]
    explicit = tuple(j for j, d in enumerate(degrees) if j not in own or d == 0)
    return tuple(s for s in dict.fromkeys([explicit, *sets]) if len(s) > 1 and set(s) & set(own))


class Quotients:
    """A library's products as powers of their atoms, by which relations are divided.

    There are thousands of supports, and products of terms as objects take longer than the searches that find these.
    """

    def __init__(self, terms: Sequence[Product]) -> None:
        atoms = dict.fromkeys(atom for p in terms for atom, _ in p.term.factors)
        self._powers = [tuple(p.term.power_of(atom) for atom in atoms) for p in terms]
        self._atoms = [sum(1 << k for k, power in enumerate(powers) if power > 0) for powers in self._powers]
        self._targets = [p.factor for p in terms]
        self._place = {key: j for j, key in enumerate(zip(self._targets, self._powers, strict=True))}

    def primitive(self, support: Support) -> dict[int, int]:
        """Return what each column of a relation becomes when what is common to all its terms is divided out.

        Both relations say the same of the target; where the library lacks a quotient the relation stays as it is.

        Args:
            support: columns of the relation.
        """
        as_it_is, targets = dict(zip(support, support, strict=True)), {self._targets[j] for j in support}
        shared = -1  # a bit for each atom that all terms hold
        for j in support:
            shared &= self._atoms[j]
        if not shared and (len(targets) > 1 or None in targets):
            return as_it_is
        common = [max(0, min(powers)) for powers in zip(*(self._powers[j] for j in support), strict=True)]
        quotients = dict[int, int]()
        for j in support:
            target = self._targets[j] if len(targets) > 1 else None
            found = self._place.get((target, tuple(map(sub, self._powers[j], common))))
            if found is None:
                return as_it_is
            quotients[j] = found
        return quotients
