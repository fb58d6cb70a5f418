"""The pipeline: records to signals to candidates to one model (paper, end to end)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from itertools import compress, islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from odescope.errors import InputError, NoModelError
from odescope.events import Event, Monitor, Progress
from odescope.library.candidates import Library
from odescope.likelihood.account import likelihood_notes
from odescope.likelihood.refine import Refinement, refine
from odescope.model.model import Json, Model
from odescope.model.notebook import model_html
from odescope.parallel.dask_cluster import open_workers
from odescope.parallel.memory import peak_bytes
from odescope.parallel.workers import Workers
from odescope.pipeline.evaluation import domain, provenance, scores
from odescope.pipeline.fingerprint import fingerprint
from odescope.pipeline.joint_models import Search, adopt, as_adopted, plain, proposals
from odescope.pipeline.reduce import Plan, reduce_all
from odescope.pipeline.sample import Sample, open_recordings
from odescope.pipeline.store import Store
from odescope.recordings.checks import check_channels
from odescope.recordings.coordinate import Input
from odescope.recordings.readers import records_from
from odescope.recordings.record import Records
from odescope.regression.problem import Problem, pose
from odescope.regression.proposers import Support
from odescope.selection.bootstrap import inclusion
from odescope.selection.ranking import Candidate, rank
from odescope.selection.sweep import Sweep, nested_libraries, sweep
from odescope.signals.delays import LARGEST, Delay, delayed, estimate_delays, with_delays
from odescope.signals.estimate import Signals, estimate_signals
from odescope.signals.outliers import clip_outliers, count_clipped, settle_clipping
from odescope.study.options import Study

SHORTEST = 1.0  # periods of the lowest cutoff: shorter recordings are left out, unless all are
TOLD = 6  # notes of one kind

Watch = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Identification:
    """The result: what went in, what every stage found, and the model.

    `seconds` is the time of each stage, `memory` the most that the process had held, in bytes, when it ended.
    """

    study: Study
    records: Records
    signals: Signals
    searches: tuple[Search, ...]
    chosen: tuple[Candidate, ...]
    model: Model
    refinement: Refinement | None
    seconds: dict[str, float]
    memory: dict[str, int | None] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the equations, how far to trust them, and the notes."""
        return model_html(self.model, self.notes)

    def _repr_latex_(self) -> str:
        """Return the equations as LaTeX for a notebook."""
        return self.model._repr_latex_()

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know: candidates left out as dependent, denominators that may vanish, early ends."""
        dependent = list(
            dict.fromkeys(
                f"left out of the library: {term}, on these data a combination of {', '.join(t.text for t in others)}"
                for s in self.searches
                for term, others in s.problem.dependent
            )
        )
        notes: dict[str, None] = dict.fromkeys(dependent[:TOLD])
        if len(dependent) > TOLD:
            notes[f"and {len(dependent) - TOLD} more candidates that are combinations of others: see the report"] = None
        targets: Any = self.model.scores["targets"]
        notes |= {
            f"the denominator of {target} vanishes between the states of the data: expect poles when simulating": None
            for target, score in targets.items()
            if score["denominator"]["box"][0] * score["denominator"]["box"][1] <= 0.0
        }
        if short := self.model.scores.get("left_out"):
            notes[f"{short} recordings are shorter than a period of the cutoff and were left out"] = None
        if streamed := self.model.scores.get("streamed"):
            told: Any = streamed
            notes[
                f"{told['rows']:,} rows were read in {told['portions']} chunks: all of them count in the regression;"
                f" cutoffs, ranking, likelihood and report rest on {told['sampled']} of the chunks"
            ] = None
        delays: Any = self.model.scores.get("delays", {})
        notes |= {
            f"{name} acts {d['delay']:.4g} s after it was recorded"
            + ("" if d["std_error"] is None else f" (standard error {d['std_error']:.2g} s)"): None
            for name, d in delays.items()
            if d["delay"]
        }
        outliers: Any = self.model.scores.get("outliers", {})
        notes |= {
            f"{count} samples of {name} were clipped as outliers": None for name, count in outliers.items() if count
        }
        if self.refinement is not None:
            likelihood: Any = self.model.scores["likelihood"]
            notes |= dict.fromkeys([*likelihood_notes(self.refinement, self.model.targets), *likelihood["hints"]])
        return tuple(notes)


def identify(
    study: Study,
    data: Any = None,
    watch: Watch = lambda _: None,
    draft: Callable[[Identification], None] = lambda _: None,
    cluster: str | None = None,
    store: Path | None = None,
) -> Identification:
    """Return the model that the recordings support, with everything that led to it.

    Args:
        study: the options; its coordinates and inputs name the columns.
        data: recordings in memory: Records, a dataframe with the Arrow interface, a mapping of arrays, or a list of
            these. Without it the study's files are read, relative to the working directory.
        watch: told the name of each stage as it begins, and how far it got.
        draft: given the result as it stands before the likelihood stage, its model without scores.
        cluster: "local", or the address of a Dask scheduler, whose workers see the files under the same names; without
            it everything runs in this process.
        store: folder in which the factors of recordings are kept that do not fit in memory, so that a run that was
            interrupted, or got more recordings, computes only what is new.

    Raises:
        InputError: the data or the study are wrong.
        NoModelError: the data support no model; the error names the stage.
    """
    # Matrices here are small: threads of BLAS would only contend with those of the sweep and the likelihood.
    with threadpool_limits(1, "blas"), open_workers(cluster) as workers:
        return _identify(study, data, watch, draft, workers, store)


def _identify(
    study: Study,
    data: Any,
    watch: Watch,
    draft: Callable[[Identification], None],
    workers: Workers,
    store: Path | None,
) -> Identification:
    seconds: dict[str, float] = {}
    memory: dict[str, int | None] = {}
    coordinates = study.measured()

    @contextmanager
    def stage(name: str) -> Any:
        watch(name)
        begin = time.perf_counter()
        yield
        seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - begin
        memory[name] = peak_bytes()

    with stage("records"):
        sample = (
            open_recordings(study.data, study.layout(), _kept_in(store, study)) if data is None else _given(study, data)
        )
        check_channels(sample.records, coordinates, study.driven())
    with stage("library"):
        libraries = [study.candidates(c.target) for c in coordinates]
        for c, library in zip(coordinates, libraries, strict=True):
            if sample.records.samples < len(library):
                raise InputError(
                    f"{sample.records.samples} samples cannot decide between {len(library)} candidate terms for"
                    f" {c.target}: record longer, or shrink the library ([library] degree, basis or rules)"
                )
    records, outliers, clipping = sample.records, dict[str, int](), None
    if study.signals.outliers == "clip":
        with stage("signals"):
            clipping = settle_clipping(records, coordinates, study.signals.differentiator)
            clipped = clip_outliers(records.stretches, coordinates, study.signals.differentiator, clipping)
            outliers = count_clipped(records.stretches, clipped, coordinates)
            records = Records.of(s.record for s in clipped)
    inputs, delays = study.driven(), dict[str, Delay]()
    wanted = [name for name, i in study.inputs.items() if i.delay == "estimate"]
    if wanted:
        with stage("delays"):
            delays = _delays(study, records, libraries, wanted)
        inputs = with_delays(inputs, {name: d.seconds for name, d in delays.items()})
    lead = max((abs(i.delay) for i in inputs), default=0.0) or None
    with stage("signals"):
        records = Records.of(s.record for s in delayed(records.stretches, inputs, lead))
        signals = _signals(study, records, inputs)
        shortest = SHORTEST / min(c.cutoff for c in signals.channels)
        long = [run.duration >= shortest for run in records]
        left_out = long.count(False) if any(long) else 0
        if left_out:  # a piece of an oscillation has no derivative worth fitting
            sample = sample.without([not kept for kept in long])
            records = Records(tuple(compress(records, long)))
            signals = _signals(study, records, inputs)
    with stage("regression"):
        problems = [
            pose(signals, c.target, c.order, library, study.regression.rows, sample.folds)
            for c, library in zip(coordinates, libraries, strict=True)
        ]
    whole = None
    if not sample.complete:
        with stage("recordings"):
            options = study.signals
            plan = Plan(
                study.layout(), options.differentiator, options.margin, inputs, lead, clipping,
                shortest if any(long) else 0.0, replace(signals, columns=(), start=()),
                tuple(p.library for p in problems),
            )  # fmt: skip
            whole = reduce_all(sample, plan, problems, workers, Monitor(lambda event: _heard(event, watch)))
            problems = list(whole.problems)
    searches = []
    for problem, library in zip(problems, libraries, strict=True):
        with stage("regression"):
            found = _swept(study, problem)
        with stage("selection"):
            ranked = rank(problem, found, study.selection)
            searches.append(Search(problem, found, ranked, library.removed, np.zeros(len(problem.terms))))
    with stage("model"):
        proposed = list(islice(proposals(study, signals, searches), study.likelihood.starts))
        if not proposed:
            raise NoModelError(
                "model", "the best relations of the targets do not determine them together: two say the same"
            )
        chosen, model = proposed[0]
    with stage("bootstrap"):
        rng = np.random.default_rng(study.random.seed)
        searches = [_drawn_anew(study, s, c, rng, workers) for s, c in zip(searches, chosen, strict=True)]
    draft(Identification(study, sample.records, signals, tuple(searches), chosen, model, None, seconds, memory))
    refinement = None
    if study.likelihood.enabled:
        with stage("likelihood"):
            starts = [m.relations for _, m in proposed]
            bare = [plain(s, c, signals.targets) for s, c in zip(searches, chosen, strict=True)]
            refinement = refine(records, signals, problems, starts, bare, study.likelihood, watch, workers)
            model, refinement = adopt(model, refinement, signals)
            chosen = tuple(
                as_adopted(s, c, r, signals.targets) for s, c, r in zip(searches, chosen, model.relations, strict=True)
            )
    with stage("model"):
        told = scores(model, signals, searches, chosen, refinement, study.random.seed)
        if left_out:
            told["left_out"] = left_out
        if outliers:
            told["outliers"] = dict[str, Json](outliers)
        if delays:
            told["delays"] = {n: {"delay": d.seconds, "std_error": d.std_error} for n, d in delays.items()}
        if whole is not None:
            told["streamed"] = {"rows": whole.rows, "portions": whole.chunks, "sampled": len(sample.chunks)}
        model = replace(model, scores=told, domain=domain(signals, model, whole))
        model = replace(model, provenance=provenance(study, signals, whole))
    return Identification(study, sample.records, signals, tuple(searches), chosen, model, refinement, seconds, memory)


def _heard(event: Event, watch: Watch) -> None:
    if isinstance(event, Progress):
        watch(f"{event.stage}: {event.done} of {event.total} {event.part}s, {event.seconds_left or 0.0:.0f} s left")


def _given(study: Study, data: Any) -> Sample:
    return Sample(data if isinstance(data, Records) else records_from(data, study.layout()))


def _kept_in(folder: Path | None, study: Study) -> Store | None:
    """Return the store of a study: what is kept depends on the options up to the rows of the regression."""
    if folder is None:
        return None
    data = msgspec.structs.replace(study.data, files=())
    options = (
        version("odescope"),
        data,
        study.coordinates,
        study.inputs,
        study.library,
        study.signals,
        study.regression.rows,
    )
    return Store(folder, fingerprint(options))


def _signals(study: Study, records: Records, inputs: Sequence[Input]) -> Signals:
    options = study.signals
    return estimate_signals(records, study.measured(), inputs, options.differentiator, options.margin, options.decimate)


def _swept(study: Study, problem: Problem) -> Sweep:
    """Return all the supports that are found for a target."""
    return sweep(problem.factor, problem.terms, _nested(study, problem), study.regression.proposers)


def _nested(study: Study, problem: Problem) -> tuple[Support, ...]:
    """Return the sets of columns that are searched in."""
    whole = (tuple(range(len(problem.terms))),)
    return nested_libraries(problem.rests, problem.own) if study.regression.nested else whole


def _drawn_anew(study: Study, search: Search, chosen: Candidate, rng: np.random.Generator, workers: Workers) -> Search:
    """Return the search with the inclusion of every term."""
    nested = _nested(study, search.problem)
    return replace(
        search, inclusion=inclusion(search.problem, chosen, nested, study.regression.proposers, rng, workers)
    )


def _delays(study: Study, records: Records, libraries: Sequence[Library], wanted: Sequence[str]) -> dict[str, Delay]:
    """Return the delays for which the criterion, summed over the targets, is least."""
    inputs = study.driven()
    period = 1.0 / max(c.cutoff for c in _signals(study, records, inputs).channels)
    lead = (LARGEST + 1.0) * period + max(abs(i.delay) for i in inputs)

    def cost(delays: Mapping[str, float]) -> float:
        acted = delayed(records.stretches, with_delays(inputs, delays), lead)
        signals = _signals(study, Records.of(s.record for s in acted), inputs)
        total = 0.0
        for c, library in zip(study.measured(), libraries, strict=True):
            problem = pose(signals, c.target, c.order, library, study.regression.rows)
            try:
                total += min(x.criterion for x in rank(problem, _swept(study, problem), study.selection).candidates)
            except NoModelError:  # far from the delay nothing fits
                return np.inf
        return total

    return estimate_delays(cost, wanted, period)
