"""What often keeps a law from being found, where the record itself shows it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from odescope.recordings.checks import degrees_hints
from odescope.recordings.record import Records
from odescope.regression.problem import Problem
from odescope.signals.estimate import Signals
from odescope.signals.first_order import order_advice
from odescope.signals.rates import explained, rates_given

THE_SAME = 0.999  # of a quantity's variance: what another then says of it leaves nothing to learn from it
ALIKE = 0.1  # how far a column may be from the rate of another that it is taken for
VALUES_A_TERM = 5.0  # independent values that a record should hold for every candidate


def advice(
    records: Records, signals: Signals, problems: Sequence[Problem], time_unit: str | None = None
) -> tuple[str, ...]:
    """Return sentences on what may have kept a law from being found, each of which names what to try.

    Args:
        records: as they were recorded.
        signals: what was found in them.
        problems: one a target; there may be none.
        time_unit: that the study or a heading says; None where nothing does.
    """
    said = [
        *degrees_hints(records, signals.coordinates),
        *order_advice(signals),
        *(_whole_numbers(records) if time_unit is None else ()),
        *_too_short(signals, problems),
    ]
    return tuple(dict.fromkeys([*said, *_rates_given(signals), *_closed_loops(signals)]))


def _whole_numbers(records: Records) -> Iterator[str]:
    """Yield that time counts in whole numbers, which seconds of a record of something that moves seldom do."""
    if all(np.all(run.t == np.rint(run.t)) for run in records):
        period = min(run.sample_period for run in records)
        yield (
            f"time counts in whole numbers, a sample every {period:g}: if these are samples or milliseconds, give the"
            " time in seconds, or sample_period in [data]"
        )


def _too_short(signals: Signals, problems: Sequence[Problem]) -> Iterator[str]:
    """Yield for each target that the record holds too few independent values for so many candidates."""
    lowest = min(c.cutoff for c in signals.channels)
    values = 2.0 * lowest * signals.period * signals.samples
    for problem in problems:
        if values < VALUES_A_TERM * len(problem.terms):
            yield (
                f"below the cutoff of {lowest:.3g} Hz the record holds about {values:.0f} independent values, few for"
                f" the {len(problem.terms)} candidates for {problem.target}: record longer, or with less noise, or"
                " shrink the library: [library] degree, rules or a basis"
            )


def _rates_given(signals: Signals) -> Iterator[str]:
    """Yield for each measured quantity that is the rate of another."""
    for c, other in rates_given(signals, ALIKE):
        yield (
            f"{other.name} is the rate of {c.name}: give {c.name} order = {c.order + 1} and leave"
            f" {other.name} out of the coordinates"
        )


def _closed_loops(signals: Signals) -> Iterator[str]:
    """Yield for each input that is a sum of multiples of the states, as what a controller feeds back."""
    joined, states = signals.joined(), [s for c in signals.coordinates for s in c.states]
    columns = np.vstack([np.ones(joined.shape[1]), joined[[signals.row(s) for s in states]]])
    scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    half = columns.shape[1] // 2
    for i in signals.inputs:
        u = joined[signals.row(i.name)]
        found = np.linalg.lstsq((columns[:, :half].T / scale), u[:half], rcond=None)[0] / scale
        if explained(u[half:], found @ columns[:, half:]) > THE_SAME:
            yield (
                f"{i.name} is a function of {', '.join(states)}, as under feedback: what it does cannot be told from"
                " what they do; record with a reference or a disturbance added to it, or leave it out of the inputs"
            )
