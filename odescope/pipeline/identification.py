"""The pipeline: records to signals to candidates to one model (paper, end to end)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import msgspec
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

import odescope
from odescope.arrays import Table
from odescope.errors import InputError, NoModelError, interrupts_as_such, said
from odescope.events import Event, Monitor, Note, each_note_once, never, unheard
from odescope.library.product import Product
from odescope.likelihood.budget import Budget
from odescope.likelihood.refinement import Refinement
from odescope.model.coefficients import CoefficientRow, rows_with_errors
from odescope.model.display import equations_html
from odescope.model.given import GivenInputs, GivenState
from odescope.model.model import SHOWN_DIGITS, Model
from odescope.model.notes import notes_of, trust, warnings_of
from odescope.model.relation import Relation, RelationTerm
from odescope.model.scores import Doubts, ModelScores
from odescope.model.screen import screen
from odescope.model.simulation import Trajectory
from odescope.model.worth import uncertain, verdict
from odescope.parallel.dask_cluster import open_workers
from odescope.pipeline.adopted import Adopted, adopted
from odescope.pipeline.coarse_inputs import with_held_cells
from odescope.pipeline.competition import compete, regress
from odescope.pipeline.contender import Contender
from odescope.pipeline.evaluation import doubts_of, free_run_scores, require_model
from odescope.pipeline.filtering import Filtered, estimate, prepare, settled
from odescope.pipeline.forcing import with_forcing, without
from odescope.pipeline.joint_models import Search, to_relation
from odescope.pipeline.judged import judged
from odescope.pipeline.late_inputs import with_late_inputs
from odescope.pipeline.outside import moved_from_outside
from odescope.pipeline.path_models import path_models
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.ruled_out import few_candidates
from odescope.pipeline.run_freely import run_freely
from odescope.pipeline.stages import draw_anew
from odescope.pipeline.versions import best_version
from odescope.pipeline.work import SEARCHES, Work
from odescope.recordings.checks import degrees_hints
from odescope.recordings.coordinate import Input
from odescope.recordings.record import Recorded, Records
from odescope.selection.advice import advice, idle_inputs
from odescope.signals.estimate import Signals, filter_notes
from odescope.signals.first_order import order_advice
from odescope.signals.gated import Reasons
from odescope.signals.shafts import shaft_note
from odescope.signals.solved import solver_hints
from odescope.study.clock import with_time
from odescope.study.columns import converted, doubted_headings, settled_columns
from odescope.study.options import LeftOut, Study
from odescope.study.pieces import tables
from odescope.validation.free_runs import FreeRunOf, free_runs


@dataclass(frozen=True, eq=False)
class Identification:
    """The result: what went in, what every stage found, and the model.

    `chosen` are the candidates of the searches that the model is made of, one a target: None where its relation is none
    of them, as with mechanisms. `seconds` is the time of each stage, `memory` the most that the process had held, in
    bytes, when it ended; `left_out` are mechanisms that no data could tell from others; `searched` are the inputs as
    they were before the likelihood stage, which may find delays; `gated` says why a sample does not count; `free_runs`
    are those of the model from the starts of the recordings, which are `cleaned` of what does not count; a draft has
    none. `shafts` are pairs of angles that go round together, `degree` is that of the default library.
    """

    study: Study
    records: Records
    signals: Signals
    searches: tuple[Search, ...]
    chosen: Adopted
    model: Model
    refinement: Refinement | None
    seconds: dict[str, float]
    memory: dict[str, int | None] = field(default_factory=dict)
    left_out: LeftOut = ()
    searched: tuple[Input, ...] = ()
    gated: Reasons = field(default_factory=dict)
    free_runs: tuple[FreeRunOf, ...] = ()
    cleaned: Records | None = None
    shafts: tuple[tuple[str, str], ...] = ()
    degree: int | None = None

    @property
    def coefficients(self) -> tuple[CoefficientRow, ...]:
        """Every number of the model with its standard error, for a dataframe."""
        return self.model.coefficients

    # Verbs stand above the result, too: a method is the function of the package that has its name.
    def simulate(
        self, t: ArrayLike, inputs: GivenInputs, initial: GivenState, rtol: float = 1e-8, atol: float | None = None
    ) -> Trajectory:
        """Return the free run of the model under sampled inputs, see `odescope.simulate`.

        Args:
            t: (N,) ascending sample times in seconds.
            inputs: as they were recorded, by name or (N, inputs); None where there are none.
            initial: states at t[0], by name or (n,).
            rtol: relative tolerance of a step.
            atol: absolute tolerance of a step; by default by the sizes of states.
        """
        return self.model.simulate(t, inputs, initial, rtol, atol)

    def validate(self, data: Recorded, noise: Mapping[str, float] | None = None) -> odescope.Validation:
        """Return how well the model predicts recordings that it has not seen, see `odescope.validate`."""
        return self.model.validate(data, noise)

    def save(self, folder: Path | str) -> None:
        """Write what the identify command writes but for the report to a folder, see `odescope.save_result`."""
        odescope.save_result(self, folder)

    def write_report(self, folder: Path | str, title: str = "Identification") -> None:
        """Write report.html, its data and figures to a folder, see `odescope.write_report`."""
        odescope.write_report(self, folder, title)

    def __repr__(self) -> str:
        said = (uncertain(self.model.scores), *self._told)
        equations = odescope.to_text(self.model, SHOWN_DIGITS).splitlines()
        return screen(equations, [s for s in said if s], "odescope.to_text(result.model), result.coefficients, .notes")

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the equations with standard errors, how far to trust them, and the notes."""
        return equations_html(
            self.model.equations,
            tuple(self._told),
            self.model.shown_mechanisms,
            self.model.names,
            self.model.parameters,
            rows_with_errors(self.model.coefficients),
        )

    def _repr_latex_(self) -> str:
        """Return the equations as LaTeX for a notebook."""
        return self.model._repr_latex_()

    @cached_property
    def path(self) -> tuple[Model, ...]:
        """The models from many terms to few, in the order of `model.scores.path`; their scores are there."""
        models = path_models(self.refinement, self.signals, self.searched)
        return tuple(replace(m, domain=self.model.domain, provenance=self.model.provenance) for m in models)

    def with_terms(self, terms: int) -> Identification:
        """Return the result with the model on the path that has so many terms; only its free runs are made anew.

        Raises:
            InputError: there is no such model on the path.
        """
        scored = () if self.model.scores is None else self.model.scores.path
        for score, model in zip(scored, self.path, strict=True):
            if score.terms == terms:
                on_path = tuple(msgspec.structs.replace(s, chosen=s is score) for s in scored)
                over = self.records if self.cleaned is None else self.cleaned
                runs = free_runs(model, over)
                told = free_run_scores(model, runs, over, self.signals)
                scores = ModelScores(path=on_path, free_runs=told)
                searches, chosen = adopted(self.searches, model)
                model = replace(model, scores=scores)
                return replace(self, model=model, free_runs=runs, searches=searches, chosen=chosen)
        known = ", ".join(str(s.terms) for s in scored) or "none"
        raise InputError(f"there is no model with {terms} terms on the path; those on it have {known}")

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know: candidates left out as dependent, what was found out about the log, `warnings`."""
        dependent = [(str(m), [str(o) for o in others]) for m, others in self.left_out]
        if not self.model.mechanisms:
            dependent += [(t.text, [o.text for o in rest]) for s in self.searches for t, rest in s.problem.dependent]
        told = notes_of(self.model.scores, dependent, self._doubts)
        filtered = filter_notes(self.signals, self.records.runs[0].sample_period)
        few = few_candidates(self.study, self.degree, self.records)
        read = (*converted(self.study), *map(shaft_note, self.shafts), *filtered, *few)
        return tuple(dict.fromkeys((*told, *read, *self.warnings)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the notes that say what may be wrong with the model, the log or the study."""
        said = [*warnings_of(self.model.scores, self._doubts), *doubted_headings(self.study)]
        said += solver_hints(self.records, self.study.measured())
        if self.refinement is not None and not self.refinement.follows:  # laws hold of radians alone
            said += degrees_hints(self.records, self.study.measured())
        if any(run.valid_time < 0.5 * run.duration for run in _scores(self).free_runs):
            said += order_advice(self.signals)
        said += idle_inputs(self.signals, {*self.model.held, *self.study.clocks})
        return (*said, *(u.note for u in tables(self.study)[1]))

    @property
    def verdict(self) -> str:
        """What the model is worth, in a sentence; nothing where no likelihood has judged it."""
        return verdict(self.model.scores, self._doubts, bool(self.warnings))

    @cached_property
    def _doubts(self) -> Doubts | None:
        return doubts_of(self.model, self.refinement)

    @property
    def _told(self) -> Iterator[str]:
        """How far to trust the model, then the notes, as a screen has them."""
        warned = self.warnings
        yield from trust(self.model.scores)
        yield from (f"warning: {note}" if note in warned else note for note in self.notes)


