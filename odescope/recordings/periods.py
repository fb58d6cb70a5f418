"""Recordings that were sampled at different periods come to one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odescope.recordings.gaps import RawRun
from odescope.recordings.layout import Layout
from odescope.recordings.record import Record, Records, Stretch
from odescope.recordings.uniform import on_grid

PERIODS_DIFFER = 1e-4  # of a period: up to here recordings count as sampled alike


def common_period(records: Records) -> float:
    """Return the median of all steps between samples, in the unit of time."""
    periods = np.array([run.sample_period for run in records])
    order = np.argsort(periods, kind="stable")
    steps = np.cumsum([len(records.runs[k]) - 1 for k in order])
    return float(periods[order[np.searchsorted(steps, 0.5 * steps[-1])]])


def sampled_alike(records: Records) -> bool:
    """Tell whether the periods of records are one but for what rounds."""
    periods = [run.sample_period for run in records]
    return max(periods) - min(periods) <= PERIODS_DIFFER * min(periods)


def at_one_period(records: Records, layout: Layout) -> Records:
    """Return uniform records on grids of one period, those that are sampled alike as they are.

    Records that last less than one such period are left out.

    Args:
        records: each on a uniform grid of its own.
        layout: says which columns hold a value until the next one, and which are commanded.
    """
    if sampled_alike(records):
        return records
    period = common_period(records)
    return Records(tuple(_at_period(run, period, layout) for run in records if run.duration >= period))


def stretch_at_period(stretch: Stretch, period: float, layout: Layout) -> Stretch:
    """Return a uniform stretch on a grid of another period, if it is sampled otherwise.

    Args:
        stretch: on a uniform grid of its own.
        period: of the new grid, in the unit of time.
        layout: says which columns hold a value until the next one, and which are commanded.
    """
    run = stretch.record
    if run.duration < period:
        return stretch
    moved = _at_period(run, period, layout)
    if moved is run:
        return stretch
    edges = np.append(run.t, run.t[-1] + run.sample_period)[[stretch.first, stretch.stop]] - 0.5 * run.sample_period
    first, stop = np.searchsorted(moved.t, edges).tolist()
    return replace(stretch, record=moved, first=first, stop=stop if stretch.stop < len(run) else len(moved))


def _at_period(run: Record, period: float, layout: Layout) -> Record:
    """Return a uniform record on a grid of another period: every sample goes to the nearest point."""
    if abs(run.sample_period - period) <= PERIODS_DIFFER / 3.0 * period:  # two that stay are alike to each other, too
        return run
    points = np.rint((run.t - run.t[0]) / period).astype(np.int64)
    grid = run.t[0] + period * np.arange(points[-1] + 1)
    return on_grid(RawRun.of(run), run.t, grid, points, layout.held, layout.inputs)[0]
