"""Scores: what an identification found out about its model, built once from its stages and typed until a file begins.

A number may be infinite in memory. JSON has no infinity: in a model that was read from a file it is None.
"""

from __future__ import annotations

import msgspec

from odescope.model.time_score import TimeScore
from odescope.recordings.coordinate import Hold

Number = float | None
NOISE_ALONE = 0.1  # of the variance of a target: where less is predicted, and nearly all of its power,
LOST = 0.95  # standard deviations: errors of free runs count as 1 at most, and this is three
NEARLY_ALL = 0.999  # it stays within a thirtieth of its mean


class Denominator(msgspec.Struct, frozen=True):
    """Least and greatest value of a target's denominator, at the data and in the box around them."""

    data: tuple[Number, Number]
    box: tuple[Number, Number]

    @property
    def vanishes(self) -> bool:
        """Whether it changes sign or is zero between the states of the data."""
        low, high = self.box
        return low is not None and high is not None and low * high <= 0.0


def hardly_varies(r2: float, explained: float) -> bool:
    """Say whether a target is all but constant, as that of a falling body: its R² is of noise, and says nothing.

    Args:
        r2: share of its variance that is predicted.
        explained: share of its power, its mean included.
    """
    return r2 < NOISE_ALONE and explained > NEARLY_ALL


class TargetScore(msgspec.Struct, frozen=True):
    """How well one target is predicted where it was held out, and how sound its relation is.

    Of mechanisms only `denominator` is there: free runs say how well they predict (`PathScore`).
    `explained_held_out` is the share of the weighted power of the target, `condition` that of the relation's columns.
    """

    r2_held_out: Number = None
    rmse_held_out: Number = None
    explained_held_out: Number = None
    condition: Number = None
    denominator: Denominator | None = None

    @property
    def telling_r2(self) -> Number:
        """The R² held out, None where the target hardly varies."""
        r2, explained = self.r2_held_out, self.explained_held_out
        return None if r2 is not None and explained is not None and hardly_varies(r2, explained) else r2


class CoordinateRun(msgspec.Struct, frozen=True):
    """How long a free run stayed with one coordinate, in seconds, its fit in per cent and its error in the unit.

    Fit and error are None where the run ended early, the fit also where what was measured is constant.
    """

    valid_time: float
    fit: Number = None
    rmse: Number = None


class FreeRun(msgspec.Struct, frozen=True, omit_defaults=True):
    """A free run from the start of a recording, counted from 1, and how long it stayed with it, in seconds.

    `duration` is how much was run, `recorded` the length of a recording of which that is but the first part.
    `valid_time` is that of the coordinate which parts first, and `growth` how many times further off than at its start
    a run of the model from beside that start gets until then; None where it does not part.
    """

    duration: float
    valid_time: float
    ended: str | None = None
    recording: int = 1
    recorded: Number = None
    coordinates: dict[str, CoordinateRun] = {}
    growth: Number = None

    @property
    def stays(self) -> bool:
        """Whether it stays with the recording for all that was run."""
        return self.valid_time >= self.duration


class Step(msgspec.Struct, frozen=True):
    """One step of the likelihood's search: a term added, dropped or left out of a target's relation.

    `gap` is what segments may differ by at their joints, in standard deviations of the states; None without one.
    `statistic` and `price` are in units of chi-squared.
    """

    gap: Number
    action: str
    target: str
    term: str
    statistic: Number
    price: Number


class Interval(msgspec.Struct, frozen=True):
    """The 95 % interval of a coefficient."""

    target: str
    term: str
    interval: tuple[Number, Number]


class Correlation(msgspec.Struct, frozen=True):
    """Two coefficients whose estimates go together."""

    first: str
    second: str
    correlation: Number


class Limit(msgspec.Struct, frozen=True):
    """The coefficient from which on an absent term would probably have been found.

    None where these data cannot tell the term from those that are there.
    """

    target: str
    term: str
    limit: Number


