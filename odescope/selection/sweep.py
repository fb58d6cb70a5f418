"""SINDy-PI: every column a guess, every proposer, and the consensus among what they find (paper, 2.4 and 4.3, 4.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.cluster.hierarchy
from scipy.spatial.distance import pdist

from odescope.arrays import BoolArray, IntArray
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
        active = self.activation().astype(np.int64)
        ones = active.sum(axis=1)
        distance: IntArray = ones[:, None] + ones[None, :] - 2 * active @ active.T
        return distance

    def clusters(self, distance: float = 2.0) -> IntArray:
        """Return a label for each support: average linkage on the activation distance, cut at `distance`."""
        if len(self.supports) < 2:
            return np.ones(len(self.supports), dtype=np.int64)
        linkage = scipy.cluster.hierarchy.linkage(pdist(self.activation(), "cityblock"), "average")
        labels: IntArray = scipy.cluster.hierarchy.fcluster(linkage, distance, "distance").astype(np.int64)
        return labels

    def restrict(self, keep: Sequence[int]) -> Sweep:
        """Return the sweep with these supports only."""
        return Sweep(tuple(self.supports[k] for k in keep), tuple(self.guesses[k] for k in keep), self.width)


def sweep(factor: Factor, proposers: Sequence[Proposer]) -> Sweep:
    """Return all supports that the proposers find with each column in turn as the left-hand side, (15)."""
    columns = tuple(range(factor.width))
    found: dict[Support, dict[int, None]] = {}
    for guess in columns:
        for proposer in proposers:
            for support in proposer.supports(factor, guess, columns):
                found.setdefault(tuple(sorted((*support, guess))), {})[guess] = None
    return Sweep(tuple(found), tuple(tuple(g) for g in found.values()), factor.width)
