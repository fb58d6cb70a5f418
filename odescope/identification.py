"""The pipeline: records to signals to candidates to one model (paper, end to end)."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import compress, islice, permutations, product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from odescope import __version__
from odescope.arrays import FloatArray
from odescope.delays import LARGEST, Delay, delayed, estimate_delays, with_delays
from odescope.errors import InputError, NoModelError
from odescope.library.candidates import Library
from odescope.library.expression import Term
from odescope.likelihood.account import likelihood_notes, likelihood_scores
from odescope.likelihood.stage import Refinement, refine
from odescope.memory import peak_bytes
from odescope.model.explicit import denominator_ranges
from odescope.model.model import Json, Model, Relation, RelationTerm
from odescope.model.notebook import model_html
from odescope.model.simulate import simulate
from odescope.readers import records_from
from odescope.records import Input, Records, check_channels
from odescope.regression.proposers import Support
from odescope.selection.bootstrap import inclusion
from odescope.selection.problem import Problem, pose
from odescope.selection.rank import Candidate, Ranked, left_column, price, rank
from odescope.selection.sweep import Sweep, nested_libraries, sweep
from odescope.signals.estimate import Signals, estimate_signals
from odescope.signals.outliers import clip_outliers
from odescope.streaming import Log, Plan, Store, Whole, open_log, reduce_all
from odescope.study import Study
from odescope.workers import Workers, workers

TRIED = 4  # families a target that are tried when the best do not determine the targets together
SHORTEST = 1.0  # periods of the lowest cutoff: shorter recordings are left out, unless all are
TOLD = 6  # notes of one kind
NEARLY = 2.0  # times what the chosen relation misses of its target, and
LEAST_MISSED = 0.01  # of its weighted power: what a plain start may miss
VALID_ERROR = 0.3  # the normalised state error that ends the valid time (METHOD section 10)

Watch = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Search:
    """What was done for one target: its regression problem, all supports found, the ranked candidates.

    `inclusion` (m,) is the share of bootstrap replicates that chose each term, with the chosen relation's guess.
    """

    problem: Problem
    found: Sweep
    ranked: Ranked
    removed: tuple[tuple[str, int], ...]
    inclusion: FloatArray


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
                f"{told['rows']:,} rows were read in {told['portions']} portions: all of them count in the regression;"
                f" cutoffs, ranking, likelihood and report rest on {told['sampled']} of the portions"
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
    with threadpool_limits(1, "blas"), workers(cluster) as hands:
        return _identify(study, data, watch, draft, hands, store)


def _identify(
    study: Study,
    data: Any,
    watch: Watch,
    draft: Callable[[Identification], None],
    hands: Workers,
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
        log = open_log(study.data, study.layout(), _kept_in(store, study)) if data is None else _given(study, data)
        check_channels(log.records, coordinates, study.driven())
    with stage("library"):
        libraries = [study.candidates(c.target) for c in coordinates]
        for c, library in zip(coordinates, libraries, strict=True):
            if log.records.samples < len(library):
                raise InputError(
                    f"{log.records.samples} samples cannot decide between {len(library)} candidate terms for"
                    f" {c.target}: record longer, or shrink the library ([library] degree, basis or rules)"
                )
    records, outliers, clipping = log.records, dict[str, int](), None
    if study.signals.outliers == "clip":
        with stage("signals"):
            records, outliers, clipping = clip_outliers(records, coordinates, study.signals.differentiator)
    inputs, delays = study.driven(), dict[str, Delay]()
    wanted = [name for name, i in study.inputs.items() if i.delay == "estimate"]
    if wanted:
        with stage("delays"):
            delays = _delays(study, records, libraries, wanted)
        inputs = with_delays(inputs, {name: d.seconds for name, d in delays.items()})
    lead = max((abs(i.delay) for i in inputs), default=0.0) or None
    with stage("signals"):
        records = delayed(records, inputs, lead)
        signals = _signals(study, records, inputs)
        shortest = SHORTEST / min(c.cutoff for c in signals.channels)
        long = [run.duration >= shortest for run in records]
        left_out = long.count(False) if any(long) else 0
        if left_out:  # a piece of an oscillation has no derivative worth fitting
            log, records = log.without([not kept for kept in long]), Records(tuple(compress(records, long)))
            signals = _signals(study, records, inputs)
    with stage("regression"):
        problems = [
            pose(signals, c.target, c.order, library, study.regression.rows, log.folds)
            for c, library in zip(coordinates, libraries, strict=True)
        ]
    whole = None
    if not log.complete or (log.portions and hands.remote):
        with stage("recordings"):
            options = study.signals
            plan = Plan(
                study.layout(), options.differentiator, options.margin, inputs, lead, clipping,
                shortest if left_out else 0.0, replace(signals, columns=(), start=()),
                tuple(p.library for p in problems),
            )  # fmt: skip
            whole = reduce_all(log, plan, problems, hands, watch)
            problems = list(whole.problems)
    searches = []
    for problem, library in zip(problems, libraries, strict=True):
        with stage("regression"):
            found = _swept(study, problem)
        with stage("selection"):
            ranked = rank(problem, found, study.selection)
            searches.append(Search(problem, found, ranked, library.removed, np.zeros(len(problem.terms))))
    with stage("model"):
        proposals = list(islice(_proposals(study, signals, searches), study.likelihood.starts))
        if not proposals:
            raise NoModelError(
                "model", "the best relations of the targets do not determine them together: two say the same"
            )
        chosen, model = proposals[0]
    with stage("bootstrap"):
        rng = np.random.default_rng(study.random.seed)
        searches = [_drawn_anew(study, s, c, rng, hands) for s, c in zip(searches, chosen, strict=True)]
    draft(Identification(study, log.records, signals, tuple(searches), chosen, model, None, seconds, memory))
    refinement = None
    if study.likelihood.enabled:
        with stage("likelihood"):
            starts = [m.relations for _, m in proposals]
            plain = [_plain(s, c, signals.targets) for s, c in zip(searches, chosen, strict=True)]
            refinement = refine(records, signals, problems, starts, plain, study.likelihood, watch, hands)
            model, refinement = _adopt(model, refinement, signals)
            chosen = tuple(
                _as_adopted(s, c, r, signals.targets) for s, c, r in zip(searches, chosen, model.relations, strict=True)
            )
    with stage("model"):
        scores = _scores(model, signals, searches, chosen, refinement, study.random.seed)
        if left_out:
            scores["left_out"] = left_out
        if outliers:
            scores["outliers"] = dict[str, Json](outliers)
        if delays:
            scores["delays"] = {n: {"delay": d.seconds, "std_error": d.std_error} for n, d in delays.items()}
        if not log.complete and whole is not None:
            scores["streamed"] = {"rows": whole.rows, "portions": whole.portions, "sampled": len(log.portions)}
        model = replace(model, scores=scores, domain=_domain(signals, model, whole))
        model = replace(model, provenance=_provenance(study, signals, whole))
    return Identification(study, log.records, signals, tuple(searches), chosen, model, refinement, seconds, memory)


def _given(study: Study, data: Any) -> Log:
    return Log(data if isinstance(data, Records) else records_from(data, study.layout()))


def _kept_in(folder: Path | None, study: Study) -> Store | None:
    """Return the store of a study: what is kept depends on the options up to the rows of the regression."""
    if folder is None:
        return None
    data = msgspec.structs.replace(study.data, files=())
    options = (__version__, data, study.coordinates, study.inputs, study.library, study.signals, study.regression.rows)
    return Store(folder, hashlib.sha256(msgspec.json.encode(options)).hexdigest())


def _signals(study: Study, records: Records, inputs: Sequence[Input]) -> Signals:
    options = study.signals
    return estimate_signals(records, study.measured(), inputs, options.differentiator, options.margin, options.thin)


def _swept(study: Study, problem: Problem) -> Sweep:
    """Return all the supports that are found for a target."""
    return sweep(problem.factor, problem.terms, _nested(study, problem), study.regression.proposers)


def _nested(study: Study, problem: Problem) -> tuple[Support, ...]:
    """Return the sets of columns that are searched in."""
    whole = (tuple(range(len(problem.terms))),)
    return nested_libraries(problem.rests, problem.own) if study.regression.nested else whole


def _drawn_anew(study: Study, search: Search, chosen: Candidate, rng: np.random.Generator, hands: Workers) -> Search:
    """Return the search with the inclusion of every term."""
    nested = _nested(study, search.problem)
    return replace(search, inclusion=inclusion(search.problem, chosen, nested, study.regression.proposers, rng, hands))


def _delays(study: Study, records: Records, libraries: Sequence[Library], wanted: Sequence[str]) -> dict[str, Delay]:
    """Return the delays for which the criterion, summed over the targets, is least."""
    inputs = study.driven()
    period = 1.0 / max(c.cutoff for c in _signals(study, records, inputs).channels)
    lead = (LARGEST + 1.0) * period + max(abs(i.delay) for i in inputs)

    def cost(delays: Mapping[str, float]) -> float:
        signals = _signals(study, delayed(records, with_delays(inputs, delays), lead), inputs)
        total = 0.0
        for c, library in zip(study.measured(), libraries, strict=True):
            problem = pose(signals, c.target, c.order, library, study.regression.rows)
            try:
                total += min(x.criterion for x in rank(problem, _swept(study, problem), study.selection).candidates)
            except NoModelError:  # far from the delay nothing fits
                return np.inf
        return total

    return estimate_delays(cost, wanted, period)


def to_relation(problem: Problem, candidate: Candidate, targets: Sequence[str]) -> Relation:
    """Return a candidate as a relation, its target term with coefficient 1 first."""
    left = left_column(problem, candidate.support)
    terms = []
    for j in (left, *(j for j in candidate.support if j != left)):
        held = problem.terms[j].names & set(targets)
        terms.append(RelationTerm(min(held, default=None), problem.rests[j], float(candidate.xi[j])))
    return Relation(tuple(terms))


def _proposals(
    study: Study, signals: Signals, searches: Sequence[Search]
) -> Iterator[tuple[tuple[Candidate, ...], Model]]:
    """Yield the relations of the best families that together determine the targets, and their model, best first."""
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
        relations = tuple(to_relation(s.problem, c, signals.targets) for s, c in zip(searches, chosen, strict=True))
        model = Model(signals.coordinates, signals.inputs, relations)
        if _determined(model, signals):
            yield chosen, model


def _plain(search: Search, chosen: Candidate, targets: Sequence[str]) -> Relation:
    """Return the shortest relation that holds its target bare and predicts it nearly as well; else the chosen one.

    Its denominator cannot vanish, and a search adds what it lacks more surely than it drops look-alikes.
    """
    problem, missed = search.problem, NEARLY * (1.0 - chosen.explained) + LEAST_MISSED
    bare = [
        c
        for c in search.ranked.candidates
        if set(c.support) & set(problem.own) == {problem.left} and 1.0 - c.explained <= missed
    ]
    return to_relation(problem, min(bare, key=lambda c: (len(c.support), c.criterion), default=chosen), targets)


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
    allowed = price(factor.rows, factor.width) / factor.rows
    return bool(factor.residual(chosen.xi - same) ** 2 <= allowed * noise**2)


def _adopt(model: Model, refinement: Refinement | None, signals: Signals) -> tuple[Model, Refinement | None]:
    """Return the model of the likelihood stage where it follows the record, else that of the regression.

    A refinement whose denominators vanish inside the data is dropped: its errors are those of another model.
    """
    if refinement is None or not refinement.follows:
        return model, refinement
    refined = replace(model, relations=refinement.relations)
    return (refined, refinement) if _determined(refined, signals) else (model, None)


def _as_adopted(search: Search, chosen: Candidate, relation: Relation, targets: Sequence[str]) -> Candidate:
    """Return the candidate with the terms of the model's relation; where none has them, the one chosen before."""
    adopted = {(t.factor, t.term) for t in relation.terms}

    def products(candidate: Candidate) -> set[tuple[str | None, Term]]:
        return {
            (min(search.problem.terms[j].names & set(targets), default=None), search.problem.rests[j])
            for j in candidate.support
        }

    return next((c for c in search.ranked.candidates if products(c) == adopted), chosen)


