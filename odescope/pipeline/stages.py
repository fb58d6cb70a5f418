"""The stages of an identification after the signals, in their order: each takes what the ones before it found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import msgspec
import numpy as np

from odescope.errors import NoModelError
from odescope.library.candidates import Library
from odescope.likelihood.refine import refine
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.settings import Starts
from odescope.model.model import Model
from odescope.pipeline.constants import Substituted
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.joint_models import Search, proposals
from odescope.pipeline.reduce import Plan, Whole, reduce_all
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.work import Work, nested, swept
from odescope.regression.problem import Problem, pose
from odescope.selection.bootstrap import inclusion
from odescope.selection.multiples import multiplied
from odescope.selection.ranking import Candidate, ranking, require_law
from odescope.signals.estimate import Signals
from odescope.signals.placeholders import placeholders
from odescope.study.library_options import Form

Chosen = tuple[Candidate, ...]  # one candidate a target


def pose_all(work: Work, libraries: Sequence[Library], filtered: Filtered) -> tuple[tuple[Problem, ...], Whole | None]:
    """Return the regression problem of each target, and what is kept of recordings that do not fit in memory.

    Args:
        work: whose study says how rows are made.
        libraries: one a target.
        filtered: the signals of the recordings, or of a sample of them.

    Raises:
        InputError: a candidate is not finite, or a chunk cannot be read.
    """
    study, sample = work.study, filtered.sample
    with work.stage("regression"):
        problems = tuple(
            pose(filtered.signals, c.target, c.order, library, study.regression.rows, sample.folds)
            for c, library in zip(study.measured(), libraries, strict=True)
        )
    if sample.complete:
        return problems, None
    with work.stage("recordings"):
        gating = study.signals.outliers == "gate"
        plan = Plan(
            study.layout(), sample.records.runs[0].sample_period,
            placeholders(sample.records, study.measured()) if gating else {},
            study.signals.differentiator, study.signals.margin,
            filtered.inputs, filtered.lead, filtered.clipping, filtered.shortest,
            replace(filtered.signals, columns=(), start=()), tuple(p.library for p in problems),
        )  # fmt: skip
        whole = reduce_all(sample, plan, problems, work.workers, work.monitor)
    return whole.problems, whole


def search_all(work: Work, libraries: Sequence[Library], problems: Sequence[Problem]) -> tuple[Search, ...]:
    """Return the search for each target: every support found, and the candidates ranked, whatever they predict.

    Args:
        work: whose study says who proposes and how candidates are ranked.
        libraries: one a target, which know what their rules removed.
        problems: one a target.
    """
    study, searches = work.study, []
    for problem, library in zip(problems, libraries, strict=True):
        with work.stage("regression"):
            found = swept(work, problem)
        with work.stage("selection"):
            ranked = ranking(problem, found, study.selection)
            if (law := multiplied(problem, ranked.candidates)) is not None:
                found = found.including(law)
                ranked = ranking(problem, found, study.selection)
            searches.append(Search(problem, found, ranked, library.removed))
    return tuple(searches)


def propose(work: Work, signals: Signals, searches: Sequence[Search]) -> list[tuple[Chosen, Model]]:
    """Return the best relations that together determine the targets, as many as the likelihood is to begin from.

    Args:
        work: whose study says how many.
        signals: on whose states no denominator may vanish.
        searches: one a target.

    Raises:
        NoModelError: no candidate of a target is fit to be a relation, or no relations determine the targets.
    """
    with work.stage("selection"):
        for search in searches:
            require_law(search.problem, search.ranked, work.study.selection)
    with work.stage("model"):
        proposed = list(islice(proposals(work.study, signals, searches), work.study.likelihood.starts))
        if not proposed:
            raise NoModelError(
                "model", "the best relations of the targets do not determine them together: two say the same"
            )
    return proposed


def regress_at(work: Work, substituted: Substituted, filtered: Filtered) -> Regressed:
    """Return what regression finds where constants have these numbers.

    Args:
        work: whose study says how.
        substituted: the libraries with these numbers.
        filtered: the signals.
    """
    problems, whole = pose_all(work, substituted.libraries, filtered)
    searches = search_all(work, substituted.libraries, problems)
    try:
        proposals = tuple(propose(work, filtered.signals, searches))
    except NoModelError as failure:
        return Regressed(substituted, problems, whole=whole, failure=failure, in_vain=searches)
    return Regressed(substituted, problems, searches, proposals, whole)


def regress_at_all(work: Work, points: Sequence[Substituted], filtered: Filtered) -> Regressed:
    """Return what regression finds at the best numbers for constants, with what it does at the others.

    Args:
        work: whose study says how.
        points: the libraries with numbers, at least one.
        filtered: the signals.
    """
    tried = [regress_at(work, p, filtered) for p in points]
    best = min(tried, key=lambda r: r.criterion)
    return replace(best, elsewhere=tuple(r for r in tried if r is not best))


def draw_anew(work: Work, regressed: Regressed, form: Form = "relations") -> Regressed:
    """Return what regression found with the inclusion of every term.

    Args:
        work: whose study holds the seed.
        regressed: what it found; as it is returned where there is no proposal, or the terms have theirs.
        form: that of the model; where it has mechanisms no candidate of the relations is in it.
    """
    if form != "relations" or not regressed.proposals or regressed.searches[0].inclusion is not None:
        return regressed
    study, rng, drawn = work.study, np.random.default_rng(work.study.random.seed), []
    with work.stage("bootstrap"):
        for search, candidate in zip(regressed.searches, regressed.proposals[0][0], strict=True):
            work.monitor.check()
            within, proposers = nested(study, search.problem), study.regression.proposers
            shares = inclusion(search.problem, candidate, within, proposers, rng, work.workers, work.monitor.check)
            drawn.append(replace(search, inclusion=shares))
    return replace(regressed, searches=tuple(drawn))


def refine_form(work: Work, filtered: Filtered, posed: Posed) -> Refinement | None:
    """Return what the likelihood of the recorded trajectory leads to in one form; None where no start can be followed.

    Args:
        work: whose study says how.
        filtered: the records and their signals.
        posed: the form.
    """
    options = work.study.likelihood
    with work.stage("likelihood"):
        found = refine(
            filtered.records,
            filtered.signals,
            posed.mechanisms,
            Starts(posed.starts, posed.plain, posed.rival, posed.further),
            work.study.signals.differentiator,
            msgspec.structs.replace(options, budget=min(options.budget, work.left)),
            work.monitor,
            work.workers,
            [name for name, i in work.study.inputs.items() if i.delay in ("auto", "estimate")],
            [name for name, i in work.study.inputs.items() if i.hold == "auto"],
            posed.constants,
            work.deadline,
        )
    work.searches.spent += 0.0 if found is None else found.spent
    return found
