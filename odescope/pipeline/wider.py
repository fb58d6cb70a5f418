"""Libraries that are tried where a model leaves a suspicion: what regression finds in one, and whether that is better.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from odescope.library.candidates import Library
from odescope.library.mechanism import Mechanism
from odescope.likelihood.beginnings import EVIDENT
from odescope.likelihood.findings import left_by
from odescope.likelihood.refine import WELL
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.search import WIDTHS, full
from odescope.likelihood.settings import Start
from odescope.model.relation import Relation
from odescope.model.worth import MINOR
from odescope.pipeline.constants import constants_of, substitute
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed, relations_form
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.ruled_out import not_ruled_out
from odescope.pipeline.stages import refine_form, regress_at_all
from odescope.pipeline.suspicion import replaces
from odescope.pipeline.work import Work
from odescope.signals.estimate import Signals
from odescope.study.options import Study

MANY = 120  # candidates of a target: more take longer than a suspicion is worth
LEAST = 1.0  # units of budget, where the search before cost next to nothing,
TIMES = 2.0  # and times what it cost


def basis_of(study: Study, turning: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the basis of another library: what the study leaves free, and sines and cosines of its angles.

    Args:
        study: a cyclic coordinate, an angle itself and the time have no part in its default library, nor in another.
        turning: states that nobody called angles, and that may be some.
    """
    angles = [*(c.name for c in study.measured() if c.angle), *turning]
    return (*study.suspects, *(f"{function}({name})" for name in angles for function in ("sin", "cos")))


def with_basis(work: Work, basis: Sequence[str], degree: int) -> Work:
    """Return the work for a study with another library.

    Args:
        work: for the study.
        basis: of the other library.
        degree: of its products, at most.
    """
    library = msgspec.structs.replace(work.study.library, basis=tuple(basis), degree=degree)
    return replace(work, study=msgspec.structs.replace(work.study, library=library))


def with_extra(work: Work, extra: tuple[str, ...]) -> Work:
    """Return the work for a study with these candidates beside those of its library."""
    library = msgspec.structs.replace(work.study.library, extra=extra)
    return replace(work, study=msgspec.structs.replace(work.study, library=library))


def quotients(refinement: Refinement) -> frozenset[str]:
    """Return the names in what multiplies a target of a model, where that is more than a number."""
    parts = (p.product for k in refinement.fit.present for p in refinement.space.mechanisms[k].parts)
    return frozenset[str]().union(*(p.term.names for p in parts if p.factor is not None))


def within(work: Work, budget: float) -> Work:
    """Return the work for a study with no more than this budget."""
    options = work.study.likelihood
    likelihood = msgspec.structs.replace(options, budget=min(options.budget, budget))
    return replace(work, study=msgspec.structs.replace(work.study, likelihood=likelihood))


def regressed_with(
    work: Work, filtered: Filtered, many: int = MANY, beside: Sequence[Relation] = ()
) -> Regressed | None:
    """Return what regression finds in the library of a study, at all its constants, None where it is too large.

    Args:
        work: whose study that is.
        filtered: the records and their signals.
        many: candidates of a target at most.
        beside: relations, one a target, whose terms are candidates, too.
    """
    study: Study = work.study
    stays = not_ruled_out(study, filtered.sample.records)
    libraries = tuple(study.candidates(c.target).that(stays) for c in study.measured())
    if beside:
        own = (Library(tuple(t.product.expanded for t in r.terms if not t.product.bare)) for r in beside)
        libraries = tuple(library + terms for library, terms in zip(libraries, own, strict=True))
    if max(map(len, libraries)) > min(many, filtered.signals.samples):
        return None
    terms = [t for library in libraries for t in library]
    held = any(not t.names.isdisjoint(study.parameters) for t in terms)  # those declared may be of another form
    constants = constants_of(study, terms, filtered.signals) if held else ()
    return regress_at_all(work, substitute(libraries, constants, filtered.signals.targets), filtered)


