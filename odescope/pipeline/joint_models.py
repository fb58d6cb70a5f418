"""From the candidates of every target to models: which relations go together, and which the likelihood adopted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations, product

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.library.expression import Term
from odescope.library.product import Product
from odescope.likelihood.refinement import Refinement
from odescope.model.denominators import denominator_ranges
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.regression.problem import Problem
from odescope.regression.proposers import MatchingPursuit, Support, exchanged
from odescope.regression.rows import ROWS_A_COLUMN
from odescope.selection.criterion import penalty
from odescope.selection.ranking import Candidate, Ranked, criteria, left_column
from odescope.selection.sweep import Sweep
from odescope.signals.estimate import Signals
from odescope.study.options import Study

FORWARD_TERMS = 6  # of a sparse forward selection that a search may begin from
TRIED = 4  # families a target that are tried when the best do not determine the targets together
NEARLY = 2.0  # times what the chosen relation misses of its target, and
LEAST_MISSED = 0.01  # of its weighted power: what a plain start may miss


@dataclass(frozen=True, eq=False)
class Search:
    """What was done for one target: its regression problem, all supports found, the ranked candidates.

    `inclusion` (m,) is the share of bootstrap replicates that chose each term, with the chosen relation's guess, None
    where none were drawn; `named` are terms with the names of constants, by those of the library that hold numbers for
    them.
    """

    problem: Problem
    found: Sweep
    ranked: Ranked
    removed: tuple[tuple[str, int], ...]
    inclusion: FloatArray | None = None
    named: Mapping[Product, Product] = field(default_factory=dict)


def to_relation(problem: Problem, candidate: Candidate) -> Relation:
    """Return a candidate as a relation, its target term with coefficient 1 first."""
    left = left_column(problem, candidate.support)
    columns = (left, *(j for j in candidate.support if j != left))
    return Relation(tuple(RelationTerm(problem.terms[j], float(candidate.xi[j])) for j in columns))


def proposals(
    study: Study, signals: Signals, searches: Sequence[Search]
) -> Iterator[tuple[tuple[Candidate, ...], Model]]:
    """Yield the relations of the best families that together determine the targets, and their model, best first.

    Args:
        study: says what a relation has to explain.
        signals: where denominators must not vanish.
        searches: one a target.
    """
    heads = []
    for s in searches:
        first = {c.family: c for c in reversed(s.ranked.candidates) if c.explained >= study.selection.explain}
        heads.append([first[f] for f in sorted(first)][:TRIED])
    order = sorted(product(*(range(len(h)) for h in heads)), key=sum)
    for pick in order:
        chosen = tuple(h[k] for h, k in zip(heads, pick, strict=True))
        pairs = permutations(zip(searches, chosen, strict=True), 2)
        if any(_say_the_same(*one, *other) for one, other in pairs):
            continue
        relations = tuple(to_relation(s.problem, c) for s, c in zip(searches, chosen, strict=True))
        model = Model(signals.coordinates, signals.inputs, relations)
        if determined(model, signals):
            yield chosen, model


def plain(search: Search, chosen: Candidate) -> Relation:
    """Return the shortest relation that holds its target bare and predicts it nearly as well; else the chosen one.

    Its denominator cannot vanish, and a search adds what it lacks more surely than it drops look-alikes.
    """
    problem, missed = search.problem, NEARLY * (1.0 - chosen.explained) + LEAST_MISSED
    bare = [
        c
        for c in search.ranked.candidates
        if set(c.support) & set(problem.own) == {problem.left} and 1.0 - c.explained <= missed
    ]
    return to_relation(problem, min(bare, key=lambda c: (len(c.support), c.criterion), default=chosen))


def forward(problem: Problem, terms: int = FORWARD_TERMS) -> Relation:
    """Return a forward selection of a relation that holds its simplest target term, fitted by regression."""
    return _selected(problem, problem.left, terms)


def of_degree(problem: Problem, degree: int) -> list[Relation]:
    """Return the bare target on all plain candidates up to a degree, and on a selection of them if that is less.

    Nothing where rows can decide between all candidates, or not even between these. Of few rows a selection among many
    candidates is chance; a search drops from all of a few what is not needed.

    Args:
        problem: of the target.
        degree: the largest total one.
    """
    support = tuple(j for j, t in enumerate(problem.terms) if t.factor is None and t.degree <= degree)
    if problem.factor.rows >= ROWS_A_COLUMN * len(problem.terms) or problem.factor.rows <= len(support):
        return []
    found = [_fitted(problem, problem.left, support)]
    if len(support) > FORWARD_TERMS:
        found.append(_selected(problem, problem.left, FORWARD_TERMS, support))
    return found


def rival(problem: Problem, candidates: Sequence[Candidate]) -> Relation | None:
    """Return the best forward selection that holds another target term, if none of simplest or candidates beats it.

    What a bare target and many terms come near enough to mislead a search, because each of the terms earns its place,
    a few terms beside another target term say better where the law has no bare target.

    Args:
        problem: of the target.
        candidates: what regression found for it; there may be nothing.
    """
    found = by_target_term(problem)
    least, best = min(found, key=lambda pair: pair[0])
    beaten = best is found[0][1] or any(c.criterion <= least for c in candidates)
    return None if beaten else best


def by_target_term(problem: Problem) -> list[tuple[float, Relation]]:
    """Return a forward selection that holds each of the target's terms, the simplest first, with what ranks it."""
    lefts = (problem.left, *(j for j in problem.own if j != problem.left))
    relations = [_selected(problem, left) for left in lefts]
    place = {term: j for j, term in enumerate(problem.terms)}
    found = criteria(problem, [tuple(sorted(place[t.product] for t in r.terms)) for r in relations])
    return list(zip(found.tolist(), relations, strict=True))