class Likelihood(msgspec.Struct, frozen=True, omit_defaults=True):
    """How the likelihood of the measured trajectory judged the model.

    `process_noise` is the root mean square of what the model leaves unexplained of each target, None where it follows
    the record to within its noise, and `unexplained` what share of the target's own that is; `held_out_free_run` is
    there with process noise only, and `intervals`, `correlations` and `limits` only where standard errors are stated;
    `truncated` where [likelihood] terms asked for fewer terms than it takes to follow the record so; `bursts` is the
    share of the record that was too quick for its filter, and not looked at, `unknown` that in which nobody had
    recorded yet what acted.
    """

    follows: bool
    residual_variance: Number
    gap: Number
    finished: bool
    starts: int
    process_noise: dict[str, Number] | None
    trail: tuple[Step, ...]
    hints: tuple[str, ...]
    unexplained: dict[str, float] | None = None
    held_out_free_run: Number = None
    intervals: tuple[Interval, ...] | None = None
    correlations: tuple[Correlation, ...] | None = None
    limits: tuple[Limit, ...] | None = None
    truncated: bool = False
    bursts: float = 0.0
    unknown: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether the model follows the record to within its noise, without any of the process."""
        return self.follows and not self.process_noise and not self.truncated


class OffsetScore(msgspec.Struct, frozen=True):
    """What a sensor reads more than its coordinate, in its unit, and the standard error of that."""

    offset: float
    std_error: Number = None


class DelayScore(msgspec.Struct, frozen=True):
    """How late an input was found to act, in seconds."""

    delay: float
    std_error: Number = None


class HoldScore(msgspec.Struct, frozen=True):
    """What an input was found to do between samples, and what that gains in log-likelihood over linear.

    The gain is null where an input with few cells was held and one of the two models does not follow the record, and
    where `steps` of a held input were found to come between samples. `other` is a hold that is about as likely:
    standard errors allow for both.
    """

    hold: Hold
    gain: Number
    steps: int = 0
    other: Hold | None = None


class GatedRange(msgspec.Struct, frozen=True):
    """A range of time in a recording, counted from 1, with samples that do not count.

    It is in seconds by the clock of the log, to about a hundredth of a sample period; of dates from the first row of
    the recording.
    """

    recording: int
    begin: float
    end: float
    samples: int


class GatedScore(msgspec.Struct, frozen=True):
    """Samples of a coordinate that do not count, for one reason.

    `reason` is "saturated", "repeated", "late", "outlier" or "placeholder" (a number where nothing was read). `ranges`
    holds those with most samples, `more` counts the others; they are `dated` where the log holds dates.
    """

    reason: str
    samples: int
    ranges: tuple[GatedRange, ...]
    more: int
    dated: bool = False


class Streamed(msgspec.Struct, frozen=True):
    """How much was read of a log that does not fit in memory, and how many portions the ranking saw."""

    rows: int
    portions: int
    sampled: int


class ModelScores(msgspec.Struct, frozen=True, omit_defaults=True):
    """All that was found out about a model; what a stage did not find is absent.

    `left_out` counts recordings too short to use, `outliers` the samples of each coordinate that were gated or
    clipped; of those that were gated `gated` says why, and when they were taken.
    """

    targets: dict[str, TargetScore] = {}
    free_runs: tuple[FreeRun, ...] = ()
    likelihood: Likelihood | None = None
    left_out: int = 0
    outliers: dict[str, int] = {}
    gated: dict[str, tuple[GatedScore, ...]] = {}
    delays: dict[str, DelayScore] = {}
    offsets: dict[str, OffsetScore] = {}
    time: TimeScore | None = None
    holds: dict[str, HoldScore] = {}
    streamed: Streamed | None = None
    forms: tuple[FormScore, ...] = ()
    versions: tuple[VersionScore, ...] = ()
    path: tuple[PathScore, ...] = ()
    energy: EnergyScore | None = None
    conserved: tuple[Conserved, ...] = ()
    suspicions: tuple[SuspicionScore, ...] = ()


class FormScore(msgspec.Struct, frozen=True):
    """How one of the forms that competed did: relations, Lagrange's equations, reactions.

    `coefficients` were fitted; `free_run` is the root mean square error of free runs over what is held out, in standard
    deviations of what was measured; `misfit` the residual variance over that of the noise, and
    `follows` whether it follows the record: both None where regression alone was done.
    """

    form: str
    coefficients: int
    free_run: Number
    misfit: Number
    follows: bool | None
    chosen: bool


class VersionScore(msgspec.Struct, frozen=True):
    """How the model `did` whose inputs were read from these `columns`, by input, where several were offered.

    None where these columns gave no model.
    """

    columns: dict[str, str]
    did: FormScore | None

    @property
    def chosen(self) -> bool:
        """Whether these columns describe the record best."""
        return self.did is not None and self.did.chosen


class PathScore(msgspec.Struct, frozen=True):
    """A model on the path from many terms to few.

    `error` is the root mean square error of free runs over what is held out, in standard deviations of what was
    measured, `spread` how far it differs between stretches; `dropped` is what the model before it had beside,
    `statistic` the Wald statistic of that.
    """

    terms: int
    error: Number
    spread: Number
    dropped: str | None
    statistic: Number
    chosen: bool

    @property
    def standard_errors(self) -> float | None:
        """How many standard errors what was dropped stood away from zero."""
        return None if self.statistic is None or self.statistic < 0.0 else float(self.statistic**0.5)

    @property
    def lost(self) -> bool:
        """Whether free runs went so far off that their error is no number to be read: it saturates at 1."""
        return self.error is not None and self.error > LOST


class EnergyScore(msgspec.Struct, frozen=True):
    """How a Lagrangian stands the data.

    `least_inertia` is the smallest eigenvalue of the mass matrix over the data, `least_dissipation` the least power
    dissipated, over the largest; `imbalance` is what is missing in the balance of energy, over what is turned over;
    `loosest` the largest standard error of a kinetic mechanism, over its coefficient.
    """

    least_inertia: Number
    least_dissipation: Number
    imbalance: Number
    loosest: Number


class Conserved(msgspec.Struct, frozen=True):
    """A sum of coordinates that stays constant: in the data, and whether it does by the mechanisms of the model.

    `values` are those in the recordings, where the data show it; `by_model` is None where the model has no reactions.
    Where the reactions would keep it and the data do not, `drift` is how far it moves beyond its noise, over the member
    that moves most, both root mean squares.
    """

    sum: str
    values: tuple[Number, ...]
    by_model: bool | None
    drift: Number = None


class SuspicionScore(msgspec.Struct, frozen=True):
    """What was made of the suspicion that terms of a variable imitate a function of it.

    `reason` is "powers", "fractions", "driven" (by a term of a speed, where dry friction brakes), "residual",
    "measured" (rates, where the model is near to no function), "pair", "sine" or "bend" (of functions of two
    variables, of sines and of bends of any: no variable is named), "angle", "temperature", "radiation", "periodic" (in
    time), "swinging" (in time, times the term that `variable` then names) or "recurring" (along a position), `terms`
    how many terms of the model's relation may still be the imitation, `low` and `high` the range of the variable in
    the data (of a residual that is periodic that of its rate, in rad/s or rad a unit of the position), `tried` the
    functions that competed, `found` those in the model. `gain` is by how much the model with functions lowers cost and
    price together, negative where it does not and None where the two cannot be compared.
    """

    target: str
    variable: str
    reason: str
    terms: int
    low: float
    high: float
    tried: tuple[str, ...]
    found: tuple[str, ...]
    gain: Number


class Doubts(msgspec.Struct, frozen=True):
    """What the likelihood stage knows against its model and model.json does not say.

    `late`: the clock ended the search; `crowded`: it stopped at its largest number of terms; `window`: the seconds over
    which what is left unexplained is averaged; `thin`: terms whose evidence is thin, each with its target and its size
    in standard errors; `alike`: terms, each with its target and another that could stand in its place almost as well;
    `units`: of each target, "" where it is not known.
    """

    late: bool
    crowded: bool
    window: float | None
    thin: tuple[tuple[str, str, float], ...]
    alike: tuple[tuple[str, str, str], ...] = ()
    units: dict[str, str] = {}
