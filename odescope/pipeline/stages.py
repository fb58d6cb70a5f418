"""The stages of an identification, in their order: each takes what the ones before found and returns what it found."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from itertools import compress, islice
from pathlib import Path

import msgspec
import numpy as np

from odescope.arrays import Table
from odescope.errors import InputError, NoModelError
from odescope.events import Monitor, StageBegan
from odescope.library.candidates import Library
from odescope.likelihood.refine import Refinement, refine
from odescope.model.model import Model
from odescope.parallel.memory import peak_bytes
from odescope.parallel.workers import Workers
from odescope.pipeline.fingerprint import fingerprint
from odescope.pipeline.forms import Posed, mechanisms_form, relations_form
from odescope.pipeline.inputs import first_holds
from odescope.pipeline.joint_models import Search, proposals
from odescope.pipeline.reduce import Plan, Whole, reduce_all
from odescope.pipeline.sample import Sample, open_recordings
from odescope.pipeline.store import Store
from odescope.recordings.checks import check_channels
from odescope.recordings.coordinate import Input
from odescope.recordings.readers import records_from
from odescope.recordings.record import Records, less_offsets
from odescope.regression.problem import Problem, pose
from odescope.regression.proposers import Support
from odescope.selection.bootstrap import inclusion
from odescope.selection.ranking import Candidate, rank
from odescope.selection.sweep import Sweep, nested_libraries, sweep
from odescope.signals.delays import LARGEST, Delay, delayed, estimate_delays, with_delays
from odescope.signals.estimate import Signals, estimate_signals
from odescope.signals.outliers import Clipping, clip_outliers, count_clipped, settle_clipping
from odescope.study.options import Form, Mechanisms, Study
from odescope.study.pieces import versions

SHORTEST = 1.0  # periods of the lowest cutoff: shorter recordings are left out, unless all are

Chosen = tuple[Candidate, ...]  # one candidate a target


@dataclass(frozen=True, eq=False)
class Work:
    """What every stage is given: the study, whom to tell, who computes; and the book of what the stages took.

    `seconds` is the time of each stage, `memory` the most that the process had held, in bytes, when it ended.
    """

    study: Study
    monitor: Monitor
    workers: Workers
    seconds: dict[str, float] = field(default_factory=dict)
    memory: dict[str, int | None] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Tell that a stage begins, and book what it took; a stage may have several parts.

        Raises:
            Stopped: the run is to end.
        """
        self.monitor.check()
        self.monitor.tell(StageBegan(name))
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
        self.memory[name] = peak_bytes()


@dataclass(frozen=True, eq=False)
class Prepared:
    """The recordings, as far as they stand in memory, the library of each target, and the mechanisms of other forms.

    There are no libraries where relations do not compete.
    """

    sample: Sample
    libraries: tuple[Library, ...]
    mechanisms: Mapping[Form, Mechanisms]


def prepare(work: Work, data: Records | Table | Sequence[Table] | None, store: Path | None) -> Prepared:
    """Return the recordings, checked, and the libraries.

    Args:
        work: whose study names the columns.
        data: recordings in memory, or None to read the study's files.
        store: folder of what is kept of a log that does not fit in memory.

    Raises:
        InputError: the data or the library are wrong, or too few samples are there to decide.
    """
    study = work.study
    with work.stage("records"):
        if data is None:
            sample = open_recordings(study.data, study.layout(), None if store is None else kept_in(store, study))
        else:
            sample = Sample(data if isinstance(data, Records) else records_from(data, study.layout()))
        check_channels(sample.records, study.measured(), study.driven())
    with work.stage("library"):
        mechanisms: dict[Form, Mechanisms] = {
            form: study.mechanisms(form) for form in study.forms() if form != "relations"
        }
        wanted = "relations" in study.forms()
        libraries = tuple(study.candidates(c.target) for c in study.measured()) if wanted else ()
        for c, library in zip(study.measured(), libraries, strict=wanted):
            if sample.records.samples < len(library):
                raise InputError(
                    f"{sample.records.samples} samples cannot decide between {len(library)} candidate terms for"
                    f" {c.target}: record longer, or shrink the library ([library] degree, basis or rules)"
                )
    return Prepared(sample, libraries, mechanisms)


