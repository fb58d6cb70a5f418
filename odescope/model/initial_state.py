"""The initial state of a free run: positions are measured, velocities are not, so a short stretch is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from odescope.arrays import BoolArray, FloatArray
from odescope.model.driven_record import DrivenRecord
from odescope.model.integration import Drive
from odescope.model.model import Model
from odescope.model.simulation import follow
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records, less_offsets
from odescope.signals.differentiators import Differentiator, Spectral
from odescope.signals.filling import filled, measured_derivatives

STRETCH = 4  # periods of the lowest cutoff
LEAST_SAMPLES = 16
EVALUATIONS = 20  # of the misfit of the shortest stretch, besides those for its slopes,
FURTHER = 4  # and of a longer one, which the fit to the shorter one begins near its end or not at all
LONGEST = 32  # times the shortest stretch
FOLLOWED = 1.5  # root mean square misfit over the noise, up to which a model is said to follow
EXACT = 1e-9  # of a coordinate's range: so well is known what shows no noise
STEP = 1e-6  # of a difference quotient, in sizes of the coordinates: well above the tolerance of the integration
CONVERGED = 1e-4  # relative fall of the cost that ends a fit: a hundredth of what chance does to a few hundred samples

_DEFAULT = Spectral()


class _NotFollowedError(Exception):
    """A free run beside the present one ended early, so that the misfit has no slope there."""


def initial_state(model: Model, record: Record, differentiator: Differentiator = _DEFAULT) -> FloatArray:
    """Return the state (n,) at the first sample.

    Filtered values and derivatives start it; then the measured coordinates of a short first stretch are fitted by the
    model's own free run; values that nobody measured have no part in that, nor those before an input that acts late was
    recorded (`known_from`). What reads constant, as a joint that rests, shows no noise to weigh it by: it stays where
    it reads, and the others are fitted.

    Args:
        model: its coordinates and inputs are columns of the record.
        record: uniformly sampled, in the units of the model; as it was recorded, whatever the offsets of coordinates
            and the delays of inputs.
        differentiator: filters and differentiates the coordinates.
    """
    return first_state_of(model, DrivenRecord.of(model, record), differentiator)


def first_state_of(model: Model, piece: DrivenRecord, differentiator: Differentiator = _DEFAULT) -> FloatArray:
    """Return the state (n,) at the first sample of a record, or of a piece of one: see `initial_state`.

    Args:
        model: its coordinates are columns of the record.
        piece: uniformly sampled.
        differentiator: filters and differentiates the coordinates.
    """
    record = less_offsets(piece.record, model.coordinates)
    period = record.sample_period
    rests = [c for c in model.coordinates if _rests(record, c)]
    amounts = [c.name for c in model.coordinates if c.order == 1 and _read(record, c).min(initial=np.inf) >= 0.0]
    (record,) = filled(Records.of(record), model.coordinates, differentiator)
    found = {c.name: measured_derivatives(Records.of(record), c, differentiator) for c in model.coordinates}
    first = {c.derivative(k): found[c.name].values[0][k, 0] for c in model.coordinates for k in range(c.order)}
    first |= {s: 0.0 if k else record.column(c.name)[0] for c in rests for k, s in enumerate(c.states)}
    for name in amounts:  # there is no less than nothing, where what grows in proportion to itself would stay
        if first[name] <= 0.0:
            first[name] = max(record.column(name)[0], 0.0) or found[name].noise
    start = np.array([first[s] for s in model.states])
    if all(c.order == 1 for c in model.coordinates) and all(d.noise == 0.0 for d in found.values()):
        return np.array([record.column(c.name)[0] for c in model.coordinates])
    moves = ~np.isin(model.states, [s for c in rests for s in c.states])
    if not moves.any():
        return start
    lowest = min(found[c.name].cutoff for c in model.coordinates if c not in rests)
    shortest = min(max(round(STRETCH / (lowest * period)), LEAST_SAMPLES, 4 * len(start)), len(record))
    sizes = [_size(record, c.name) for c in model.coordinates]
    deviations = np.array([max(found[c.name].noise, EXACT * s) for c, s in zip(model.coordinates, sizes, strict=True)])
    measured = np.column_stack([record.column(c.name) for c in model.coordinates])
    counts = np.column_stack([record.counted(c.name) * (c not in rests) for c in model.coordinates])
    counts[: piece.known] = 0.0
    enough = np.flatnonzero(np.cumsum(np.count_nonzero(counts, axis=1)) >= LEAST_SAMPLES)
    shortest = max(shortest, int(enough[0]) + 1 if len(enough) else len(record))
    least = np.where(np.isin(model.states, amounts), 0.0, -np.inf)
    weights = np.sqrt(counts) / deviations
    whole = _Stretch(model, record.t, piece.driven, measured, weights, moves, least, max(sizes))
    return whole.fitted(start, shortest)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """What a free run is fitted to.

    Shapes: t (N,) seconds; measured (N, c); weights (N, c) by which misfits count, 0 where nothing was measured; moves
    (n,) which states are fitted; least (n,) that they may be; size is that of the coordinates.
    """

    model: Model
    t: FloatArray
    driven: Drive
    measured: FloatArray
    weights: FloatArray
    moves: BoolArray
    least: FloatArray
    size: float

    def fitted(self, start: FloatArray, shortest: int) -> FloatArray:
        """Return the state (n,) that longer and longer stretches tell, from a start and the shortest of them on.

        A longer one says more for as long as the model follows it to within the noise, and where the run from what is
        known so far leaves more of it than chance would.
        """
        length = shortest
        begin = self.first(length)
        state, error = begin.fit(start, begin.misfit(start), EVALUATIONS)
        while error <= FOLLOWED and length < min(LONGEST * shortest, len(self.t)):
            by_chance = error * (1.0 + 1.0 / np.sqrt(2.0 * np.count_nonzero(begin.weights)))
            length = min(2 * length, len(self.t))
            begin = self.first(length)
            missed = begin.misfit(state)
            better, error = state, _root_mean_square(missed)
            if error > by_chance:
                better, error = begin.fit(state, missed, FURTHER, updated=True)
            if error <= FOLLOWED:
                state = better
        return state

    def fit(
        self, state: FloatArray, missed: FloatArray, evaluations: int, updated: bool = False
    ) -> tuple[FloatArray, float]:
        """Return the state (n,) of least misfit and its root mean square, see `_fit`."""

        def misfit(moved: FloatArray) -> FloatArray:
            return self.misfit(self._placed(state, moved))

        moves = self.moves
        better, error = _fit(misfit, state[moves], missed, self.least[moves], self.size, evaluations, updated)
        return self._placed(state, better), error

    def first(self, length: int) -> _Stretch:
        """Return the first samples alone."""
        t, driven, measured, weights = self.t[:length], self.driven.part(0, length), self.measured, self.weights
        return replace(self, t=t, driven=driven, measured=measured[:length], weights=weights[:length])

    def _placed(self, state: FloatArray, found: FloatArray) -> FloatArray:
        """Return a state (n,) with those of its values that are fitted set to what was found."""
        whole = state.copy()
        whole[self.moves] = found
        return whole

    def misfit(self, state: FloatArray) -> FloatArray:
        """Return the misfit of a state (n,) in standard deviations; not finite where its free run ends early."""
        run = follow(self.model, self.t, self.driven, state)
        off = np.full(self.measured.shape, np.nan)
        if run.ended is None:
            off = run.states[:, [self.model.states.index(c.name) for c in self.model.coordinates]] - self.measured
        counted = self.weights > 0.0
        return np.asarray(off[counted] * self.weights[counted])


def _size(record: Record, name: str) -> float:
    return max(float(np.ptp(record.column(name))), 1e-300)


def _read(record: Record, c: Coordinate) -> FloatArray:
    """Return the samples of a coordinate that were measured."""
    return record.column(c.name)[record.counted(c.name) > 0.0]


def _rests(record: Record, c: Coordinate) -> bool:
    """Say whether a coordinate reads constant wherever it was measured, if it was at all."""
    read = _read(record, c)
    return len(read) > 0 and bool(np.all(read == read[0]))


def _fit(
    misfit: Callable[[FloatArray], FloatArray],
    state: FloatArray,
    missed: FloatArray,
    least: FloatArray,
    size: float,
    evaluations: int,
    updated: bool,
) -> tuple[FloatArray, float]:
    """Return the state of least misfit and its root mean square, infinite where the run or nothing can be followed.

    Args:
        misfit: of a state (n,), in standard deviations; not finite where the free run from there ends early.
        state: (n,) to start from.
        missed: its misfit.
        least: (n,) that it may be.
        size: of the coordinates.
        evaluations: of the misfit at most, besides those for its slopes.
        updated: whether slopes are difference quotients at the start alone, and what a step shows of them after it:
            Broyden (1965), https://doi.org/10.1090/S0025-5718-1965-0198670-6.
    """
    at, last = state, missed
    known: tuple[FloatArray, FloatArray, FloatArray] | None = None  # where slopes were asked for, the misfit, they

    def followed(trial: FloatArray) -> FloatArray:
        nonlocal at, last
        if not np.array_equal(trial, at):
            at, last = trial.copy(), misfit(trial)
        return last

    def slopes(trial: FloatArray) -> FloatArray:
        nonlocal known
        if known is not None and updated:  # slopes are asked for where the misfit just was
            before, value, found = known
            step = trial - before
            found = found + np.outer(last - value - found @ step, step / (step @ step))
        else:
            found = quotients(trial)
        known = trial.copy(), last, found
        return found

    def quotients(trial: FloatArray) -> FloatArray:
        steps, base = STEP * np.maximum(np.abs(trial), size), last
        columns = [(misfit(trial + move) - base) / step for move, step in zip(np.diag(steps), steps, strict=True)]
        if not np.all(np.isfinite(columns)):
            raise _NotFollowedError
        return np.column_stack(columns)

    if not len(last) or not np.all(np.isfinite(last)):
        return state, np.inf
    try:
        found = least_squares(
            followed, state, slopes, (least, np.inf), x_scale="jac", ftol=CONVERGED, max_nfev=evaluations
        )
    except _NotFollowedError:
        return state, np.inf
    return found.x, _root_mean_square(found.fun)


def _root_mean_square(misfit: FloatArray) -> float:
    return float(np.sqrt(np.mean(misfit**2)))