def _rows(signals: Signals, model: Model) -> list[FloatArray]:
    index = [signals.row(name) for name in model.variables]
    return [columns[index] for columns in signals.columns]


def _determined(model: Model, signals: Signals) -> bool:
    """Say whether no denominator of the explicit form vanishes or changes sign inside the data."""
    try:
        ranges = denominator_ranges(model, np.concatenate(_rows(signals, model), axis=1), np.random.default_rng(0))
    except InputError:
        return False
    return all(r["data"][0] * r["data"][1] > 0.0 for r in ranges.values())


def _domain(signals: Signals, model: Model, whole: Whole | None) -> dict[str, tuple[float, float]]:
    """Return the range of every state and input over all the data."""
    joined = np.concatenate(_rows(signals, model), axis=1)
    low, high = joined.min(axis=1), joined.max(axis=1)
    if whole is not None:
        index = [signals.row(name) for name in model.variables]
        low, high = np.minimum(low, whole.low[index]), np.maximum(high, whole.high[index])
    return dict(zip(model.variables, zip(low.tolist(), high.tolist(), strict=True), strict=True))


def _scores(
    model: Model,
    signals: Signals,
    searches: Sequence[Search],
    chosen: Sequence[Candidate],
    refinement: Refinement | None,
    seed: int,
) -> dict[str, Json]:
    rows = _rows(signals, model)
    ranges = denominator_ranges(model, np.concatenate(rows, axis=1), np.random.default_rng(seed))
    targets: dict[str, Json] = {}
    for c, s in zip(chosen, searches, strict=True):
        denominator: dict[str, Json] = {where: list[Json](ends) for where, ends in ranges[c.target].items()}
        targets[c.target] = {
            "r2_held_out": c.target_r2,
            "rmse_held_out": c.target_rmse,
            "explained_held_out": c.explained,
            "condition": s.problem.factor.condition(c.support),
            "denominator": denominator,
        }
    longest = max(rows, key=lambda r: r.shape[1])
    scores: dict[str, Json] = {"targets": targets, "free_run": _free_run(model, signals, longest)}
    if refinement is not None:
        scores["likelihood"] = likelihood_scores(refinement, signals.targets)
    return scores


