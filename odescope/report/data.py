"""The report as plain data: what every renderer draws from, and what report.json holds.

Everything is numbers and text: lines are downsampled, text is as it came and for the renderer to escape. Shapes are
checked on reading, since a stored report may have been written by anyone.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

Role = Literal["recorded", "gated", "estimated", "truth", "model", "refitted"]
Count = Annotated[int, msgspec.Meta(ge=0)]
Points = tuple[float | None, ...]


class Plain(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every part: frozen, and strict about its keys."""


class Line(Plain, frozen=True):
    """A downsampled line; null interrupts it."""

    label: str
    role: Role
    x: Points
    y: Points

    def __post_init__(self) -> None:
        if len(self.x) != len(self.y):
            raise ValueError(f"a line has {len(self.x)} abscissas and {len(self.y)} ordinates")


class Panel(Plain, frozen=True):
    """Lines over all of the time shown, and others beside them; `label` is that of the ordinate, with its unit."""

    label: str
    wide: tuple[Line, ...]
    close: tuple[Line, ...] = ()


class Chart(Plain, frozen=True):
    """Panels over one axis of time, labelled `time`, and `beside` it a second one.

    `marks` are times worth a vertical line, `left_out` counts the panels that found no room.
    """

    time: str
    beside: str
    panels: tuple[Panel, ...]
    marks: tuple[tuple[float, str], ...] = ()
    left_out: Count = 0


class Run(Plain, frozen=True):
    """One uninterrupted recording, and the time missing between it and the one before in the same source.

    `missing` counts the samples of the coordinate that lacks most of them.
    """

    source: str
    samples: Count
    duration: float
    gap: float | None
    missing: Count = 0


class CoordinateRow(Plain, frozen=True):
    """A measured coordinate in the table of what was recorded: its noise and its signal in its own unit."""

    name: str
    column: str
    unit: str
    noise: float
    signal: float


class InputRow(Plain, frozen=True):
    """A recorded input in the same table."""

    name: str
    column: str
    unit: str


class Recorded(Plain, frozen=True):
    """What was measured, and in `lost` the sentences of what was not."""

    files: tuple[str, ...]
    runs: tuple[Run, ...]
    recordings: Count
    samples: Count
    duration: float
    period: float
    kept_period: float
    kept: Count
    coordinates: tuple[CoordinateRow, ...]
    inputs: tuple[InputRow, ...]
    chart: Chart
    lost: tuple[str, ...] = ()


class Periodogram(Plain, frozen=True):
    """The periodogram of one channel: power per hertz over hertz, with its levels and cutoffs."""

    channel: str
    unit: str
    power: Line
    noise: float
    floor: float
    ceiling: float
    cutoff: float
    paper_cutoff: float


class Observed(Plain, frozen=True):
    """What is known before there is a model."""

    recorded: Recorded
    spectra: tuple[Periodogram, ...]
    derivatives: Chart


class RuleCount(Plain, frozen=True):
    """What a rule of the library removed."""

    rule: str
    removed: Count


class Dependent(Plain, frozen=True):
    """A candidate term that is a combination of others on these data, and was left out."""

    term: str
    others: tuple[str, ...]


class Correlations(Plain, frozen=True):
    """Cosines between candidate terms in percent; `left_out` counts the terms that found no room."""

    terms: tuple[str, ...]
    percent: tuple[tuple[Annotated[int, msgspec.Meta(ge=-100, le=100)], ...], ...]
    left_out: Count

    def __post_init__(self) -> None:
        if any(len(row) != len(self.terms) for row in (self.percent, *self.percent)):
            raise ValueError(f"the correlations of {len(self.terms)} terms are not a square table of that size")


class Row(Plain, frozen=True):
    """A candidate relation: its place, and of every column of the grid the sign "+", "-" or "."."""

    rank: Count
    family: Count
    guess: str
    rmse: float
    criterion: float
    consensus: Count
    chosen: bool
    signs: Annotated[str, msgspec.Meta(pattern="^[-+.]*$")]

    @property
    def terms(self) -> int:
        """Number of terms of the relation."""
        return len(self.signs) - self.signs.count(".")


class Point(Plain, frozen=True):
    """Accuracy and size of one candidate."""

    terms: Count
    rmse: float
    chosen: bool


