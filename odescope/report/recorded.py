"""What was measured, as plain data: recordings, channels, spectra, derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.model.notes import lost_samples
from odescope.model.quantity_units import quantity_units, shown
from odescope.pipeline.evaluation import time_score
from odescope.pipeline.identification import Identification
from odescope.recordings.record import Records
from odescope.report.data import Chart, CoordinateRow, InputRow, Line, Panel, Periodogram, Recorded, Role, Run
from odescope.report.downsample import line_of
from odescope.signals.cutoff import NoiseCeiling, periodogram

WIDE, CLOSE, WHOLE = 640, 360, 960  # pixels of the wide and the close view, and of a panel that has the width alone
MOST_PANELS = 8  # of one figure
MOST_RUNS = 12  # rows of the table
CLOSE_PERIODS = 40.0  # of the highest cutoff, and at most a fifth of the longest recording
BEYOND = 0.5  # of the height of a line: where samples further off are marked, and predictions cut off
CLOSE_UP = "close-up: time (s)"
Truth = Mapping[str, FloatArray]  # name of a state or target -> its true samples, one a sample of the only recording


@dataclass(frozen=True, eq=False)
class Clock:
    """Places recordings end to end on one axis of time; `offsets` holds where each begins."""

    records: Records
    offsets: tuple[float, ...]

    @staticmethod
    def of(records: Records) -> Clock:
        """Return the clock of these recordings."""
        ends = np.cumsum([run.duration + run.sample_period for run in records])
        return Clock(records, (0.0, *ends[:-1].tolist()))

    @property
    def label(self) -> str:
        """The label of the axis."""
        return "time (s)" if len(self.records) == 1 else "time, recordings end to end (s)"

    @property
    def longest(self) -> int:
        """The longest recording."""
        return int(np.argmax([len(run) for run in self.records]))

    def raw(self) -> list[FloatArray]:
        """Return the time of every sample as recorded, one array a recording."""
        return [run.t - run.t[0] + at for run, at in zip(self.records, self.offsets, strict=True)]

    def kept(self, result: Identification) -> list[FloatArray]:
        """Return the time of every sample of the signals, one array a recording."""
        signals = result.signals
        return [
            start - run.t[0] + at + signals.period * np.arange(columns.shape[1])
            for run, at, start, columns in zip(self.records, self.offsets, signals.start, signals.columns, strict=True)
        ]

    def close(self, result: Identification) -> tuple[float, float]:
        """Return the stretch of the longest recording that is worth a close look: where the targets are largest."""
        run, signals = self.records.runs[self.longest], result.signals
        highest = max(c.cutoff for c in signals.channels)
        width = min(run.duration / 5.0, CLOSE_PERIODS / highest)
        targets = signals.columns[self.longest][[signals.row(t) for t in signals.targets]]
        size = np.sum((targets / np.maximum(targets.std(axis=1, keepdims=True), 1e-300)) ** 2, axis=0)
        count = max(min(round(width / signals.period), len(size)), 1)
        sums = np.concatenate([[0.0], np.cumsum(size)])
        begin = float(self.kept(result)[self.longest][int(np.argmax(sums[count:] - sums[:-count]))])
        return begin, begin + width


Trace = tuple[str, Role, Sequence[FloatArray], Sequence[FloatArray]]


def panel(label: str, traces: Sequence[Trace], close: tuple[float, float] | None) -> Panel:
    """Return one panel, with a close view where one is asked for.

    Args:
        label: of the ordinate.
        traces: label, role, abscissas and ordinates, one array (N,) a piece.
        close: begin and end of the close view, in seconds.
    """
    wide = tuple(line_of(*trace, WHOLE if close is None else WIDE) for trace in traces)
    if close is None:
        return Panel(label=label, wide=wide)
    near: list[Line] = []
    for text, role, xs, ys in traces:
        inside = [slice(*np.searchsorted(x, close).tolist()) for x in xs]
        cut = [(x[s], y[s]) for x, y, s in zip(xs, ys, inside, strict=True) if s.stop > s.start]
        near.append(line_of(text, role, [x for x, _ in cut], [y for _, y in cut], CLOSE) if cut else _empty(text, role))
    return Panel(label=label, wide=wide, close=tuple(near))


def near(
    times: Sequence[FloatArray], values: Sequence[FloatArray], recorded: Sequence[FloatArray]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the pieces of lines that stay near the range of what was recorded.

    Args:
        times: (N,) of every record.
        values: (N,) or fewer from its start.
        recorded: (N,) of every record; the range is that of all.
    """
    xs, ys = list[FloatArray](), list[FloatArray]()
    for t, y in zip(times, values, strict=True):
        there = np.flatnonzero(stays_near(y, recorded))
        pieces = np.split(there, np.flatnonzero(np.diff(there) > 1) + 1)
        xs += [t[p] for p in pieces]
        ys += [y[p] for p in pieces]
    return xs, ys


