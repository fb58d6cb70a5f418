"""A trajectory that is joined may hang in a local minimum of the cost: it is opened and joined once more."""

from __future__ import annotations

from odescope.likelihood.add_and_drop import GAIN
from odescope.likelihood.search import WIDTHS, Outcome, fitted_again, settle_again
from odescope.likelihood.search_space import SearchSpace

OPENED = 0.1  # width of the defects, in smoothing errors of each state, at which a trajectory leaves a local minimum


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