class Searched(Plain, frozen=True):
    """The search for one target: its library, what was found, what was discarded and why, and the best."""

    target: str
    unit: str
    products: Count
    rules: tuple[RuleCount, ...]
    terms: Count
    dependent: tuple[Dependent, ...]
    correlations: Correlations
    found: Count
    kept: Count
    discarded: tuple[tuple[str, Count], ...]
    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    points: tuple[Point, ...]
    inclusion: tuple[tuple[str, float], ...]
    adopted: bool

    def __post_init__(self) -> None:
        if any(len(row.signs) != len(self.columns) for row in self.rows):
            raise ValueError(f"a row of the candidates for {self.target} does not fit the {len(self.columns)} columns")

    def listed(self, most: int) -> tuple[Row, ...]:
        """Return the best rows, and the chosen one wherever it stands."""
        return tuple(row for k, row in enumerate(self.rows) if k < most or row.chosen)

    def support(self, row: Row) -> tuple[str, ...]:
        """Return the terms of a row."""
        return tuple(term for term, sign in zip(self.columns, row.signs, strict=True) if sign != ".")


class TargetFit(Plain, frozen=True):
    """R^2 of one target over all the data: by the model, and by its terms fitted without the part in question.

    Where the target hardly varies, neither says anything.
    """

    target: str
    model: float | None
    refitted: float | None
    varies: bool = True


class Stays(Plain, frozen=True):
    """How a free run stays with one coordinate: valid time in seconds, fit in per cent, error in the unit."""

    coordinate: str
    unit: str
    valid_time: float
    fit: float | None
    rmse: float | None


class RunShown(Plain, frozen=True):
    """The free run over one recording, counted from 1; `duration` of its `recorded` seconds were run."""

    recording: Count
    source: str
    duration: float
    recorded: float
    valid_time: float
    ended: str
    coordinates: tuple[Stays, ...]


class Thumbnail(Plain, frozen=True):
    """A recording and the free run over it, a panel a coordinate; `mark` is where the two part, if they do."""

    title: str
    panels: tuple[Panel, ...]
    mark: float | None


def side_by_side(runs: int) -> int:
    """Return how many thumbnails stand side by side."""
    return next((wide for most, wide in ((1, 1), (2, 2), (3, 3), (4, 2), (6, 3), (16, 4)) if runs <= most), 6)


class Thumbnails(Plain, frozen=True):
    """The free runs that there is room for; `left_out` counts the others."""

    runs: tuple[Thumbnail, ...]
    left_out: Count = 0


class AtWork(Plain, frozen=True):
    """The model at work: free runs from the start of every recording, and its targets from instant to instant.

    `held_out` says whether the targets are also predicted by coefficients that have not seen them.
    """

    free_runs: Thumbnails
    runs: tuple[RunShown, ...]
    targets: Chart
    fits: tuple[TargetFit, ...]
    held_out: bool


class Coefficient(Plain, frozen=True):
    """A coefficient of the model, in the order of its relations' terms."""

    unit: str


class TableRow(Plain, frozen=True):
    """A row of Table 2: a coefficient of the numerator or denominator in truth, paper and odescope; None lacks it."""

    target: str
    term: str
    truth: float | None
    paper: float | None
    found: float | None


class Stage(Plain, frozen=True):
    """Time of a stage in seconds, and the most memory that the process had held at its end, in bytes."""

    name: str
    seconds: float
    peak: Count | None


class Reproduce(Plain, frozen=True):
    """What it takes to do it again: a study whose files are named from the folder that holds them all."""

    study: str
    files: tuple[str, ...]
    seed: Count
    versions: tuple[tuple[str, str], ...]
    stages: tuple[Stage, ...]


class Report(Plain, frozen=True):
    """The whole report. `model` is the text of model.json, read with the same care; `warnings` are among the notes."""

    format: Literal["odescope/report"]
    version: Literal[1]
    title: str
    model: msgspec.Raw
    coefficients: tuple[tuple[Coefficient, ...], ...]
    notes: tuple[str, ...]
    observed: Observed
    searches: tuple[Searched, ...]
    at_work: AtWork
    table: tuple[TableRow, ...]
    reproduce: Reproduce
    warnings: tuple[str, ...] = ()
