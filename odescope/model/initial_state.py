"""The initial state of a free run: positions are measured, velocities are not, so a short stretch is fitted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from odescope.arrays import FloatArray
from odescope.model.model import Model
from odescope.model.simulation import drive, follow, known_from
from odescope.recordings.record import Record, Records, less_offsets
from odescope.signals.differentiators import Differentiator, Spectral
from odescope.signals.filling import filled, measured_derivatives

STRETCH = 4  # periods of the lowest cutoff
LEAST_SAMPLES = 16
EVALUATIONS = 20  # of the misfit of the shortest stretch, besides those for its slopes,
FURTHER = 4  # and of a longer one, which the fit to the shorter one begins near its end or not at all
LONGEST = 32  # times the shortest stretch
FOLLOWED = 1.5  # root mean square misfit over the noise, up to which a model is said to follow
STEP = 1e-6  # of a difference quotient, in sizes of the coordinates: well above the tolerance of the integration
CONVERGED = 1e-4  # relative fall of the cost that ends a fit: a hundredth of what chance does to a few hundred samples

_DEFAULT = Spectral()


class _NotFollowedError(Exception):
    """A free run beside the present one ended early, so that the misfit has no slope there."""


def initial_state(model: Model, record: Record, differentiator: Differentiator = _DEFAULT) -> FloatArray:
    """Return the state (n,) at the first sample.

    Filtered values and derivatives start it; then the measured coordinates of a short first stretch are fitted by the
    model's own free run; values that nobody measured have no part in that, nor those before an input that acts late was
    recorded (`known_from`).

    Args:
        model: its coordinates and inputs are columns of the record.
        record: uniformly sampled, in the units of the model; as it was recorded, whatever the offsets of coordinates
            and the delays of inputs.
        differentiator: filters and differentiates the coordinates.
    """
    record = less_offsets(record, model.coordinates)
    period = record.sample_period
    (record,) = filled(Records.of(record), model.coordinates, differentiator)
    found = {c.name: measured_derivatives(Records.of(record), c, differentiator) for c in model.coordinates}
    first = {c.derivative(k): found[c.name].values[0][k, 0] for c in model.coordinates for k in range(c.order)}
    start = np.array([first[s] for s in model.states])
    if all(c.order == 1 for c in model.coordinates) and all(d.noise == 0.0 for d in found.values()):
        return np.array([record.column(c.name)[0] for c in model.coordinates])
    lowest = min(d.cutoff for d in found.values())
    shortest = min(max(round(STRETCH / (lowest * period)), LEAST_SAMPLES, 4 * len(start)), len(record))
    weights = np.array([1.0 / max(found[c.name].noise, 1e-9 * _size(record, c.name)) for c in model.coordinates])
    measured = np.column_stack([record.column(c.name) for c in model.coordinates])
    counts = np.column_stack([record.counted(c.name) for c in model.coordinates])
    counts[: known_from(model.inputs, record.t)] = 0.0
    enough = np.flatnonzero(np.cumsum(np.count_nonzero(counts, axis=1)) >= LEAST_SAMPLES)
    shortest = max(shortest, int(enough[0]) + 1 if len(enough) else len(record))
    inputs = np.array([record.column(i.name) for i in model.inputs]).reshape(len(model.inputs), len(record)).T
    driven = drive(model.inputs, record.t, inputs)
    place = [model.states.index(c.name) for c in model.coordinates]
    size = max(_size(record, c.name) for c in model.coordinates)

    def fit(length: int, state: FloatArray, evaluations: int) -> tuple[FloatArray, float]:
        t, inside = record.t[:length], driven.first(length)

        def misfit(trial: FloatArray) -> FloatArray:
            run = follow(model, t, inside, trial)
            off = np.full((length, len(place)), np.nan)
            if run.ended is None:
                off = (run.states[:, place] - measured[:length]) * weights * np.sqrt(counts[:length])
            return off[counts[:length] > 0.0]

        return _fit(misfit, state, size, evaluations)

    length = shortest
    state, error = fit(length, start, EVALUATIONS)
    # A longer stretch says more about the first sample for as long as the model follows it to within the noise.
    while error <= FOLLOWED and length < min(LONGEST * shortest, len(record)):
        length = min(2 * length, len(record))
        better, error = fit(length, state, FURTHER)
        if error <= FOLLOWED:
            state = better
    return state


def _size(record: Record, name: str) -> float:
    return max(float(np.ptp(record.column(name))), 1e-300)


def _fit(
    misfit: Callable[[FloatArray], FloatArray], state: FloatArray, size: float, evaluations: int
) -> tuple[FloatArray, float]:
    """Return the state of least misfit and its root mean square, infinite where the run or nothing can be followed.

    Args:
        misfit: of a state (n,), in standard deviations; not finite where the free run from there ends early.
        state: (n,) to start from.
        size: of the coordinates.
        evaluations: of the misfit at most, besides those for its slopes.
    """
    last = misfit(state)

    def followed(trial: FloatArray) -> FloatArray:
        nonlocal last
        last = misfit(trial)
        return last

    def slopes(trial: FloatArray) -> FloatArray:
        steps, base = STEP * np.maximum(np.abs(trial), size), last  # slopes are asked for where the misfit just was
        columns = [(misfit(trial + move) - base) / step for move, step in zip(np.diag(steps), steps, strict=True)]
        if not np.all(np.isfinite(columns)):
            raise _NotFollowedError
        return np.column_stack(columns)

    if not len(last) or not np.all(np.isfinite(last)):
        return state, np.inf
    try:
        found = least_squares(followed, state, slopes, x_scale="jac", ftol=CONVERGED, max_nfev=evaluations)
    except _NotFollowedError:
        return state, np.inf
    return found.x, float(np.sqrt(np.mean(found.fun**2)))
