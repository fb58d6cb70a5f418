"""The rate of one balance in the others: what one reaction turns over stands in several, with the same constants.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import msgspec

from odescope.events import Progress
from odescope.library.expression import ONE, Combination, Name
from odescope.library.families import BELOW, HALF
from odescope.likelihood.refinement import Refinement
from odescope.model.explicit import Quotient
from odescope.model.relation import Relation
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import relations_form
from odescope.pipeline.stages import refine_form
from odescope.pipeline.wider import (
    LEAST,
    TIMES,
    basis_of,
    evidently_better,
    regressed_with,
    with_basis,
    with_extra,
    within,
)
from odescope.pipeline.work import Work
from odescope.recordings.coordinate import free_name
from odescope.study.library_options import Span

DEGREE = 2  # of the products beside rates: what flows goes with an amount
CLOSE = 1.3  # times what a constant of a rate was found to be: its range
MOST_ABOVE, MOST_BELOW = 2, 2  # terms of a rate's numerator, and of its denominator beside 1, at most


def with_shared_rates(work: Work, filtered: Filtered, refinement: Refinement | None) -> Refinement | None:
    """Return the model with the rates of some balances in others, where that is evidently better.

    What grows on a substrate takes it up at the same rate, and where two terms of a balance saturate, each by its own
    amount, no fraction of few terms says it; the balances of these amounts have one of the two each. A fraction of few
    terms that a model holds, less what stands outside of it, is a candidate of every balance, its constants open.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        refinement: the model so far, if there is one.
    """
    study, signals = work.study, filtered.signals
    several = len(signals.targets) > 1 and all(c.order == 1 for c in signals.coordinates)
    if refinement is None or not (refinement.follows and several and filtered.sample.complete) or study.library.by_hand:
        return refinement
    taken = {*signals.names, *signals.targets, *study.parameters}
    least = dict(zip(signals.names, signals.joined().min(axis=1).tolist(), strict=True))
    rates = dict[str, Mapping[str, Span]]()
    for relation, target in zip(refinement.relations, signals.targets, strict=True):
        for text, spans in _rates(relation, target, taken, least):
            rates[text] = spans
            taken |= set(spans)
    if not rates:
        return refinement
    found = regressed_with(wide := _with_rates(work, rates), filtered)
    if found is None:
        return refinement
    work.monitor.tell(Progress("suspicion", "search with the rates of some balances in others", 0, 1))
    limited = within(wide, max(LEAST, TIMES * refinement.spent))
    posed = relations_form(wide.study, (found, *found.elsewhere), lambda _: found)
    other = refine_form(limited, filtered, posed)
    return other if other is not None and evidently_better(other, refinement) else refinement


def leaves_imitation(shared: Refinement, apart: Refinement) -> bool:
    """Say whether a model with shared rates has other terms of the same variables beside one: half of an imitation.

    Args:
        shared: the model.
        apart: that before rates were shared, or the same.
    """
    if shared is apart:
        return False
    constants = frozenset(shared.space.frame.constants)
    parts = [p for k in shared.fit.present for p in shared.space.mechanisms[k].parts if p.product.factor is None]
    names = [(p.relation, p.product.term.names) for p in parts]
    rates = {(r, of - constants) for r, of in names if of & constants}
    return any((r, of) in rates for r, of in names)


def _with_rates(work: Work, rates: Mapping[str, Mapping[str, Span]]) -> Work:
    """Return the work for a study with rates among its candidates, and ranges for the constants in them."""
    wide = with_extra(with_basis(work, basis_of(work.study), DEGREE), tuple(rates))
    spans = {name: span for of in rates.values() for name, span in of.items()}
    library = msgspec.structs.replace(wide.study.library, parameters=spans)
    return replace(wide, study=msgspec.structs.replace(wide.study, library=library))


def _rates(
    relation: Relation, target: str, taken: Collection[str], least: Mapping[str, float]
) -> Iterator[tuple[str, dict[str, Span]]]:
    """Yield each term of a fraction as text, and the ranges of its constants, where it may be a rate.

    Args:
        relation: of a model.
        target: that it is solved for.
        taken: names that constants may not have.
        least: values of variables on the data.
    """
    if relation.targets != (target,):
        return
    above = Combination(tuple((-c, t) for c, t in relation.part(None).parts))
    rest = Quotient(target, above, relation.part(target)).apart
    below = [(c, t) for c, t in rest.denominator.parts if t != ONE]
    simple = len(rest.numerator.parts) <= MOST_ABOVE and 0 < len(below) <= MOST_BELOW
    plain = all(isinstance(a, Name) for _, t in rest.numerator.parts for a, _ in t.factors)
    if not (simple and plain) or any(c <= 0.0 or t.text not in least for c, t in below):
        return
    if CLOSE * sum(c * max(-least[t.text], 0.0) for c, t in below) >= 1.0:  # a pole on the data
        return
    if len(below) == 1:  # as chemists write a rate that saturates
        ((c, t),) = below
        half = free_name(f"{HALF}_{t.text}", taken)
        sides, found = f"{half} + {t.text}", {half: 1.0 / c}
    else:
        found = {free_name(f"{BELOW}_{t.text}", taken): c for c, t in below}
        sides = " + ".join(["1", *(f"{name}*{t.text}" for name, (_, t) in zip(found, below, strict=True))])
    spans: dict[str, Span] = {name: (value / CLOSE, value * CLOSE) for name, value in found.items()}
    for _, t in rest.numerator.parts:
        yield f"{t.text}/({sides})", spans
