"""Regression of relations, then the likelihood in every form that competes, and which of them is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, NoModelError
from odescope.likelihood.held_out import free_run_error
from odescope.likelihood.refine import Refinement
from odescope.model.assembled import relations_of, stated
from odescope.model.model import Model
from odescope.model.scores import FormScore
from odescope.pipeline.forms import Posed
from odescope.pipeline.joint_models import Search, adopt, as_adopted, determined
from odescope.pipeline.reduce import Whole
from odescope.pipeline.stages import (
    Chosen,
    Filtered,
    Prepared,
    Work,
    draw_anew,
    pose_all,
    pose_forms,
    propose,
    refine_form,
    search_all,
)
from odescope.regression.problem import Problem
from odescope.signals.estimate import Signals
from odescope.study.options import Form

SPREAD = 1.1  # error of free runs over the least: within it fewer coefficients win


@dataclass(frozen=True, eq=False)
class Regressed:
    """What regression on relations found: problems, searches and proposals, empty where no relation is looked for.

    `failure` says why there are no proposals where some were wanted.
    """

    problems: tuple[Problem, ...] = ()
    searches: tuple[Search, ...] = ()
    proposals: tuple[tuple[Chosen, Model], ...] = ()
    whole: Whole | None = None
    failure: NoModelError | None = None

    @property
    def model(self) -> Model | None:
        """The best proposal."""
        return self.proposals[0][1] if self.proposals else None


def regress(work: Work, prepared: Prepared, filtered: Filtered) -> Regressed:
    """Return what regression on relations finds; nothing where that form does not compete.

    Args:
        work: whose study says how.
        prepared: the libraries, none where relations do not compete.
        filtered: the signals.

    Raises:
        NoModelError: it finds nothing, and there is no likelihood stage that could begin without it.
    """
    if not prepared.libraries:
        return Regressed()
    problems, whole = pose_all(work, prepared, filtered)
    try:
        searches = search_all(work, prepared, problems)
        proposals = tuple(propose(work, filtered.signals, searches))
    except NoModelError as failure:
        if not work.study.likelihood.enabled:
            raise
        return Regressed(problems, whole=whole, failure=failure)
    return Regressed(problems, draw_anew(work, searches, proposals[0][0]), proposals, whole)


def adopted(regressed: Regressed, model: Model) -> Chosen:
    """Return the candidate of every target that has the terms of the model, or that was proposed."""
    if not regressed.proposals:
        return ()
    chosen = regressed.proposals[0][0]
    return tuple(as_adopted(s, c, r) for s, c, r in zip(regressed.searches, chosen, model.relations, strict=True))


@dataclass(frozen=True, eq=False)
class _Contender:
    """A form with its model, and how that does."""

    form: Form
    model: Model
    refinement: Refinement | None
    coefficients: int
    free_run: float

    @property
    def misfit(self) -> float:
        """Residual variance over that of the noise."""
        return np.inf if self.refinement is None else float(self.refinement.outcome.scale)

    @property
    def follows(self) -> bool:
        """Whether it follows the record, with process noise if need be."""
        return self.refinement is not None and self.refinement.follows

    def score(self, chosen: bool) -> FormScore:
        """Return how it did."""
        misfit = self.misfit if np.isfinite(self.misfit) else None
        return FormScore(self.form, self.coefficients, self.free_run, misfit, self.follows, chosen)


def compete(
    work: Work, filtered: Filtered, regressed: Regressed
) -> tuple[Model, Refinement | None, tuple[FormScore, ...]]:
    """Return the model of the form that describes the record best, what led to it, and how each form did.

    Args:
        work: whose study names the forms.
        filtered: the records and their signals.
        regressed: what regression on relations found.

    Raises:
        InputError: the library says what a form cannot hold.
        NoModelError: no form has a model.
    """
    contenders = list[_Contender]()
    for posed in pose_forms(work, filtered, regressed.problems, regressed.searches, regressed.proposals):
        own = regressed.model if posed.form == "relations" else _regressed(posed, filtered.signals)
        done = [c.refinement for c in contenders if c.refinement is not None]
        # Mechanisms that follow the record leave nothing to find: relations then compete as regression has them.
        settled = any(r.process is None and r.outcome.clear for r in done)
        refinement = refine_form(work, filtered, posed) if work.study.likelihood.enabled and not settled else None
        model, refinement = adopt(own, refinement, filtered.signals)
        # Of what regression finds no law in, process noise explains anything: only what needs none is then a model.
        exact = refinement is not None and refinement.follows and refinement.process is None
        if model is not None and (exact or regressed.failure is None):
            contenders.append(_contender(posed, model, refinement, done))
    if not contenders:
        raise regressed.failure or NoModelError(
            "likelihood", "no model follows the record, even in short segments: look for missing physics or wrong units"
        )
    best = _best(contenders)
    scores = tuple(c.score(c is best) for c in contenders) if len(contenders) > 1 else ()
    return best.model, best.refinement, scores


def _best(contenders: Sequence[_Contender]) -> _Contender:
    """Return the form to keep: by likelihood among those that follow the record to its noise, else by free runs."""
    exact = [c for c in contenders if c.refinement is not None and c.follows and c.refinement.process is None]
    if exact:
        return min(exact, key=lambda c: np.inf if c.refinement is None else c.refinement.outcome.penalised)
    able = [c for c in contenders if c.follows] or list(contenders)
    least = min(c.free_run for c in able)
    return min((c for c in able if c.free_run <= SPREAD * least), key=lambda c: (c.coefficients, c.free_run))


def _regressed(posed: Posed, signals: Signals) -> Model | None:
    """Return the model that regression on mechanisms proposes, where it determines the targets."""
    if not posed.starts:
        return None
    theta: FloatArray = posed.starts[-1]
    present = np.flatnonzero(theta)
    mechanisms = [posed.mechanisms[k] for k in present]
    relations = relations_of(mechanisms, theta[present], None, signals.targets)
    try:
        model = Model(
            signals.coordinates, signals.inputs, relations, mechanisms=stated(mechanisms, theta[present], None)
        )
    except InputError:  # a relation that holds no target
        return None
    return model if determined(model, signals) else None


def _contender(posed: Posed, model: Model, refinement: Refinement | None, others: Sequence[Refinement]) -> _Contender:
    """Return a form with how it does on free runs, over the data of any likelihood stage."""
    if refinement is not None:
        coefficients, space = len(refinement.fit.free), refinement.space
        return _Contender(posed.form, model, refinement, coefficients, free_run_error(space, refinement.fit.theta))
    theta = posed.starts[0] if posed.form == "relations" else posed.starts[-1]
    error = np.inf
    for other in others[:1]:
        space = other.space.among(posed.mechanisms)
        error = free_run_error(space, theta)
    return _Contender(posed.form, model, None, int(np.count_nonzero(theta)) - len(model.relations), error)