def stays_near(values: FloatArray, recorded: Sequence[FloatArray]) -> BoolArray:
    """Tell of values (n,) which are near the range of what was recorded: what runs away would flatten the rest."""
    low, high = min(float(r.min()) for r in recorded), max(float(r.max()) for r in recorded)
    span = BEYOND * max(high - low, 1e-300)
    found: BoolArray = (values >= low - span) & (values <= high + span)
    return found


def _empty(label: str, role: Role) -> Line:
    return Line(label=label, role=role, x=(), y=())


def chart(time: str, panels: Sequence[Panel], beside: str = CLOSE_UP, marks: Sequence[tuple[float, str]] = ()) -> Chart:
    """Return a chart of as many panels as there is room for.

    Args:
        time: label of the axis of time.
        panels: from the top down.
        beside: label of the axis of the close view.
        marks: times worth a line, in seconds, and what they are.
    """
    return Chart(
        time=time,
        beside=beside,
        panels=tuple(panels[:MOST_PANELS]),
        marks=tuple(marks),
        left_out=max(len(panels) - MOST_PANELS, 0),
    )


def labels(result: Identification) -> dict[str, str]:
    """Return the label of an axis for every state, target and input: its name, and its unit where that is known."""
    units = quantity_units(result.model)
    return {name: f"{name} ({unit})" if (unit := shown(own)) else name for name, own in units.items()}


def recorded(result: Identification) -> Recorded:
    """Return the recordings, the channels and what was found in them."""
    records, signals, study = result.records, result.signals, result.study
    columns = dict(study.layout().columns)
    runs, last = [], dict[str, float]()
    for run in list(records)[:MOST_RUNS]:
        gap = float(run.t[0]) - last[run.source] - run.sample_period if run.source in last else None
        own = time_score(Records((run,)), signals.coordinates, ())
        missing = 0 if own is None else max((n for n, _ in own.lost.values()), default=0)
        runs.append(Run(source=run.source, samples=len(run), duration=run.duration, gap=gap, missing=missing))
        last[run.source] = float(run.t[-1])
    time = time_score(records, signals.coordinates, ())
    return Recorded(
        files=study.data.files,
        runs=tuple(runs),
        recordings=len(records),
        samples=records.samples,
        duration=sum(run.duration for run in records),
        period=records.runs[0].sample_period,
        kept_period=signals.period,
        kept=signals.samples,
        coordinates=tuple(
            CoordinateRow(
                name=c.name,
                column=columns[c.name],
                unit=c.unit or ("rad" if c.angle else ""),
                noise=found.noise,
                signal=float(np.std(signals.joined()[signals.row(c.name)])),
            )
            for c, found in zip(signals.coordinates, signals.channels, strict=True)
        ),
        inputs=tuple(InputRow(name=i.name, column=columns[i.name], unit=i.unit or "") for i in signals.inputs),
        chart=signals_chart(result),
        lost=() if time is None else tuple(lost_samples(time)),
    )


