"""Inputs that act later than they were recorded: a constant dead time of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from odescope.errors import InputError
from odescope.recordings.between_samples import shifted
from odescope.recordings.coordinate import Input
from odescope.recordings.record import Record, Stretch, within

GRID = 0.25  # periods of the highest cutoff between the first trials
LARGEST = 4.0  # such periods: the longest delay that is looked for
PRECISION = 0.01  # of a step of that grid
PRICE = 10.0  # fall of the cost that makes a delay credible
ROUNDS = 3  # over several inputs, each in turn


@dataclass(frozen=True)
class Delay:
    """A dead time in seconds and its standard error, None where the cost has no curvature there."""

    seconds: float
    std_error: float | None


def with_delays(inputs: Sequence[Input], delays: Mapping[str, float]) -> tuple[Input, ...]:
    """Return the inputs with these delays, by name; the others keep theirs."""
    return tuple(msgspec.structs.replace(i, delay=delays.get(i.name, i.delay)) for i in inputs)


def delayed(stretches: Sequence[Stretch], inputs: Sequence[Input], lead: float | None = None) -> tuple[Stretch, ...]:
    """Return records with each input as it acted, u(t - delay).

    Of records that are cut out of longer ones those are dropped of which nothing that counts is left.

    Args:
        stretches: uniformly sampled.
        inputs: a delay of 0 leaves the column as it is; a negative one means recorded late.
        lead: seconds dropped at both ends, where an input may not be known; None drops nothing and keeps the first or
            last value there.

    Raises:
        InputError: a whole recording is shorter than what is dropped.
    """
    if lead is None and not any(i.delay for i in inputs):
        return tuple(stretches)
    acted = []
    for stretch in stretches:
        dropped = _dropped(stretch.record, lead)
        first, stop = max(stretch.first - dropped, 0), min(stretch.stop, len(stretch.record) - dropped) - dropped
        if not stretch.cut or (first < stop and len(stretch.record) - 2 * dropped > 1):
            record = _delayed(stretch.record, inputs, dropped)
            acted.append(replace(stretch, record=record, first=first, stop=stop))
    return tuple(acted)


def remaining(run: Record, lead: float | None) -> float:
    """Return the seconds of a record that are left where `lead` seconds are dropped at both ends."""
    return run.duration - 2 * _dropped(run, lead) * run.sample_period


def _dropped(run: Record, lead: float | None) -> int:
    return 0 if lead is None else int(np.ceil(lead / run.sample_period - 1e-9))


def _delayed(run: Record, inputs: Sequence[Input], dropped: int) -> Record:
    values = run.values.copy()
    for i in inputs:
        column, at = run.names.index(i.name), run.t - i.delay
        if i.hold == "linear":
            values[:, column] = np.interp(at, run.t, run.values[:, column])
        elif i.hold == "band-limited":
            values[:, column] = shifted(run.values[:, column], i.delay / run.sample_period)
        elif i.delay:
            before = np.searchsorted(run.t, at + 1e-9 * run.sample_period, side="right") - 1
            values[:, column] = run.values[np.clip(before, 0, len(run) - 1), column]
    if len(run) - 2 * dropped < 2:
        raise InputError(
            f"a delay of {dropped * run.sample_period:.3g} s leaves nothing of a record of {run.duration:.3g} s"
            f"{within(run.source)}"
        )
    return replace(run, values=values).part(dropped, len(run) - dropped)


def estimate_delays(
    cost: Callable[[Mapping[str, float]], float], names: Sequence[str], period: float
) -> dict[str, Delay]:
    """Return the delays of least cost, each input's in turn; 0 where that is hardly dearer.

    Args:
        cost: -2 log of the likelihood, or what behaves like it, given a delay for every name; infinite where nothing
            fits.
        names: the inputs.
        period: of the highest cutoff, in seconds; delays up to four of them, late or early, are looked for.
    """
    from scipy.optimize import minimize_scalar

    found = dict.fromkeys(names, 0.0)
    step = GRID * period
    grid = step * np.arange(-round(LARGEST / GRID), round(LARGEST / GRID) + 1)
    for _ in range(1 if len(names) == 1 else ROUNDS):
        before = dict(found)
        for name in names:

            def along(delay: float, name: str = name) -> float:
                return cost(found | {name: float(delay)})

            costs = np.array([along(d) for d in grid])
            if not np.isfinite(costs).any():
                continue
            first, most = grid[int(np.argmin(costs))], float(costs[np.isfinite(costs)].max())
            best = minimize_scalar(
                lambda delay, along=along, most=most: min(along(delay), most),
                bounds=(first - step, first + step),
                method="bounded",
                options={"xatol": PRECISION * step},
            )
            found[name] = float(best.x)
        if all(abs(found[n] - before[n]) < PRECISION * step for n in names):
            break
    for name in names:
        if not cost(found) < cost(found | {name: 0.0}) - PRICE:
            found[name] = 0.0
    return {name: Delay(found[name], _curvature_error(cost, found, name, 0.1 * step)) for name in names}


def _curvature_error(
    cost: Callable[[Mapping[str, float]], float], found: Mapping[str, float], name: str, step: float
) -> float | None:
    low, middle, high = (cost({**found, name: found[name] + d}) for d in (-step, 0.0, step))
    if not np.isfinite([low, middle, high]).all():
        return None
    curvature = (low - 2.0 * middle + high) / step**2
    return float(np.sqrt(2.0 / curvature)) if 0.0 < curvature < np.inf else None