def searched_with(
    work: Work, filtered: Filtered, found: Regressed, before: Refinement | None, times: float = 1.0
) -> tuple[Posed, Refinement | None]:
    """Return the relations of another library, and the model that a search in them ends with, None where it has none.

    Args:
        work: for the study with that library.
        filtered: the records and their signals.
        found: what regression finds in it.
        before: the model so far, if there is one.
        times: what it cost, that the search may cost.
    """
    limited = within(work, LEAST if before is None else max(LEAST, times * before.spent))
    posed = relations_form(work.study, (found,), lambda _: found)
    return posed, refine_form(limited, filtered, posed)


def searched_beside(
    work: Work, filtered: Filtered, posed: Posed, before: Refinement, more: Sequence[Mechanism]
) -> tuple[Posed, Refinement | None]:
    """Return a form with more candidates, and the model of a search that goes on from its own, None where it has none.

    Args:
        work: for the study.
        filtered: the records and their signals.
        posed: the form.
        before: its model.
        more: candidates.
    """
    begun = (before.fit.theta * before.space.sizes(before.fit.theta))[: len(posed.mechanisms)]
    start = Start(np.append(begun, np.zeros(len(more))))
    wide = Posed(posed.form, (*posed.mechanisms, *more), posed.constants, posed.left_out, (start,))
    return wide, refine_form(within(work, max(LEAST, TIMES * before.spent)), filtered, wide)


def promises(found: Regressed, before: Regressed, least: float = EVIDENT) -> bool:
    """Say whether regression finds evidently more in one library than in the one before.

    Args:
        found: in the one.
        before: in the other.
        least: by how much the criterion has to be less.
    """
    return bool(np.isfinite(found.criterion) and found.criterion < before.criterion - least)


def outranks(work: Work, filtered: Filtered, model: Refinement) -> bool:
    """Say whether regression in another library ranks something above a model, on the same rows.

    Args:
        work: for the study with that library.
        filtered: the records and their signals.
        model: whose terms are among the candidates.
    """
    found = regressed_with(work, filtered, beside=model.relations)
    return found is None or found.criterion < found.worth(model.relations)


def evidently_better(other: Refinement, before: Refinement | None) -> bool:
    """Say whether a model with another library replaces the one before: it follows the record in one piece.

    Or with noise of the process, as the one before does. One that stopped at its largest number of terms replaces no
    other: so many follow any record.
    """
    if other.process is None and other.outcome.width > WIDTHS[-1]:
        return False
    if before is None:
        return other.exact
    if full(other.space, other.fit):
        return False
    gain = other.gained_over(before)
    return replaces(other, before) and (gain is None or gain > EVIDENT)


def better_or_simpler(other: Refinement, before: Refinement | None) -> bool:
    """Say whether a model replaces the one before that is evidently better, or likelier and of a lower price.

    A function in the place of powers may have found the law times its state; powers may imitate what is radiated.
    """
    gain = other.gained_over(before)
    likelier = gain is not None and gain > 0.0 and other.exact
    simpler = before is not None and other.space.price(other.fit) < before.space.price(before.fit)
    return evidently_better(other, before) or (likelier and simpler)


def follows_surely(refinement: Refinement) -> bool:
    """Say whether a model follows the record with no term in doubt, or leaves white noise of the process."""
    return refinement.says_all or (refinement.exact and refinement.outcome.sure)


def settles(refinement: Refinement, signals: Signals) -> bool:
    """Say whether a model in a small library leaves nothing to look for: it follows the record surely, or closely.

    What it leaves to noise of the process is little then, and free runs stay near: what disturbs a tank for hours, as
    rain or a leak, is no white noise.

    Args:
        refinement: whose model it is.
        signals: the targets as they were measured.
    """
    little = refinement.free_run_error < WELL and left_by(refinement, signals) < MINOR
    return follows_surely(refinement) or little
