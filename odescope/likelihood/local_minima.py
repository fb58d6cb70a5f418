"""A trajectory that is joined may hang in a local minimum of the cost: it is opened and joined once more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.likelihood.add_and_drop import GAIN
from odescope.likelihood.fit import Fit
from odescope.likelihood.search import WIDTHS, Outcome, fitted_again, settle_again
from odescope.likelihood.search_space import SearchSpace

CERTAIN = 30.0  # standard errors: what is known so well in every relation makes up for no wrong constant
OPENED = 0.1  # width of the defects, in smoothing errors of each state, at which a trajectory leaves a local minimum


def out_of_local_minima(space: SearchSpace, outcome: Outcome) -> Outcome:
    """Return the end of a search in a lower minimum of the cost where there is one.

    Args:
        space: data, candidates.
        outcome: the end of the search.
    """
    return _without_shared(space, joined_again(space, outcome))


def joined_again(space: SearchSpace, outcome: Outcome) -> Outcome:
    """Return the end of a search, with the same terms in a lower minimum of the cost where there is one.

    Where states change fast, as in a reactor that ignites, a joined trajectory of many samples is held by where it is:
    its segments move towards each other's ends again from where each fits its own samples. Terms whose case is thin
    then are tested again.

    Args:
        space: data, candidates.
        outcome: the end of the search.
    """
    found = outcome.fit
    for width in (w for w in WIDTHS if outcome.width <= w <= OPENED):
        again = space.again(found, found.x0, space.segments.spread * width)
        if again is None:
            return outcome
        found = again
    if not found.cost < outcome.fit.cost - GAIN:
        return outcome
    end = fitted_again(space, outcome, found)
    return end if end.clear else settle_again(space, end, found)


def _without_shared(space: SearchSpace, outcome: Outcome) -> Outcome:
    """Return the end of a search without a function that several relations hold, where that costs less.

    A rate stands in several balances. What hangs at a wrong constant makes up for it by another rate with it, in as
    many balances: each by itself is sure there, and segments have to part to get away.

    Args:
        space: data, candidates.
        outcome: the end of the search.
    """
    for own in _shared(space, outcome.fit):
        found = _refitted_without(space, outcome, own)
        if found is not None and found.cost + space.price(found) < outcome.fit.cost + space.price(outcome.fit):
            outcome = fitted_again(space, outcome, found)
    return outcome


def _refitted_without(space: SearchSpace, outcome: Outcome, own: Sequence[int]) -> Fit | None:
    """Return the fit of an end without some mechanisms, segments opened and joined again; None where it is lost.

    Args:
        space: data, candidates.
        outcome: the end of a search.
        own: numbers of the mechanisms.
    """
    theta, x0, found = outcome.fit.theta.copy(), outcome.fit.x0, None
    theta[own], present = 0.0, np.setdiff1d(outcome.fit.present, own)
    for width in (w for w in WIDTHS if outcome.width <= w < np.inf):
        found = space.fit(theta, present, x0, space.segments.spread * width)
        if found is None:
            return None
        theta, x0 = found.theta, found.x0
    return found


def _shared(space: SearchSpace, found: Fit) -> list[list[int]]:
    """Return the mechanisms that hold one function with constants in several relations, function by function.

    What is certain beyond doubt in all of them makes up for nothing.

    Args:
        space: the candidates.
        found: the model.
    """
    shared, doubtful = dict[str, list[int]](), set[str]()
    for k, wald in zip(found.free.tolist(), found.wald.tolist(), strict=True):
        parts = space.mechanisms[k].parts
        if len(parts) == 1 and not parts[0].product.term.names.isdisjoint(space.needed):
            shared.setdefault(parts[0].product.text, []).append(k)
            doubtful |= {parts[0].product.text} if wald < CERTAIN**2 else set()
    return [own for text, own in shared.items() if len(own) > 1 and text in doubtful]
