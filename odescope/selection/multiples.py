"""Relations that stand for a law divided by a variable.

What grows in proportion to itself, x' = x (a - b y) / (1 + c x), has the variable in all terms but those of its
target. Divided by it the law has fewer powers, and a polynomial that stands for 1/x beside the target: of a rich
library a sweep finds that first. Multiplied again, and rid of what is too much, it is the law.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np

from odescope.library.expression import Term
from odescope.regression.problem import Problem
from odescope.regression.proposers import BackwardElimination, Support
from odescope.selection.ranking import Candidate, criteria

LOOKED_AT = 3  # of the best candidates
MOST = 400  # relations that compete, those of the best candidate first


def multiplied(problem: Problem, candidates: Sequence[Candidate]) -> Support | None:
    """Return the relation that beats all candidates, if one of the best is this divided by a variable.

    Args:
        problem: of the target.
        candidates: of its relations, best first.
    """
    if not candidates or len(set(candidates[0].support) & set(problem.own)) < 2:
        return None  # where the best has its target by itself, what others have beside theirs is no matter
    found = (s for c in candidates[:LOOKED_AT] for s in _multiplied(problem, c.support))
    supports = list(dict.fromkeys(islice(found, MOST)))
    if not supports:
        return None
    ranks = criteria(problem, supports)
    best = int(np.argmin(ranks))
    return supports[best] if ranks[best] < candidates[0].criterion else None


def _multiplied(problem: Problem, support: Support) -> Iterator[Support]:
    """Yield what is left of a relation when its plain terms are multiplied by what its target is multiplied by."""
    own = [j for j in support if j in problem.own]
    if len(own) < 2:
        return
    place = {term: j for j, term in enumerate(problem.terms)}
    for atom in dict.fromkeys(atom for j in own for atom, _ in problem.terms[j].term.factors):
        by = Term(((atom, 1),))
        times = (place.get(problem.terms[j] * by) for j in support if j not in own)
        columns = tuple(sorted({*own, problem.left, *(j for j in times if j is not None)}))
        for guess in columns:
            for rest in BackwardElimination().supports(problem.factor, guess, columns):
                whole = tuple(sorted((*rest, guess)))
                if len(whole) > 2 and set(whole) & set(own):
                    yield whole
