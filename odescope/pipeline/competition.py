"""Regression of relations, then the likelihood in every form that competes, and which of them is kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from odescope.errors import InputError, NoModelError
from odescope.events import Note
from odescope.likelihood.refinement import Refinement
from odescope.model.assembled import relations_of, stated
from odescope.model.model import Model
from odescope.model.scores import FormScore, SuspicionScore
from odescope.pipeline.angular import with_angles
from odescope.pipeline.common_denominators import with_common_denominators
from odescope.pipeline.constants import constants_of, substitute, substituted_at
from odescope.pipeline.contender import Contender, best_of, contender_of, leave_little
from odescope.pipeline.degree import with_higher_degree
from odescope.pipeline.divided_friction import with_divided_friction
from odescope.pipeline.drag import with_drag
from odescope.pipeline.energies import with_energies
from odescope.pipeline.filtering import Filtered, Prepared
from odescope.pipeline.flows import conclusive, flows
from odescope.pipeline.forms import Posed, mechanisms_form, relations_form
from odescope.pipeline.inputs import under_found_holds
from odescope.pipeline.joint_models import adopt, determined
from odescope.pipeline.modulated import with_modulated
from odescope.pipeline.networks import networks
from odescope.pipeline.one_by_one import with_terms_of_mechanisms
from odescope.pipeline.radiation import radiated, with_radiation
from odescope.pipeline.reciprocals import with_reciprocals
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.relative_speeds import RelativeSpeeds
from odescope.pipeline.roots import with_roots
from odescope.pipeline.shared_rates import leaves_imitation, with_shared_rates
from odescope.pipeline.springs_and_dampers import with_springs_and_dampers
from odescope.pipeline.stages import draw_anew, refine_form, regress_at, regress_at_all
from odescope.pipeline.sums import with_sums
from odescope.pipeline.supports import with_moving_supports
from odescope.pipeline.suspicion import left_over, with_suspected
from odescope.pipeline.temperatures import rates, with_arrhenius
from odescope.pipeline.wider import LEAST, TIMES, evidently_better, within
from odescope.pipeline.work import Work
from odescope.recordings.checks import degrees_hints
from odescope.recordings.record import Records
from odescope.signals.estimate import Signals
from odescope.signals.first_order import second_order_hints
from odescope.study.options import LeftOut


def regress(work: Work, prepared: Prepared, filtered: Filtered) -> Regressed:
    """Return what regression on relations finds; nothing where that form does not compete.

    Args:
        work: whose study says how.
        prepared: the libraries, none where relations do not compete.
        filtered: the signals.
    """
    with work.stage("library"):
        constants = constants_of(work.study, prepared.terms, filtered.signals)
        points = substitute(prepared.libraries, constants, filtered.signals.targets)
    if not prepared.libraries:
        return Regressed(points[0])
    best = regress_at_all(work, points if filtered.sample.complete else points[:1], filtered)
    if prepared.mechanisms:  # there may be no relation in the model
        return _with_names(best)
    return draw_anew(work, _with_names(with_springs_and_dampers(work, filtered, best)))


def _with_names(regressed: Regressed) -> Regressed:
    """Return what regression found, with functions written as they are named."""
    if not regressed.proposals:
        return replace(regressed, elsewhere=())
    named = {product: written for product, (_, written) in regressed.substituted.named.items()}
    return replace(regressed, searches=tuple(replace(s, named=named) for s in regressed.searches))


class NoLaw(NoModelError):
    """No form has a model; `refinement` follows the `records`, if any does, but runs away from them freely."""

    def __init__(
        self, stage: str, message: str, records: Records | None = None, refinement: Refinement | None = None
    ) -> None:
        super().__init__(stage, message)
        self.records = records
        self.refinement = refinement


@dataclass(frozen=True, eq=False)
class Winner:
    """The model of the form that describes the record best, what led to it, and how each form that competed did.

    `regressed` is what regression found in the library of the relations that competed.
    """

    best: Contender
    forms: tuple[FormScore, ...]
    suspicions: tuple[SuspicionScore, ...]
    regressed: Regressed

    @property
    def model(self) -> Model:
        """The model."""
        return self.best.model

    @property
    def refinement(self) -> Refinement | None:
        """What the likelihood led to, where it was asked."""
        return self.best.refinement

    @property
    def left_out(self) -> LeftOut:
        """The mechanisms that no data could tell from others."""
        return self.best.left_out

    @property
    def follows(self) -> bool:
        """Whether the model follows the record, with process noise if need be."""
        return self.best.follows


def compete(work: Work, prepared: Prepared, filtered: Filtered, regressed: Regressed) -> Winner:
    """Return the form that describes the record best.

    Args:
        work: whose study says how.
        prepared: the mechanisms of the forms beside relations.
        filtered: the records and their signals.
        regressed: what regression on relations found.

    Raises:
        InputError: a tie names no candidate of the relations.
        NoModelError: no form has a model.
    """
    if regressed.failure is not None:  # what the study alone may have done is said before a long search
        signals = filtered.signals
        doubts = degrees_hints(filtered.sample.records, signals.coordinates), second_order_hints(signals).values()
        for text in chain.from_iterable(doubts):
            work.monitor.tell(Note(text, warns=True))
    contenders, lost, suspicions = list[Contender](), list[Refinement](), tuple[SuspicionScore, ...]()
    lagrangian: Posed | None = None
    for posed in _posed(work, prepared, filtered, regressed):
        signals, lagrangian = filtered.signals, posed if posed.form == "lagrangian" else lagrangian
        done = [c.refinement for c in contenders if c.refinement is not None]
        if posed.form == "relations" and done:
            asis = [] if regressed.model is None else [contender_of(posed, regressed.model, None, done, signals)]
            if leave_little(contenders, asis):
                contenders += asis
                continue
        if posed.form == "relations" and prepared.mechanisms and not work.late:
            regressed = with_springs_and_dampers(work, filtered, regressed)
            regressed = _with_names(with_terms_of_mechanisms(work, filtered, regressed, contenders))
            posed = _relations(work, prepared, filtered, regressed)
        relative = RelativeSpeeds(work, filtered)
        posed, refinement = _refined(work, filtered, posed, regressed, relative)
        if posed.form == "relations" and work.study.suspects and not work.late:
            refinement, suspicions = _with_more(work, filtered, posed, regressed, refinement, relative)
        own = partial(_regressed, posed, regressed, signals)
        model, refinement = adopt(own, refinement, signals)
        filtered = replace(filtered, signals=under_found_holds(signals, refinement))
        if model is not None:
            contender = contender_of(posed, model, refinement, done, filtered.signals)
            if regressed.failure is None or contender.says_something:
                contenders.append(contender)
            elif refinement is not None:
                lost.append(refinement)
    if not contenders:
        stage = "likelihood" if work.study.likelihood.enabled else "regression"
        why = regressed.failure or NoModelError(
            stage, "no model follows the record, even in short segments: look for missing physics or wrong units"
        )
        raise NoLaw(why.stage, why.message, filtered.sample.records, lost[-1] if lost else None)
    forms = with_energies(work, filtered, lagrangian, contenders)
    best = best_of(forms)
    scores = tuple(c.score(c is best) for c in forms) if len(forms) > 1 else ()
    return Winner(best, scores, suspicions if best.form == "relations" else (), regressed)


def _refined(
    work: Work, filtered: Filtered, posed: Posed, regressed: Regressed, relative: RelativeSpeeds
) -> tuple[Posed, Refinement | None]:
    """Return a form, in another library where that is the better one, and what the likelihood leads to.

    Args:
        work: whose study says how.
        filtered: the records and their signals.
        posed: the form in its own library.
        regressed: what regression on relations found.
        relative: searches with friction relative to an input.
    """
    if not work.study.likelihood.enabled:
        return posed, None
    relations = posed.form == "relations" and not work.late
    small = (partial(rates, work, filtered), partial(radiated, work, filtered), relative.first) if relations else ()
    for begin in small:
        if (begun := begin(regressed)) is not None:
            return begun
    network = networks(work, filtered, regressed) if relations else None
    if network is not None and evidently_better(network[1], _as_long(work, filtered, posed, network[1])):
        return network
    flowing = flows(work, filtered, regressed) if relations else None
    if flowing is not None and conclusive(flowing[1], filtered.signals):
        noisy = flowing[1].process is not None and not flowing[1].says_all
        other = _as_long(work, filtered, posed, flowing[1]) if noisy else None
        if other is None or not other.exact:  # what follows the record without such noise may be the law
            return flowing
    refinement = refine_form(work, filtered, posed)
    if work.late:
        return posed, refinement
    if flowing is not None and evidently_better(flowing[1], refinement):
        return flowing
    for better in {"relations": (with_sums,), "lagrangian": (with_moving_supports, with_drag)}.get(posed.form, ()):
        posed, refinement = better(work, filtered, posed, refinement)
    return posed, refinement


def _as_long(work: Work, filtered: Filtered, posed: Posed, small: Refinement) -> Refinement | None:
    """Return the model that as long a search in a form's own library ends with, None where it has none.

    Args:
        work: whose study says how.
        filtered: the records and their signals.
        posed: the form in its own library.
        small: the model of a small one.
    """
    return refine_form(within(work, max(LEAST, TIMES * small.spent)), filtered, posed)


def _with_more(
    work: Work,
    filtered: Filtered,
    posed: Posed,
    regressed: Regressed,
    refinement: Refinement | None,
    relative: RelativeSpeeds,
) -> tuple[Refinement | None, tuple[SuspicionScore, ...]]:
    """Return the relations with what their library lacks, where the record asks for it, and what was suspected.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        posed: the relations.
        regressed: what regression on these found.
        refinement: the model so far, if there is one.
        relative: searches with friction relative to an input.
    """
    suspicions = tuple[SuspicionScore, ...]()
    # Products are simpler than functions, which are then looked for beside the candidates that the model is made of.
    posed, refinement = with_modulated(work, filtered, posed, regressed, refinement)
    posed, refinement = relative.where_wanting(posed, refinement)
    posed, refinement = with_reciprocals(work, filtered, posed, regressed, refinement)
    posed, refinement = with_divided_friction(work, filtered, posed, refinement)
    if refinement is not None and refinement.follows:
        refinement = with_common_denominators(work, filtered, posed, refinement)
    apart, refinement = refinement, with_shared_rates(work, filtered, refinement)
    # Too many terms imitate a rate that goes with a temperature for one function at a time to be seen in their place.
    wanting = refinement is None or refinement.wanting
    if wanting:
        refinement, suspicions = with_arrhenius(work, filtered, refinement, ())
    if not suspicions:
        refinement, suspicions = with_radiation(work, filtered, refinement)
    if refinement is not None and not suspicions:
        shared, (refinement, suspicions) = refinement, with_suspected(work, filtered, posed, refinement)
        if apart is not None and refinement is shared and leaves_imitation(shared, apart):
            # What the rate and the terms beside it say together may be one function.
            found, own = with_suspected(work, filtered, posed, apart)
            if found is not apart and (found.gained_over(shared) or 0.0) > 0.0:
                refinement, suspicions = found, own
    if not wanting:
        refinement, warm = with_arrhenius(work, filtered, refinement, suspicions)
        suspicions = warm or suspicions
    rooted = with_roots(work, filtered, regressed, refinement)
    functions = any(s.found for s in suspicions)
    posed, higher = with_higher_degree(work, filtered, posed, regressed, rooted, functions)
    if higher is not None and higher is not rooted:
        higher, suspicions = with_suspected(work, filtered, posed, higher)
        refinement = higher
    angular, angles = with_angles(work, filtered, regressed, higher, bool(suspicions))
    if angular is None or higher is refinement:
        return angular, (*suspicions, *angles)
    # What was suspected of a model that is gone says nothing of the one that came instead.
    return angular, (*left_over(work, angular, suspicions), *angles)


def _posed(work: Work, prepared: Prepared, filtered: Filtered, regressed: Regressed) -> tuple[Posed, ...]:
    """Return the forms that compete, mechanisms first, each with its candidates and where to begin."""
    study, records, signals = work.study, filtered.records, filtered.signals
    forms = [
        mechanisms_form(study, form, library, regressed.substituted.constants, records, signals)
        for form, library in prepared.mechanisms.items()
    ]
    return (*forms, _relations(work, prepared, filtered, regressed)) if regressed.problems else tuple(forms)


def _relations(work: Work, prepared: Prepared, filtered: Filtered, regressed: Regressed) -> Posed:
    """Return the relations, with their candidates and where to begin."""
    substituted, targets = regressed.substituted, filtered.signals.targets

    def again(values: Mapping[str, float]) -> Regressed:
        there = substituted_at(prepared.libraries, substituted.constants, values, targets)
        return regress_at(work, there, filtered)

    return relations_form(work.study, (regressed, *regressed.elsewhere), again)


def _regressed(posed: Posed, regressed: Regressed, signals: Signals) -> Model | None:
    """Return the model that regression proposes in a form, where it determines the targets."""
    theta = posed.proposal
    if posed.form == "relations" or theta is None:
        return regressed.model if posed.form == "relations" else None
    present = np.flatnonzero(theta)
    mechanisms = [posed.at_nominal[k] for k in present]
    relations = relations_of(mechanisms, theta[present], None, signals.targets)
    try:
        model = Model(
            signals.coordinates, signals.inputs, relations, mechanisms=stated(mechanisms, theta[present], None)
        )
    except InputError:  # a relation that holds no target
        return None
    return model if determined(model, signals) else None