@dataclass(frozen=True, slots=True, eq=False)
class DraftReady(Event):
    """The result as it stands before the likelihood stage, its model without scores."""

    result: Identification


@dataclass(frozen=True, slots=True, eq=False)
class EquationsReady(Event):
    """The result, all but told: its notes follow."""

    result: Identification


@dataclass(frozen=True, slots=True, eq=False)
class NothingFound(Event):
    """What was done before the run ended without a model.

    Attributes:
        failure: why it ended.
        result: what went in, the signals and the searches; its relations are the best of every target, and no law.
        advice: what may have kept a law from being found.
    """

    failure: NoModelError
    result: Identification
    advice: tuple[str, ...]


@interrupts_as_such()
def identify(
    study: Study,
    data: Records | Table | Sequence[Table] | Path | str | Sequence[Path | str] | None = None,
    *,
    watch: Callable[[Event], None] | None = None,
    stop: Callable[[], bool] | None = None,
    cluster: str | None = None,
    store: Path | None = None,
) -> Identification:
    """Return the model that the recordings support, with everything that led to it.

    Args:
        study: the options; its coordinates and inputs name the columns.
        data: recordings in memory: Records, a dataframe with the Arrow interface, a mapping of arrays, or a list of
            these; or paths of files. Without it the study's files are read, relative to the working directory.
        watch: called with every event, in this thread: each stage as it begins (`StageBegan`), how far it got
            (`Progress`), the result before the likelihood stage (`DraftReady`) and at the end (`EquationsReady`), then
            its notes (`Note`); `NothingFound` where it ends without a model. What it raises ends the run.
        stop: asked again and again, once a second or more often and in any thread; True ends the run.
        cluster: "local", or the address of a Dask scheduler, whose workers see the files under the same names; without
            it everything runs in this process.
        store: folder in which the factors of recordings are kept that do not fit in memory, so that a run that was
            interrupted, or got more recordings, computes only what is new.

    Raises:
        InputError: the data or the study are wrong.
        NoModelError: the data support no model; the error names the stage.
        Stopped: `stop` said so.
    """
    monitor = Monitor(each_note_once(watch or unheard), stop or never)
    if not isinstance(study, Study):
        raise InputError(f"what is identified must be odescope.Study; {said(study)} came: read_study reads study files")
    study.measured()
    deadline = None if (seconds := study.likelihood.seconds) is None else time.time() + seconds

    def run(version: Study, monitor: Monitor) -> tuple[Identification, Contender]:
        settled, own = settled_columns(version, data)

        def once(posed: Study, monitor: Monitor) -> tuple[Identification, Contender]:
            searches = Budget(SEARCHES * posed.likelihood.budget)
            return _identified(Work(with_time(posed), monitor, workers, deadline, searches=searches), own, store)

        return _settled_on(settled, monitor, once)

    # Matrices here are small: threads of BLAS would only contend with those of the sweep and the likelihood.
    with threadpool_limits(1, "blas"), open_workers(cluster) as workers:
        found, versions = best_version(study, monitor, run, NothingFound)
    result = _with_scores(found, versions=versions)
    monitor.tell(EquationsReady(result))
    warned = result.warnings
    for note in result.notes:
        monitor.tell(Note(note, note in warned))
    return result