def _selected(problem: Problem, left: int, terms: int = FORWARD_TERMS, among: Support | None = None) -> Relation:
    """Return a sparse forward selection of a relation that holds one column of its target, and no other.

    Args:
        problem: of the target.
        left: that column.
        terms: how many are selected.
        among: the columns that may be; left out, all without the target.
    """
    others = tuple(j for j in range(len(problem.terms)) if j not in problem.own) if among is None else among
    path = list(MatchingPursuit(terms).supports(problem.factor, left, others))
    return _fitted(problem, left, exchanged(problem.factor, left, others, path[-1]))


def _fitted(problem: Problem, left: int, support: Support) -> Relation:
    """Return the relation of a column and those that explain it."""
    xi = problem.factor.solve((*support, left), left)
    return Relation(tuple(RelationTerm(problem.terms[j], float(xi[j])) for j in (left, *support)))


def _say_the_same(search: Search, chosen: Candidate, other_search: Search, other: Candidate) -> bool:
    """Say whether another target's relation, solved for this target, is this relation again but for the noise.

    As among families: their difference is no larger than one term more has to earn.
    """
    problem, factor = search.problem, search.problem.factor
    xi = {other_search.problem.terms[j]: float(other.xi[j]) for j in other.support}
    left = left_column(problem, chosen.support)
    if not xi.get(problem.terms[left]) or not set(xi) <= set(problem.terms):
        return False
    same = np.array([xi.get(term, 0.0) for term in problem.terms]) / xi[problem.terms[left]]
    noise = max(factor.residual(chosen.xi), 1e-10 * float(factor.scale[left]) / np.sqrt(factor.rows))
    allowed = float(penalty(factor.rows, 1.0 / factor.width)) / factor.rows
    return bool(factor.residual(chosen.xi - same) ** 2 <= allowed * noise**2)


def adopt(
    regressed: Callable[[], Model | None], refinement: Refinement | None, signals: Signals
) -> tuple[Model | None, Refinement | None]:
    """Return the model of the likelihood stage where it follows the record, else that of the regression.

    A refinement whose denominators vanish inside the data is dropped: its errors are those of another model. Before,
    what is a factor of all terms of a relation is divided out.

    Args:
        regressed: gives the model of the regression, where that found one.
        refinement: what the likelihood stage returned.
        signals: where denominators must not vanish.
    """
    if refinement is None:
        return regressed(), None
    if not refinement.follows and (model := regressed()) is not None:
        return model, refinement
    relations, mechanisms = refinement.relations, refinement.mechanisms
    if not mechanisms:
        relations = tuple(map(without_common_reciprocal, relations))
    if not refinement.follows:
        relations = tuple(Relation(tuple(replace(t, std_error=None) for t in r.terms)) for r in relations)
        mechanisms = tuple(msgspec.structs.replace(m, std_error=None) for m in mechanisms)
    found = refinement.settings
    refined = Model(
        found.coordinates(signals.coordinates),
        found.inputs(signals.inputs),
        relations,
        mechanisms=mechanisms,
        parameters=found.parameters,
    )
    if determined(refined, signals):
        return refined, refinement
    primitive = replace(refined, relations=tuple(without_common_factor(r) for r in relations))
    return (primitive, refinement) if not mechanisms and determined(primitive, signals) else (regressed(), None)


def without_common_factor(relation: Relation) -> Relation:
    """Return a relation divided by what is a factor of all its terms: it says the same, but where that factor is 0.

    So y x_dot = 3 x y - x^2 y, whose denominator vanishes where noise takes the last of a species y below nothing,
    becomes x_dot = 3 x - x^2.
    """
    terms = [t.term for t in relation.terms]
    powers = {atom: min(t.power_of(atom) for t in terms) for atom, _ in terms[0].factors}
    inverse = Term.of((atom, -power) for atom, power in powers.items() if power > 0)
    return relation.times(inverse)


def without_common_reciprocal(relation: Relation) -> Relation:
    """Return a relation multiplied by what divides every term with a target: x_dot y/x = z is x_dot y = x z."""
    left = [t.term for t in relation.left]
    powers = {atom: max(t.power_of(atom) for t in left) for atom, _ in left[0].factors} if left else {}
    return relation.times(Term.of((atom, -power) for atom, power in powers.items() if power < 0))


def samples_of(signals: Signals, model: Model) -> list[FloatArray]:
    """Return the states and inputs of a model (variables, n), one array a record."""
    index = [signals.row(name) for name in model.variables]
    return [columns[index] for columns in signals.columns]


def determined(model: Model, signals: Signals) -> bool:
    """Say whether no denominator of the explicit form vanishes or changes sign inside the data."""
    try:
        ranges = denominator_ranges(model, np.concatenate(samples_of(signals, model), axis=1), np.random.default_rng(0))
    except InputError:
        return False
    return all(r["data"][0] * r["data"][1] > 0.0 for r in ranges.values())
