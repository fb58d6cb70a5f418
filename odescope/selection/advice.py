"""What often keeps a law from being found, where the record itself shows it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.checks import degrees_hints
from odescope.recordings.record import Records
from odescope.regression.problem import Problem
from odescope.signals.estimate import Signals
from odescope.signals.first_order import order_advice
from odescope.signals.rates import explained, rates_given

FED_BACK = 0.9  # of the variance of an input that equations do without
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


def idle_inputs(signals: Signals, used: Collection[str]) -> Iterator[str]:
    """Yield for each input that equations do without why that need not mean that it has no effect.

    Args:
        signals: of the records.
        used: names of the inputs that the equations hold.
    """
    states, columns, inputs = _states_and_inputs(signals)
    for name, u in ((n, values) for n, values in inputs.items() if n not in used):
        share = explained(u, _followed(columns, u, len(u)))
        why = f" {100.0 * share:.3g} % of it is a sum of multiples of {', '.join(states)}, as under feedback:"
        why = f"{why} what it does is counted as what they do; record with a reference or a disturbance added to it"
        yield f"{name} is in none of the equations" + (f":{why}" if share > FED_BACK else "")


def _closed_loops(signals: Signals) -> Iterator[str]:
    """Yield for each input that is a sum of multiples of the states, as what a controller feeds back."""
    states, columns, inputs = _states_and_inputs(signals)
    for name, u in inputs.items():
        half = len(u) // 2
        if explained(u[half:], _followed(columns, u, half)[half:]) > THE_SAME:
            yield (
                f"{name} is a function of {', '.join(states)}, as under feedback: what it does cannot be told from"
                " what they do; record with a reference or a disturbance added to it, or leave it out of the inputs"
            )


def _states_and_inputs(signals: Signals) -> tuple[list[str], FloatArray, dict[str, FloatArray]]:
    """Return the names of the states, a constant and their values (1 + states, N), and those of every input (N,)."""
    joined, states = signals.joined(), [s for c in signals.coordinates for s in c.states]
    columns = np.vstack([np.ones(joined.shape[1]), joined[[signals.row(s) for s in states]]])
    return states, columns, {i.name: joined[signals.row(i.name)] for i in signals.inputs}


def _followed(columns: FloatArray, u: FloatArray, seen: int) -> FloatArray:
    """Return the sum of multiples of columns (k, N) that is nearest to u (N,) over the first samples of these."""
    scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    found: FloatArray = np.linalg.lstsq(columns[:, :seen].T / scale, u[:seen], rcond=None)[0] / scale
    return np.asarray(found @ columns)