def _settled_on(
    study: Study, monitor: Monitor, once: Callable[[Study, Monitor], tuple[Identification, Contender]]
) -> tuple[Identification, Contender]:
    """Return the best of the identifications that the first one asks for.

    Args:
        study: the options, which name one column of every input.
        monitor: told what goes on.
        once: identifies by a study, once through the stages.
    """

    def held_or_not(posed: Study, monitor: Monitor) -> tuple[Identification, Contender]:
        found, contender, held = with_held_cells(posed, monitor, once, NothingFound)
        return _with_scores(found, holds=_scores(found).holds | held), contender

    late = partial(with_late_inputs, run=held_or_not, in_vain=NothingFound)
    ended = list[NothingFound]()
    try:
        told = replace(monitor, tell=without(monitor, NothingFound, ended))
        result, contender, suspected = with_forcing(study, told, late, NothingFound)
    except NoModelError:
        for event in ended:
            more = moved_from_outside(study, event.result.searches, monitor, once)
            monitor.tell(replace(event, advice=(*event.advice, *more)))
        raise
    return _with_scores(result, suspicions=(*_scores(result).suspicions, *suspected)), contender


def _scores(result: Identification) -> ModelScores:
    """Return the scores of the model of a result."""
    return result.model.scores or ModelScores()


