"""Searches once more with short steps, where the model that coarse steps led to owes them what it promised.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence

from odescope.arrays import FloatArray
from odescope.likelihood.held_out import thinned
from odescope.likelihood.search import Outcome, in_whole
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import joined, searches
from odescope.likelihood.steps import with_finer_steps
from odescope.parallel.workers import Workers

OWED = 10.0  # rise of cost and price with shorter steps: what was found was fitted to the errors of coarse ones
ENOUGH = 4  # steps of RK4 a block average, at most, of these searches: at the end they are halved again


def with_steps_settled(
    space: SearchSpace, best: Outcome, begun: Sequence[FloatArray], workers: Workers
) -> tuple[SearchSpace, Outcome]:
    """Return space and end of the searches with steps so short that they no longer matter.

    Steps are chosen for a start, and a start that is far from the record does not depend on them. A search may then
    end in terms that make up for the errors of coarse steps: all starts are searched from again with finer ones.

    Args:
        space: with the steps of the searches.
        best: their best end, which follows the record.
        begun: (mechanisms,) coefficients of each start.
        workers: where it is searched.
    """
    fine, end = with_finer_steps(space, best)
    if (joined(end) and end.penalised <= best.penalised + OWED) or space.budget.over:
        return fine, end
    short = fine.finer(min(fine.evaluator.substeps, ENOUGH))
    seen = short.on(thinned(short.segments))
    outcomes = searches(seen, [end.fit.theta, *begun], None, space.budget.monitor, workers)
    space.budget.spent += sum(o.spent for o in outcomes)
    again = min(outcomes, key=lambda o: o.rank, default=None)
    if again is not None and len(seen.segments.start) < len(short.segments.start):
        again = in_whole(short.with_constants(again.constants), again)
    if again is None or not joined(again):
        return fine, end
    other, anew = with_finer_steps(short.with_constants(again.constants), again)
    return (other, anew) if anew.rank < end.rank or not joined(end) else (fine, end)