def kept_in(folder: Path, study: Study) -> Store:
    """Return where a study keeps its factors: they depend on the options up to the rows of the regression.

    Raises:
        InputError: a piece of one's own cannot be compared with that of another run.
    """
    data = msgspec.structs.replace(study.data, files=())
    options = (study.coordinates, study.inputs, study.library, study.signals, study.regression.rows)
    return Store(folder, fingerprint((version("odescope"), versions(study), data, options)))


@dataclass(frozen=True, eq=False)
class Filtered:
    """The signals, and what was done to the records on the way to them.

    `sample` holds the records as they were recorded, `undelayed` those less outliers, `records` those with inputs as
    late as they act; recordings shorter than `shortest` seconds are gone from all, and `left_out` counts them. `lead`
    is dropped at the ends for the sake of delays, in seconds.
    """

    sample: Sample
    undelayed: Records
    records: Records
    signals: Signals
    inputs: tuple[Input, ...]
    lead: float | None
    delays: dict[str, Delay]
    clipping: Clipping | None
    outliers: dict[str, int]
    shortest: float
    left_out: int


def estimate(work: Work, prepared: Prepared) -> Filtered:
    """Return the signals of the recordings: outliers clipped, delays estimated, too short recordings left out.

    Raises:
        NoModelError: a coordinate holds nothing above its noise.
    """
    study, sample = work.study, prepared.sample
    records, outliers, clipping = sample.records, dict[str, int](), None
    if study.signals.outliers == "clip":
        with work.stage("signals"):
            records, outliers, clipping = _clipped(study, records)
    wanted = [name for name, i in study.inputs.items() if i.delay == "estimate"]
    inputs, delays = first_holds(records, study), dict[str, Delay]()
    if wanted:
        with work.stage("delays"):
            # Delays are found with relations, whatever form the model is to have.
            libraries = prepared.libraries or tuple(study.candidates(c.target) for c in study.measured())
            delays = _delays(work, records, libraries, wanted)
        inputs = tuple(with_delays(inputs, {name: d.seconds for name, d in delays.items()}))
    lead = max((abs(i.delay) for i in inputs), default=0.0) or None
    with work.stage("signals"):
        undelayed = records
        records = _acted(records, inputs, lead)
        signals = _signals(study, records, inputs)
        shortest = SHORTEST / min(c.cutoff for c in signals.channels)
        long = [run.duration >= shortest for run in records]
        left_out = long.count(False) if any(long) else 0
        if left_out:  # a piece of an oscillation has no derivative worth fitting
            sample = sample.without([not kept for kept in long])
            records, undelayed = (Records(tuple(compress(r, long))) for r in (records, undelayed))
            signals = _signals(study, records, inputs)
    return Filtered(
        sample, undelayed, records, signals, inputs, lead, delays, clipping, outliers,
        shortest if any(long) else 0.0, left_out,
    )  # fmt: skip


def settled(work: Work, filtered: Filtered, model: Model) -> Filtered:
    """Return the records and signals as a model sees them: less the offsets of sensors, inputs as late as they act.

    Args:
        work: whose study says how signals are filtered.
        filtered: as the model was looked for in.
        model: whose coordinates have offsets, and inputs delays.
    """
    coordinates, inputs = model.coordinates, model.inputs
    if inputs == filtered.inputs and not any(c.offset for c in coordinates):
        return filtered
    with work.stage("signals"):
        sample = replace(
            filtered.sample, records=Records.of(less_offsets(r, coordinates) for r in filtered.sample.records)
        )
        records = Records.of(less_offsets(r, coordinates) for r in filtered.undelayed)
        lead = max((abs(i.delay) for i in inputs), default=0.0) or None
        records = _acted(records, inputs, lead)
        signals = replace(_signals(work.study, records, inputs), coordinates=coordinates)
    return replace(filtered, sample=sample, records=records, signals=signals, inputs=inputs, lead=lead)