def signals_chart(result: Identification) -> Chart:
    """Return the channels as recorded and filtered, and the inputs (the paper's Fig. 2)."""
    clock, signals, label = Clock.of(result.records), result.signals, labels(result)
    raw, kept = clock.raw(), clock.kept(result)
    panels = []
    for name in (*(c.name for c in signals.coordinates), *(i.name for i in signals.inputs)):
        samples = [run.column(name) for run in result.records]
        gone = result.gated.get(name) or tuple(np.zeros(len(y), dtype=np.int64) for y in samples)
        there = [(run.counted(name) > 0.0) & (g == 0) for run, g in zip(result.records, gone, strict=True)]
        wide = [line_of("recorded", "recorded", _those(raw, there), _those(samples, there), WIDE)]
        close = []
        if name in signals.states:
            filtered = [c[signals.row(name)] for c in signals.columns]
            wide.append(line_of("filtered", "estimated", kept, filtered, WIDE))
            at = [_nearest(t, k) for t, k in zip(raw, kept, strict=True)]
            counts = [m[n] for m, n in zip(there, at, strict=True)]
            rest = [y[n] - f for y, n, f in zip(samples, at, filtered, strict=True)]
            close.append(line_of("removed", "recorded", _those(kept, counts), _those(rest, counts), CLOSE))
            far = [g > 0 for g in gone]
            if any(f.any() for f in far):
                shown = _at_the_edge(_those(samples, far), _those(samples, there))
                wide.append(line_of("does not count", "gated", _those(raw, far), shown, WIDE))
        panels.append(Panel(label=label[name], wide=tuple(wide), close=tuple(close)))
    return chart(clock.label, panels, "removed by the filter, over time (s)")


def _those(columns: Sequence[FloatArray], chosen: Sequence[BoolArray]) -> list[FloatArray]:
    return [column[those] for column, those in zip(columns, chosen, strict=True)]


def _at_the_edge(marks: Sequence[FloatArray], others: Sequence[FloatArray]) -> list[FloatArray]:
    """Return marks (n,), those at the edge of the panel that are so far off that they would press the line flat."""
    joined = np.concatenate(others)
    beyond = BEYOND * float(np.ptp(joined))
    return [np.clip(y, joined.min() - beyond, joined.max() + beyond) for y in marks]


def _nearest(time: FloatArray, wanted: FloatArray) -> IntArray:
    """Return the samples (n,) whose times are the wanted ones, to rounding."""
    found: IntArray = np.minimum(np.searchsorted(time, wanted - 0.25 * (time[1] - time[0])), len(time) - 1)
    return found


def derivatives_chart(result: Identification, truth: Truth | None = None) -> Chart:
    """Return the derivatives that were estimated, with the true ones where they are known (Fig. 3)."""
    clock, signals, label = Clock.of(result.records), result.signals, labels(result)
    raw, kept, close = clock.raw(), clock.kept(result), clock.close(result)
    panels = []
    highest = max(c.order for c in signals.coordinates)
    for name in (c.derivative(k) for k in range(1, highest + 1) for c in signals.coordinates if k <= c.order):
        traces: list[Trace] = [("estimated", "estimated", kept, [c[signals.row(name)] for c in signals.columns])]
        if truth is not None and name in truth:
            traces.append(("truth", "truth", raw, [truth[name]]))
        panels.append(panel(label[name], traces, close))
    return chart(clock.label, panels)


def spectra(result: Identification) -> tuple[Periodogram, ...]:
    """Return the periodogram of every channel, its noise floor and ceiling, the chosen cutoff and the paper's."""
    found, paper = [], NoiseCeiling()
    period = result.records.runs[0].sample_period
    for c, coordinate in zip(result.signals.channels, result.signals.coordinates, strict=True):
        channel = [run.column(c.name) for run in result.records]
        frequency, power = periodogram(channel, period)
        found.append(
            Periodogram(
                channel=c.name,
                unit=coordinate.unit or ("rad" if coordinate.angle else ""),
                power=line_of(c.name, "recorded", [frequency[1:]], [np.maximum(power[1:], 1e-300)], WHOLE, log=True),
                noise=c.noise,
                floor=2.0 * c.noise**2 * period,
                ceiling=paper.level(power),
                cutoff=c.cutoff,
                paper_cutoff=paper.hertz(channel, period, coordinate.order),
            )
        )
    return tuple(found[:MOST_PANELS])
