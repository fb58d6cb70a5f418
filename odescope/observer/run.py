"""One recording through the filter and, back, through the smoother."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.errors import InputError, nearest
from odescope.model.driven_record import DrivenRecord
from odescope.model.integration import Drive
from odescope.model.model import Model
from odescope.observer.first_state import FirstState, first_state
from odescope.observer.kernel import Begin, Course, Readings, backward, forward
from odescope.observer.linearised import LinearisedModel, linearise
from odescope.observer.noise import ObserverNoise
from odescope.recordings.record import Record, less_offsets

TOLERANCE = 1e-9  # of a step of the integration, relative to the sizes of the states
FORGOTTEN = 0.2  # of the standard deviation at the start: below, the start says no more
LEAST_SETTLING = 10  # samples
MOST_SETTLING = 4  # part of a record, at most, that settles


@dataclass(frozen=True, eq=False)
class StateEstimate:
    """The states of one recording, as the observer knows them.

    Shapes, for N samples, n states, c coordinates: t (N,) seconds; states, std (N, n) in the order of `names`;
    innovations, expected (N, c) readings less their predictions from all earlier ones and the standard deviation of
    that, NaN where nothing was measured; squared (N,) innovations in units of their covariance, summed. The first
    `settling` samples do not count for consistency. `ended` says why the filter stopped early, where it did.
    """

    t: FloatArray
    states: FloatArray
    std: FloatArray
    names: tuple[str, ...]
    innovations: FloatArray
    expected: FloatArray
    squared: FloatArray
    settling: int
    log_likelihood: float
    ended: str | None
    source: str

    def column(self, name: str) -> FloatArray:
        """Return one state (N,); InputError names the nearest where there is none."""
        return self.states[:, self._place(name)]

    def column_std(self, name: str) -> FloatArray:
        """Return the standard deviations (N,) of one state; InputError as for `column`."""
        return self.std[:, self._place(name)]

    def _place(self, name: str) -> int:
        if name not in self.names:
            raise InputError(f"no state {name!r}; {nearest(name, self.names)}")
        return self.names.index(name)


@dataclass(frozen=True, eq=False)
class ReadyRecord:
    """A recording and its model as the kernels take them.

    Shapes: y (N, c) readings less their offsets; counts (N, c) how many samples are behind each, 0 before what acts is
    known.
    """

    model: Model
    equations: LinearisedModel
    record: Record
    driven: Drive
    y: FloatArray
    counts: FloatArray
    first: FirstState
    vague: bool

    @staticmethod
    def of(model: Model, record: Record, start: tuple[FloatArray, FloatArray] | None = None) -> ReadyRecord:
        """Return a record ready for the filter.

        Args:
            model: whose equations are integrated.
            record: with its coordinates and inputs.
            start: (n,) and (n, n), the state before the first reading and the covariance of its error; None where
                nothing is known of it.
        """
        plain = less_offsets(record, model.coordinates)
        first = first_state(model, record)
        counts = np.column_stack([record.counted(c.name) for c in model.coordinates])
        counts[: first.known] = 0.0
        if start is not None:
            first = replace(first, mean=np.array(start[0], dtype=np.float64), covariance=start[1])
        return ReadyRecord(
            model=model,
            equations=linearise(model),
            record=record,
            driven=DrivenRecord.of(model, record).driven,
            y=np.column_stack([plain.column(c.name) for c in model.coordinates]),
            counts=counts,
            first=first,
            vague=start is None,
        )

    @property
    def angles(self) -> BoolArray:
        """Which coordinates are angles, (c,)."""
        return np.array([c.angle for c in self.model.coordinates], dtype=np.bool_)

    def part(self, samples: int) -> ReadyRecord:
        """Return the first samples alone."""
        if samples >= len(self.record):
            return self
        return replace(
            self,
            record=self.record.part(0, samples),
            driven=self.driven.part(0, samples),
            y=self.y[:samples],
            counts=self.counts[:samples],
        )


def run_filter(prepared: ReadyRecord, noise: ObserverNoise, smooth: bool = False) -> StateEstimate:
    """Return the states of a recording.

    Args:
        prepared: the recording.
        noise: of sensors and equations.
        smooth: whether a state rests on later readings, too.
    """
    model, first = prepared.model, prepared.first
    measured, course, reached = _filtered(prepared, noise, smooth)
    samples = len(prepared.record)
    std = course.deviation[:reached]
    settling = 0
    if prepared.vague:
        known = min(first.known, reached)
        settling = known + _settling(std[known:], np.sqrt(np.diag(first.covariance)), samples - known)
    if smooth:
        kept = Course(*(part if part.shape[0] == 1 else part[:reached] for part in course))
        backward(Readings(measured.y[:reached], measured.variance[:reached], measured.state, measured.angle), kept)
    ended = None
    if reached < samples:
        ended = f"the filter ended early, after {reached} of {samples} samples: the equations could not be followed"
    return StateEstimate(
        t=prepared.record.t[:reached],
        states=course.state[:reached],
        std=std,
        names=model.states,
        innovations=course.innovation[:reached],
        expected=course.expected[:reached],
        squared=course.squared[:reached],
        settling=settling,
        log_likelihood=-0.5 * float(course.cost[0]),
        ended=ended,
        source=prepared.record.source,
    )


def negative_log_likelihood(prepared: ReadyRecord, noise: ObserverNoise) -> float:
    """Return -log of the likelihood of a recording, infinite where the filter ends early."""
    _, course, reached = _filtered(prepared, noise, smooth=False)
    return 0.5 * float(course.cost[0]) if reached == len(prepared.record) else float("inf")


def _filtered(prepared: ReadyRecord, noise: ObserverNoise, smooth: bool) -> tuple[Readings, Course, int]:
    model, first = prepared.model, prepared.first
    samples, channels = prepared.y.shape
    n = len(model.states)
    sigma = np.array([noise.measurement[c.name] for c in model.coordinates])
    there = prepared.counts > 0.0
    variance = np.where(there, sigma**2 / np.where(there, prepared.counts, 1.0), np.inf)
    place = np.array([model.states.index(c.name) for c in model.coordinates], dtype=np.int64)
    measured = Readings(np.ascontiguousarray(prepared.y), variance, place, prepared.angles)
    following = prepared.equations.following
    density = np.array([noise.process[model.targets[-1 - f]] ** 2 if f < 0 else 0.0 for f in following])
    kept = samples if smooth else 1
    course = Course(
        np.full((samples, n), np.nan),
        np.full((samples, n), np.nan),
        np.full((samples, channels), np.nan),
        np.full((samples, channels), np.nan),
        np.zeros(samples),
        np.zeros(1),
        np.empty((kept, n)),
        np.empty((kept, n, n)),
        np.empty((kept, n, n)),
    )
    # Where the start is not known, neither is what unrecorded inputs made of it.
    known = first.known if prepared.vague else 0
    begin = Begin(first.mean.copy(), np.array(first.covariance, dtype=np.float64, order="C"), known)
    reached = forward(prepared.equations, prepared.driven, measured, density, begin, first.sizes, TOLERANCE, course)
    return measured, course, int(reached)


def _settling(std: FloatArray, before: FloatArray, samples: int) -> int:
    """Return how many samples (N, n) pass until the start, known to within `before` (n,), is forgotten."""
    vague = np.any(std > FORGOTTEN * before, axis=1)
    late = int(np.flatnonzero(vague)[-1]) + 1 if vague.any() else 0
    return min(max(late, LEAST_SETTLING), samples // MOST_SETTLING)