def _free_run(model: Model, signals: Signals, variables: FloatArray) -> dict[str, Json]:
    """Simulate the last fifth of the longest record from its first state; valid until the error passes 0.3."""
    tail = variables[:, -max(variables.shape[1] // 5, 2) :]
    states, inputs = tail[: len(model.states)].T, tail[len(model.states) :].T
    t = np.arange(len(states), dtype=np.float64) * np.float64(signals.period)
    run = simulate(model, t, np.ascontiguousarray(inputs), np.ascontiguousarray(states[0]))
    spread = np.maximum(np.concatenate(list(signals.columns), axis=1).std(axis=1), 1e-300)
    scale = np.array([spread[signals.row(s)] for s in model.states])
    reached = len(run.t)
    error = np.sqrt(np.mean(((run.states - states[:reached]) / scale) ** 2, axis=1))
    late = np.flatnonzero(error > VALID_ERROR)
    valid = float(t[late[0]]) if late.size else float(t[reached - 1])
    return {"duration": float(t[-1]), "valid_time": valid, "ended": run.ended}


def _provenance(study: Study, signals: Signals, whole: Whole | None) -> dict[str, Json]:
    columns: dict[str, Json] = dict(study.layout().columns)
    channels: dict[str, Json] = {c.name: {"noise": c.noise, "cutoff_hz": c.cutoff} for c in signals.channels}
    return {
        "odescope": __version__,
        "time": study.data.time,
        "columns": columns,
        "channels": channels,
        "recordings": len(signals.columns) if whole is None else whole.recordings,
        "seed": study.random.seed,
    }
