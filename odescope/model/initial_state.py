"""The initial state of a free run: positions are measured, velocities are not, so a short stretch is fitted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from odescope.arrays import FloatArray
from odescope.model.model import Model
from odescope.model.simulation import simulate
from odescope.recordings.record import Record
from odescope.signals.differentiators import Spectral

STRETCH = 4  # periods of the lowest cutoff
LEAST_SAMPLES = 16
ITERATIONS = 20
LONGEST = 32  # times the shortest stretch
FOLLOWED = 1.5  # root mean square misfit over the noise, up to which a model is said to follow


def initial_state(model: Model, record: Record) -> FloatArray:
    """Return the state (n,) at the first sample.

    Filtered values and derivatives start it; then the measured coordinates of a short first stretch are fitted by the
    model's own free run, by Levenberg-Marquardt that accepts only improvement.

    Args:
        model: its coordinates and inputs are columns of the record.
        record: uniformly sampled, in the units of the model.
    """
    period = record.sample_period
    found = {c.name: Spectral().derivatives([record.column(c.name)], period, c.order) for c in model.coordinates}
    first = {c.derivative(k): found[c.name].values[0][k, 0] for c in model.coordinates for k in range(c.order)}
    start = np.array([first[s] for s in model.states])
    if all(c.order == 1 for c in model.coordinates) and all(d.noise == 0.0 for d in found.values()):
        return np.array([record.column(c.name)[0] for c in model.coordinates])
    lowest = min(d.cutoff for d in found.values())
    shortest = min(max(round(STRETCH / (lowest * period)), LEAST_SAMPLES, 4 * len(start)), len(record))
    weights = np.array([1.0 / max(found[c.name].noise, 1e-9 * _size(record, c.name)) for c in model.coordinates])
    measured = np.column_stack([record.column(c.name) for c in model.coordinates])
    inputs = np.array([record.column(i.name) for i in model.inputs]).reshape(len(model.inputs), len(record)).T
    place = [model.states.index(c.name) for c in model.coordinates]
    sizes = np.array([_size(record, c.name) for c in model.coordinates])

    def fit(length: int, state: FloatArray) -> tuple[FloatArray, float]:
        def misfit(trial: FloatArray) -> FloatArray | None:
            run = simulate(model, record.t[:length], np.ascontiguousarray(inputs[:length]), trial)
            return None if run.ended else ((run.states[:, place] - measured[:length]) * weights).ravel()

        return _fit(misfit, state, float(sizes.max()))

    length = shortest
    state, error = fit(length, start)
    # A longer stretch says more about the first sample for as long as the model follows it to within the noise.
    while error <= FOLLOWED and length < min(LONGEST * shortest, len(record)):
        length = min(2 * length, len(record))
        better, error = fit(length, state)
        if error <= FOLLOWED:
            state = better
    return state


def _size(record: Record, name: str) -> float:
    return max(float(np.ptp(record.column(name))), 1e-300)


def _fit(misfit: Callable[[FloatArray], FloatArray | None], state: FloatArray, size: float) -> tuple[FloatArray, float]:
    """Return the state of least misfit and its root mean square, infinite where the run cannot be followed."""
    residual = misfit(state)
    damping = 1e-3
    for _ in range(ITERATIONS):
        if residual is None:
            return state, np.inf
        step = 1e-6 * np.maximum(np.abs(state), size)
        moved = [misfit(state + d) for d in np.diag(step)]
        shifted = [m for m in moved if m is not None]
        if len(shifted) < len(moved):
            break
        jacobian = np.column_stack([(s - residual) / h for s, h in zip(shifted, step, strict=True)])
        normal = jacobian.T @ jacobian
        move = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), -jacobian.T @ residual, rcond=None)[0]
        trial = misfit(state + move)
        if trial is None or trial @ trial >= residual @ residual:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        gained = 1.0 - (trial @ trial) / (residual @ residual)
        state, residual, damping = state + move, trial, damping / 10.0
        if gained < 1e-6:
            break
    return state, np.inf if residual is None else float(np.sqrt(np.mean(residual**2)))