def _with_scores(result: Identification, **told: object) -> Identification:
    """Return a result with these scores of its model."""
    scores = msgspec.structs.replace(_scores(result), **told)
    return replace(result, model=replace(result.model, scores=scores))


def _identified(
    work: Work, data: Records | Table | Sequence[Table] | None, store: Path | None
) -> tuple[Identification, Contender]:
    """Go through the stages."""
    prepared = prepare(work, data, store)
    filtered = estimate(work, prepared)
    regressed = regress(work, prepared, filtered)

    def result(
        seen: Filtered, model: Model, refinement: Refinement | None, out: LeftOut = (), runs: tuple[FreeRunOf, ...] = ()
    ) -> Identification:
        searches, chosen = adopted(regressed.searches, model)
        return Identification(
            work.study,
            seen.sample.records,
            seen.signals,
            searches,
            chosen,
            model,
            refinement,
            work.seconds,
            work.memory,
            out,
            filtered.inputs,
            filtered.gated,
            runs,
            seen.undelayed,
            prepared.shafts,
            prepared.study.library.own_degree,
        )

    if regressed.model is not None:
        work.monitor.tell(DraftReady(result(filtered, regressed.model, None)))
    try:
        winner = compete(replace(work, study=prepared.study), prepared, filtered, regressed)
        regressed = draw_anew(work, winner.regressed, winner.best.form)
        seen = settled(work, filtered, winner.model)
        with work.stage("model"):
            model = judged(work.study, seen, regressed, winner)
            require_model(model, winner.follows, winner.best.exact)
            model, runs = run_freely(work, seen, model)
    except NoModelError as failure:
        work.monitor.tell(_nothing_found(work, filtered, draw_anew(work, regressed), failure))
        raise
    if (kept := prepared.sample.store) is not None:
        kept.prune()
    return result(seen, model, winner.refinement, winner.left_out, runs), winner.best


def _nothing_found(work: Work, filtered: Filtered, regressed: Regressed, failure: NoModelError) -> NothingFound:
    """Return what was done in vain."""
    signals, records = filtered.signals, filtered.sample.records
    searches = tuple(s for s in (*regressed.searches, *regressed.in_vain) if s.ranked.candidates)
    chosen = tuple(s.ranked.candidates[0] for s in searches)
    best = {s.problem.target: to_relation(s.problem, c) for s, c in zip(searches, chosen, strict=True)}
    bare = {t: Relation((RelationTerm(Product(t), 1.0),)) for t in signals.targets}
    model = Model(signals.coordinates, signals.inputs, tuple((bare | best)[t] for t in signals.targets))
    result = Identification(
        work.study, records, signals, searches, chosen, model, None, work.seconds, work.memory, gated=filtered.gated
    )
    return NothingFound(failure, result, advice(records, signals, regressed.problems, work.study.data.time_unit))