def _clipped(study: Study, records: Records) -> tuple[Records, dict[str, int], Clipping]:
    """Return the records without outliers, how many there were, and what they were told by."""
    coordinates, differentiator = study.measured(), study.signals.differentiator
    clipping = settle_clipping(records, coordinates, differentiator)
    clipped = clip_outliers(records.stretches, coordinates, differentiator, clipping)
    counts = count_clipped(records.stretches, clipped, coordinates)
    return Records.of(s.record for s in clipped), counts, clipping


def _acted(records: Records, inputs: Sequence[Input], lead: float | None) -> Records:
    """Return the records with the inputs as late as they act."""
    return Records.of(s.record for s in delayed(records.stretches, inputs, lead))


def _signals(study: Study, records: Records, inputs: Sequence[Input]) -> Signals:
    options = study.signals
    return estimate_signals(records, study.measured(), inputs, options.differentiator, options.margin, options.decimate)


def _delays(work: Work, records: Records, libraries: Sequence[Library], wanted: Sequence[str]) -> dict[str, Delay]:
    """Return the delays for which the criterion, summed over the targets, is least."""
    study, inputs = work.study, first_holds(records, work.study)
    period = 1.0 / max(c.cutoff for c in _signals(study, records, inputs).channels)
    lead = (LARGEST + 1.0) * period + max(abs(i.delay) for i in inputs)

    def cost(delays: Mapping[str, float]) -> float:
        work.monitor.check()
        signals = _signals(study, _acted(records, with_delays(inputs, delays), lead), inputs)
        total = 0.0
        for c, library in zip(study.measured(), libraries, strict=True):
            problem = pose(signals, c.target, c.order, library, study.regression.rows)
            try:
                total += min(x.criterion for x in rank(problem, _swept(work, problem), study.selection).candidates)
            except NoModelError:  # far from the delay nothing fits
                return np.inf
        return total

    return estimate_delays(cost, wanted, period)


def pose_all(work: Work, prepared: Prepared, filtered: Filtered) -> tuple[tuple[Problem, ...], Whole | None]:
    """Return the regression problem of each target, and what is kept of recordings that do not fit in memory.

    Args:
        work: whose study says how rows are made.
        prepared: the libraries.
        filtered: the signals of the recordings, or of a sample of them.

    Raises:
        InputError: a candidate is not finite, or a chunk cannot be read.
    """
    study, sample = work.study, filtered.sample
    with work.stage("regression"):
        problems = tuple(
            pose(filtered.signals, c.target, c.order, library, study.regression.rows, sample.folds)
            for c, library in zip(study.measured(), prepared.libraries, strict=True)
        )
    if sample.complete:
        return problems, None
    with work.stage("recordings"):
        plan = Plan(
            study.layout(), study.signals.differentiator, study.signals.margin, filtered.inputs, filtered.lead,
            filtered.clipping, filtered.shortest, replace(filtered.signals, columns=(), start=()),
            tuple(p.library for p in problems),
        )  # fmt: skip
        whole = reduce_all(sample, plan, problems, work.workers, work.monitor)
    return whole.problems, whole


def search_all(work: Work, prepared: Prepared, problems: Sequence[Problem]) -> tuple[Search, ...]:
    """Return the search for each target: every support found, and the candidates ranked.

    Args:
        work: whose study says who proposes and how candidates are ranked.
        prepared: the libraries, which know what their rules removed.
        problems: one a target.

    Raises:
        NoModelError: no candidate of a target is fit to be a relation.
    """
    study, searches = work.study, []
    for problem, library in zip(problems, prepared.libraries, strict=True):
        with work.stage("regression"):
            found = _swept(work, problem)
        with work.stage("selection"):
            ranked = rank(problem, found, study.selection)
            searches.append(Search(problem, found, ranked, library.removed, np.zeros(len(problem.terms))))
    return tuple(searches)


