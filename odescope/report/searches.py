"""The library and the candidates of every target as plain data."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.model.quantity_units import quantity_units, shown
from odescope.pipeline.identification import Identification
from odescope.pipeline.joint_models import Search
from odescope.report.data import (
    Correlations,
    Dependent,
    Point,
    Row,
    RuleCount,
    Searched,
)
from odescope.selection.ranking import Candidate

MOST_ROWS = 40  # candidates in the grid
MOST_COLUMNS = 60  # terms in the grid: a candidate with others is left out
MOST_CORRELATED = 80  # terms in the matrix of correlations
MOST_POINTS = 400
LEAST_INCLUSION = 0.1  # of a term that is listed
MOST_LISTED = 60  # dependent terms


def searched(result: Identification) -> tuple[Searched, ...]:
    """Return what was searched for every target."""
    units = quantity_units(result.model)
    return tuple(
        _searched(search, chosen, shown(units[target]))
        for search, chosen in zip(result.searches, result.chosen, strict=False)
        for target in (search.problem.target,)
    )


def _searched(search: Search, chosen: Candidate | None, unit: str) -> Searched:
    problem, ranked = search.problem, search.ranked.candidates
    texts = [term.text for term in problem.terms]
    columns, rows = _grid(search, chosen, texts)
    removed = sum(count for _, count in search.removed)
    return Searched(
        target=problem.target,
        unit=unit,
        products=len(problem.terms) + removed + len(problem.dependent),
        rules=tuple(RuleCount(rule=rule, removed=count) for rule, count in search.removed),
        terms=len(problem.terms),
        dependent=tuple(
            Dependent(term=term.text, others=tuple(o.text for o in others[:MOST_LISTED]))
            for term, others in problem.dependent[:MOST_LISTED]
        ),
        correlations=_correlations(search),
        found=len(search.found.supports),
        kept=len(ranked),
        discarded=search.ranked.discarded,
        columns=tuple(texts[j] for j in columns),
        rows=rows,
        points=tuple(
            Point(terms=len(c.support), rmse=c.target_rmse, chosen=c is chosen)
            for c in sorted(ranked, key=lambda c: c is not chosen)[:MOST_POINTS]
        ),
        inclusion=() if search.inclusion is None else _included(search.inclusion, texts),
        adopted=chosen is not None,
    )


def _included(inclusion: FloatArray, texts: list[str]) -> tuple[tuple[str, float], ...]:
    """Return the terms that many bootstrap replicates chose, most often chosen first."""
    order = np.argsort(-inclusion, kind="stable")
    return tuple((texts[j], float(inclusion[j])) for j in order if inclusion[j] >= LEAST_INCLUSION)


def _grid(search: Search, chosen: Candidate | None, texts: list[str]) -> tuple[list[int], tuple[Row, ...]]:
    """Return the columns and rows of the grid: the chosen candidate, and the best that its columns have room for."""
    ranked = search.ranked.candidates
    best, used = list[Candidate](), set[int]()
    for c in (*([] if chosen is None else [chosen]), *ranked):
        if len(used | set(c.support)) <= MOST_COLUMNS and len(best) < MOST_ROWS and not any(c is b for b in best):
            best.append(c)
            used |= set(c.support)
    rank = {id(c): k for k, c in enumerate(ranked)}
    best.sort(key=lambda c: rank[id(c)])
    columns = sorted(used)
    return columns, tuple(
        Row(
            rank=1 + rank[id(c)],
            family=c.family + 1,
            guess=texts[c.guess],
            rmse=c.target_rmse,
            criterion=c.criterion,
            consensus=len(c.guesses),
            chosen=c is chosen,
            signs="".join("." if j not in c.support else "+" if c.xi[j] >= 0 else "-" for j in columns),
        )
        for c in best
    )


def _correlations(search: Search) -> Correlations:
    """Return the cosines between the candidate terms; of a large library between those that are most alike."""
    cosines = search.problem.factor.gram
    alike = np.abs(cosines - np.diag(np.diag(cosines))).max(axis=1, initial=0.0)
    kept = np.sort(np.argsort(-alike, kind="stable")[:MOST_CORRELATED])
    percent = np.clip(np.rint(100.0 * cosines[np.ix_(kept, kept)]), -100, 100).astype(int)
    return Correlations(
        terms=tuple(search.problem.terms[j].text for j in kept),
        percent=tuple(tuple(row) for row in percent.tolist()),
        left_out=len(cosines) - len(kept),
    )
