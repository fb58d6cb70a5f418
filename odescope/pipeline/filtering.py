"""From recordings to signals: read, checked, outliers and delays taken out, filtered."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import compress
from pathlib import Path

import msgspec
import numpy as np

from odescope.arrays import Table
from odescope.errors import InputError, NoModelError
from odescope.events import DelaysEstimated
from odescope.library.candidates import Library
from odescope.library.expression import Term
from odescope.model.model import Model
from odescope.pipeline.fingerprint import fingerprint
from odescope.pipeline.inputs import first_holds
from odescope.pipeline.ruled_out import Stays, mechanisms_that_stay, not_ruled_out
from odescope.pipeline.sample import Sample, open_recordings
from odescope.pipeline.store import Store
from odescope.pipeline.work import Work, swept
from odescope.recordings.checks import check_channels, check_seconds
from odescope.recordings.coordinate import Input
from odescope.recordings.periods import at_one_period
from odescope.recordings.readers import records_from
from odescope.recordings.record import Records, in_radians, less_offsets
from odescope.recordings.tables import on_uniform_time
from odescope.regression.problem import pose
from odescope.selection.ranking import rank
from odescope.signals.delays import LARGEST, Delay, delayed, estimate_delays, with_delays
from odescope.signals.estimate import Signals, estimate_signals, most_dropped
from odescope.signals.filling import filled
from odescope.signals.gated import Reasons, gated_records
from odescope.signals.outliers import Clipping, clip_outliers, count_clipped, settle_clipping
from odescope.signals.rates import refuse_rates
from odescope.signals.shafts import turning_together
from odescope.study.library_options import Form
from odescope.study.options import Mechanisms, Study
from odescope.study.pieces import versions

LEAST = 150  # samples that regression keeps of a short record: a default library has nearly as many candidates
OF_POSITIONS = 1.5  # samples for every candidate of a library of degree 2
SHORTEST = 1.0  # periods of the lowest cutoff: shorter recordings are left out, unless all are


@dataclass(frozen=True, eq=False)
class Prepared:
    """The recordings, as far as they stand in memory, the library of each target, and the mechanisms of other forms.

    There are no libraries where relations do not compete. Terms name the constants within functions. `shafts` are pairs
    of angles that go round together, which are no angles in `study`: that is whose candidates they are, here and later.
    """

    study: Study
    shafts: tuple[tuple[str, str], ...]
    sample: Sample
    libraries: tuple[Library, ...]
    mechanisms: Mapping[Form, Mechanisms]

    @property
    def terms(self) -> tuple[Term, ...]:
        """All candidate terms."""
        parts = (p for found, _ in self.mechanisms.values() for m in found for p in m.parts)
        return (*(t for library in self.libraries for t in library), *(p.product.term for p in parts))


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
            sample = Sample(_in_memory(study, data))
        sample = replace(sample, records=at_one_period(sample.records, study.layout()))
        check_channels(sample.records, study.measured(), study.driven())
        if study.data.time is not None and study.data.time_unit is None:
            check_seconds(sample.records)
    with work.stage("library"):
        fixed = study.library.terms is not None or study.library.preset == "paper"
        shafts = () if fixed else turning_together(sample.records, study.measured())
        posed = _without_angles(study, {name for pair in shafts for name in pair})
        stays, libraries = not_ruled_out(study, sample.records), tuple[Library, ...]()
        if "relations" in study.forms():
            left = sum(len(run) - 2 * most_dropped(len(run)) for run in sample.records)
            posed, libraries = _decidable(posed, stays, left)
        mechanisms: dict[Form, Mechanisms] = {
            form: posed.mechanisms(form) for form in study.forms() if form != "relations"
        }
    return Prepared(posed, shafts, sample, libraries, mechanisms_that_stay(mechanisms, stays))


def _libraries(study: Study, stays: Stays) -> tuple[Library, ...]:
    """Return the library of each target, of terms that stay."""
    return tuple(study.candidates(c.target).that(stays) for c in study.measured())


def _decidable(study: Study, stays: Stays, samples: int) -> tuple[Study, tuple[Library, ...]]:
    """Return a study and the library of each target, between whose candidates so many samples can decide.

    Where the default library has too many, it is of degree 2, of which the acceleration of a position asks for more.

    Args:
        study: says what the candidates are.
        stays: says of a candidate term whether the records rule it out.
        samples: how many there are without the ends of records.

    Raises:
        InputError: a library has more candidates than there are samples.
    """
    coordinates, libraries = study.measured(), _libraries(study, stays)
    many = next((pair for pair in zip(coordinates, libraries, strict=True) if samples < len(pair[1])), None)
    if many is None:
        return study, libraries
    if not study.library.by_hand:
        low = msgspec.structs.replace(study, library=msgspec.structs.replace(study.library, degree=2))
        fewer = _libraries(low, stays)
        asked = 1.0 if all(c.order == 1 for c in coordinates) else OF_POSITIONS
        if samples >= asked * max(map(len, fewer)):
            return low, fewer
    raise InputError(
        f"{samples} samples cannot decide between {len(many[1])} candidate terms for {many[0].target}: record longer,"
        " or shrink the library: [library] degree, rules or a basis"
    )


def _without_angles(study: Study, names: Collection[str]) -> Study:
    """Return a study whose library has powers of these angles in the place of their sines and cosines."""
    plain = {n: msgspec.structs.replace(c, angle=False) for n, c in study.coordinates.items() if n in names}
    return msgspec.structs.replace(study, coordinates=study.coordinates | plain)


def _in_memory(study: Study, data: Records | Table | Sequence[Table]) -> Records:
    layout = study.layout()
    if not isinstance(data, Records):
        return records_from(data, layout)
    return on_uniform_time(Records.of(in_radians(run, study.degrees) for run in data), layout)


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
    is dropped at the ends for the sake of delays, in seconds. `gated` says of each sample in `undelayed` why it does
    not count, where samples were gated.
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
    gated: Reasons
    shortest: float
    left_out: int


def estimate(work: Work, prepared: Prepared) -> Filtered:
    """Return the signals of the recordings: outliers clipped, delays estimated, too short recordings left out.

    Raises:
        NoModelError: a coordinate holds nothing above its noise.
        InputError: a coordinate is the velocity of another whose order is above 1.
    """
    study, sample = work.study, prepared.sample
    outliers, clipping = dict[str, int](), None
    gated: Reasons = {}
    gating, differentiator = study.signals.outliers == "gate", study.signals.differentiator
    with work.stage("signals"):
        if gating:
            records, gated = gated_records(sample.records, study.measured(), differentiator)
            outliers = {name: sum(int(np.count_nonzero(found)) for found in of) for name, of in gated.items()}
        else:
            records = filled(sample.records, study.measured(), differentiator)
    if study.signals.outliers == "clip":
        with work.stage("signals"):
            records, outliers, clipping = _clipped(study, records)
    inputs, delays = first_holds(records, study), dict[str, Delay]()
    wanted = [name for name, i in study.inputs.items() if i.delay == "estimate"]
    if wanted:
        with work.stage("delays"):
            # Delays are found with relations, whatever form the model is to have.
            libraries = prepared.libraries or _libraries(prepared.study, not_ruled_out(study, sample.records))
            libraries = tuple(library.without(study.parameters) for library in libraries)
            delays = _delays(work, records, libraries, wanted)
            if study.likelihood.enabled:
                delays = {name: _in_samples(d, records.runs[0].sample_period) for name, d in delays.items()}
        work.monitor.tell(DelaysEstimated({name: d.seconds for name, d in delays.items()}))
        inputs = tuple(with_delays(inputs, {name: d.seconds for name, d in delays.items()}))
    lead = max((abs(i.delay) for i in inputs), default=0.0) or None
    with work.stage("signals"):
        undelayed = records
        records = _acted(records, inputs, lead)
        signals = signals_of(study, records, inputs)
        shortest = SHORTEST / min(c.cutoff for c in signals.channels)
        long = [run.duration >= shortest for run in records]
        left_out = long.count(False) if any(long) else 0
        if left_out:  # a piece of an oscillation has no derivative worth fitting
            sample = sample.without([not kept for kept in long])
            records, undelayed = (Records(tuple(compress(r, long))) for r in (records, undelayed))
            gated = {name: tuple(compress(found, long)) for name, found in gated.items()}
            signals = signals_of(study, records, inputs)
    refuse_rates(signals)
    return Filtered(
        sample, undelayed, records, signals, inputs, lead, delays, clipping, outliers, gated,
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
        signals = replace(signals_of(work.study, records, inputs), coordinates=coordinates)
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


def signals_of(study: Study, records: Records, inputs: Sequence[Input]) -> Signals:
    """Return the signals of records, filtered as a study says.

    Args:
        study: the options.
        records: less outliers.
        inputs: what drove them.
    """
    options = study.signals
    return estimate_signals(
        records, study.measured(), inputs, options.differentiator, options.margin, options.decimate, LEAST
    )


def _in_samples(delay: Delay, period: float) -> Delay:
    """Return a delay in whole samples: between them the input would be interpolated before its hold is known.

    The likelihood finds the rest.
    """
    return replace(delay, seconds=period * round(delay.seconds / period))


def _delays(work: Work, records: Records, libraries: Sequence[Library], wanted: Sequence[str]) -> dict[str, Delay]:
    """Return the delays for which the criterion, summed over the targets, is least."""
    study, inputs = work.study, first_holds(records, work.study)
    period = 1.0 / max(c.cutoff for c in signals_of(study, records, inputs).channels)
    lead = (LARGEST + 1.0) * period + max(abs(i.delay) for i in inputs)

    def cost(delays: Mapping[str, float]) -> float:
        work.monitor.check()
        signals = signals_of(study, _acted(records, with_delays(inputs, delays), lead), inputs)
        total = 0.0
        for c, library in zip(study.measured(), libraries, strict=True):
            problem = pose(signals, c.target, c.order, library, study.regression.rows)
            try:
                total += min(x.criterion for x in rank(problem, swept(work, problem), study.selection).candidates)
            except NoModelError:  # far from the delay nothing fits
                return np.inf
        return total

    return estimate_delays(cost, wanted, period)