def _swept(work: Work, problem: Problem) -> Sweep:
    """Return all the supports that are found for a target."""
    proposers, check = work.study.regression.proposers, work.monitor.check
    return sweep(problem.factor, problem.terms, _nested(work.study, problem), proposers, check)


def _nested(study: Study, problem: Problem) -> tuple[Support, ...]:
    """Return the sets of columns that are searched in."""
    whole = (tuple(range(len(problem.terms))),)
    return nested_libraries(problem.terms, problem.own) if study.regression.nested else whole


def propose(work: Work, signals: Signals, searches: Sequence[Search]) -> list[tuple[Chosen, Model]]:
    """Return the best relations that together determine the targets, as many as the likelihood is to begin from.

    Args:
        work: whose study says how many.
        signals: on whose states no denominator may vanish.
        searches: one a target.

    Raises:
        NoModelError: no relations do.
    """
    with work.stage("model"):
        proposed = list(islice(proposals(work.study, signals, searches), work.study.likelihood.starts))
        if not proposed:
            raise NoModelError(
                "model", "the best relations of the targets do not determine them together: two say the same"
            )
    return proposed


def draw_anew(work: Work, searches: Sequence[Search], chosen: Chosen) -> tuple[Search, ...]:
    """Return the searches with the inclusion of every term.

    Args:
        work: whose study holds the seed.
        searches: one a target.
        chosen: the candidate of each target whose left-hand side is kept.
    """
    study, rng, drawn = work.study, np.random.default_rng(work.study.random.seed), []
    with work.stage("bootstrap"):
        for search, candidate in zip(searches, chosen, strict=True):
            work.monitor.check()
            nested, proposers = _nested(study, search.problem), study.regression.proposers
            shares = inclusion(search.problem, candidate, nested, proposers, rng, work.workers, work.monitor.check)
            drawn.append(replace(search, inclusion=shares))
    return tuple(drawn)


def pose_forms(
    work: Work,
    prepared: Prepared,
    filtered: Filtered,
    problems: Sequence[Problem],
    searches: Sequence[Search],
    proposals: Sequence[tuple[Chosen, Model]],
) -> tuple[Posed, ...]:
    """Return the forms that compete, mechanisms first, each with its candidates and where to begin.

    Args:
        work: whose study says how.
        prepared: the mechanisms.
        filtered: the records and their signals.
        problems: of the relations, one a target.
        searches: of the relations, one a target.
        proposals: of the regression, the best first.

    Raises:
        InputError: a tie names no candidate of the relations.
    """
    study, records, signals = work.study, filtered.records, filtered.signals
    mechanisms = [mechanisms_form(study, f, m, records, signals) for f, m in prepared.mechanisms.items()]
    relations = [relations_form(study, problems, searches, proposals)] if problems else []
    return (*mechanisms, *relations)


def refine_form(work: Work, filtered: Filtered, posed: Posed) -> Refinement | None:
    """Return what the likelihood of the recorded trajectory leads to in one form; None where no start can be followed.

    Args:
        work: whose study says how.
        filtered: the records and their signals.
        posed: the form.
    """
    with work.stage("likelihood"):
        return refine(
            filtered.records,
            filtered.signals,
            posed.mechanisms,
            posed.starts,
            posed.plain,
            posed.rival,
            lambda: posed.proposal,
            work.study.signals.differentiator,
            work.study.likelihood,
            work.monitor,
            work.workers,
            [name for name, i in work.study.inputs.items() if i.delay in ("auto", "estimate")],
            [name for name, i in work.study.inputs.items() if i.hold == "auto"],
        )
