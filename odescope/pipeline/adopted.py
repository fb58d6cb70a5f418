"""Which candidate of every target is the model in the end, whatever led to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from odescope.model.model import Model
from odescope.model.relation import Relation
from odescope.pipeline.joint_models import Search
from odescope.selection.ranking import Candidate, Ranked, as_candidate

Adopted = tuple[Candidate | None, ...]  # of every target; None where the model's relation is no candidate


def adopted(searches: Sequence[Search], model: Model) -> tuple[tuple[Search, ...], Adopted]:
    """Return the candidate of every target that has the terms of the model, and the searches with it among theirs.

    Where the likelihood changed the terms that regression chose, or the study asked for so many, no search need have
    come upon them: they are then tried like any candidate and take their place in the ranking. There is none where the
    library of a target lacks one of the terms, as with relations that stand for mechanisms.

    Args:
        searches: one a target, or none at all.
        model: whose relations are looked for.
    """
    pairs = [_adopted(s, r) for s, r in zip(searches, model.shown_relations, strict=False)]
    return tuple(search for search, _ in pairs), tuple(candidate for _, candidate in pairs)


def columns_of(search: Search, relation: Relation) -> tuple[int, ...] | None:
    """Return the columns of the library that a relation's terms are, in order; None where it lacks one of them.

    Args:
        search: whose library it is.
        relation: with the names of constants.
    """
    place = {search.named.get(product, product): j for j, product in enumerate(search.problem.terms)}
    columns = [place.get(t.product) for t in relation.terms]
    return None if None in columns else tuple(j for j in columns if j is not None)


def _adopted(search: Search, relation: Relation) -> tuple[Search, Candidate | None]:
    columns = columns_of(search, relation)
    if columns is None:
        return search, None
    support = tuple(sorted(columns))
    known = next((c for c in search.ranked.candidates if tuple(sorted(c.support)) == support), None)
    if known is not None:
        return search, known
    found = as_candidate(search.problem, support, search.found)
    if found is None:
        return search, None
    ranked = _placed(search.ranked, found)
    return replace(search, ranked=ranked), next(c for c in ranked.candidates if c.support == support)


def _placed(ranked: Ranked, found: Candidate) -> Ranked:
    """Return the candidates with one more, as a family of its own before the first whose best it beats."""
    heads = {c.family: c for c in reversed(ranked.candidates)}
    place = next((f for f in sorted(heads) if heads[f].criterion > found.criterion), len(heads))
    before = [c for c in ranked.candidates if c.family < place]
    behind = [replace(c, family=c.family + 1) for c in ranked.candidates if c.family >= place]
    return replace(ranked, candidates=(*before, replace(found, family=place), *behind))
