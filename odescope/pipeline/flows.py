"""Flows between levels or pressures, which go with the root of a difference: a small library that is tried first.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations, product

from odescope.events import Progress
from odescope.library.expression import Atom, Call, Term
from odescope.library.pairs import signed_root
from odescope.likelihood.refinement import Refinement
from odescope.model.relation import Relation
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.units import units_of
from odescope.pipeline.wider import (
    basis_of,
    evidently_better,
    promises,
    regressed_with,
    searched_with,
    settles,
    with_basis,
    with_extra,
)
from odescope.pipeline.work import Work
from odescope.signals.estimate import Signals


def flows(work: Work, filtered: Filtered, regressed: Regressed) -> tuple[Posed, Refinement] | None:
    """Return relations in roots of levels and of their differences, and their model; None where these promise nothing.

    What flows between two tanks goes with the root of the difference of their levels, signed as that is, and stands in
    the balances of both. Products of levels imitate it, by more terms than can be looked through one function at a
    time. With levels, inputs and these roots, also times an input as the opening of a valve, a library is small.
    Nothing is tried where no state is positive, there is an angle or a second order, or a library was written by hand.

    Args:
        work: whose study says of which states and inputs functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression in the default library found.
    """
    study, coordinates = work.study, filtered.signals.coordinates
    alike = all(c.order == 1 and not c.angle for c in coordinates)
    if study.library.by_hand or not alike or not study.suspects or not filtered.sample.complete:
        return None
    linear = with_basis(work, basis_of(study), 1)
    wides = [with_extra(linear, extra) for extra in _libraries(work, filtered)]
    tried = [
        (wide, found) for wide in wides if (found := regressed_with(wide, filtered)) and promises(found, regressed)
    ]
    of_flows = [t for t in tried if any(map(_of_flows, t[1].relations))]
    best: tuple[Posed, Refinement] | None = None
    for wide, found in sorted(of_flows, key=lambda t: sum(len(r.terms) for r in t[1].relations)):
        work.monitor.tell(Progress("suspicion", "search with flows between levels", 0, 1))
        posed, refinement = searched_with(wide, filtered, found, None)
        if refinement is not None and (best is None or evidently_better(refinement, best[1])):
            best = posed, refinement
        if best is not None and conclusive(best[1], filtered.signals):
            break
    return best


def conclusive(refinement: Refinement, signals: Signals) -> bool:
    """Say whether a model of flows, and of nothing else in their place, leaves nothing to look for.

    Args:
        refinement: whose model it is.
        signals: the targets as they were measured.
    """
    rooted = [r for r in refinement.relations if _roots(r)]
    if not rooted or not all(map(_of_flows, rooted)):
        return False
    return settles(refinement, signals)


def _of_flows(relation: Relation) -> bool:
    """Say whether a relation holds roots, and what is in them nowhere else: a root and its variable imitate others."""
    roots = _roots(relation)
    outside = (a for t in relation.terms for a, _ in t.product.term.factors if a not in roots)
    return bool(roots) and _names(roots).isdisjoint(_names(outside))


def _roots(relation: Relation) -> set[Atom]:
    """Return the functions of a relation: all are roots, or signs of what these are of."""
    return {a for t in relation.terms for a, _ in t.product.term.factors if isinstance(a, Call)}


def _names(atoms: Iterable[Atom]) -> frozenset[str]:
    """Return what some functions and variables hold."""
    return Term(tuple((a, 1) for a in atoms)).names


def _libraries(work: Work, filtered: Filtered) -> Iterator[tuple[str, ...]]:
    """Yield roots of positive states and of differences, those from inputs aside or too, alone and times inputs."""
    signals, units = filtered.signals, units_of(filtered)
    least = dict(zip(signals.names, signals.joined().min(axis=1), strict=True))
    positive = [n for n in work.study.suspects if least[n] > 0.0]
    levels = [n for n in positive if n in signals.states]
    if not levels:
        return
    roots = [f"sqrt({n})" for n in levels]
    roots += [signed_root(*pair) for pair in combinations(levels, 2) if _alike(units, pair)]
    sources = product(levels, (n for n in positive if n not in levels))
    from_sources = [signed_root(*pair) for pair in sources if _alike(units, pair)]
    openings = [n for n in work.study.suspects if n in work.study.inputs]
    for every in dict.fromkeys((tuple(roots), (*roots, *from_sources))):
        yield every
        if openings:
            yield (*every, *(f"{opening}*{root}" for opening, root in product(openings, every)))


def _alike(units: Mapping[str, str | None], names: Iterable[str]) -> bool:
    """Say whether names may be of one unit."""
    return len({units[n] for n in names} - {None}) < 2
