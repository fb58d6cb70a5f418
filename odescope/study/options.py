"""Study: everything an identification depends on, as frozen options; `odescope.study.toml` reads and writes them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import msgspec
import numpy as np

from odescope.errors import InputError
from odescope.library.candidates import Library
from odescope.library.defaults import check_basis, default_library, default_rules, paper_basis, paper_rules
from odescope.library.functions import FUNCTIONS
from odescope.library.lagrangian import lagrangian
from odescope.library.mechanism import Mechanism
from odescope.library.parse import Definition, Scope, parse_term
from odescope.library.reactions import reactions, saturation
from odescope.library.ties import tied
from odescope.likelihood.search import LikelihoodSearch
from odescope.recordings.checks import is_degrees
from odescope.recordings.coordinate import Coordinate, Hold, Input, state_names
from odescope.recordings.gaps import Gaps
from odescope.recordings.headings import TimeUnit
from odescope.recordings.layout import Layout
from odescope.regression.proposers import EnergyThreshold
from odescope.regression.rank import told_apart
from odescope.regression.rows import NoiseWeighted
from odescope.selection.ranking import Ranking
from odescope.signals.differentiators import Spectral
from odescope.signals.rates import how_to_give
from odescope.study.kinds import check_fields, check_parts, check_tables
from odescope.study.library_options import Candidates, Form, Span

if TYPE_CHECKING:  # pieces of one's own go in from Python; what a file may name beside the kinds below, see pieces
    from odescope.regression.proposers import Proposer as AnyProposer
    from odescope.regression.rows import RowChoice as AnyRows
    from odescope.signals.differentiators import Differentiator as AnyDifferentiator
else:
    from odescope.regression.proposers import AnyProposer
    from odescope.regression.rows import AnyRows
    from odescope.signals.differentiators import AnyDifferentiator


ANY_SCALE = (0.3, 3.0)  # where a constant is drawn from whose range the data will say

LeftOut = tuple[tuple[Mechanism, tuple[Mechanism, ...]], ...]  # each with what it is a combination of
Mechanisms = tuple[tuple[Mechanism, ...], LeftOut]  # candidates, and those left out


class Data(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the recordings are and how they are laid out.

    Attributes:
        files: one recording a file, or folders of Parquet files; paths are relative to the study file.
        time (s): the column that holds the time; dates and times of day will do.
        date: the column that holds the day, where `time` holds a clock and the two stand apart.
        time_unit: of the column `time`; left out, what its heading says, as in "time (ms)", else seconds.
        sample_period (s): the time between rows, always in seconds, where no column holds it; one of the two must be
            given.
        recording: the column, or the key=value folder, that tells recordings apart.
        gaps: what happens where samples lack: they are bridged up to 32 steps, and the recording is cut where they are
            longer or an input did in them what nobody knows; or it is split at each, or refused.
        jitter (sample periods): how far time stamps may be from regular ones; further off, the recording is refused.
            Left out, any time stamps will do.
        memory (MB): what an identification may take; of a longer log the chunks are read one by one.
    """

    files: tuple[str, ...] = ()
    time: str | None = None
    date: str | None = None
    time_unit: TimeUnit | None = None
    sample_period: float | None = None
    recording: str | None = None
    gaps: Gaps = "bridge"
    jitter: float | None = None
    memory: float = 1000.0

    def __post_init__(self) -> None:
        check_fields(self)
        for name, value in (("time_unit", self.time_unit), ("date", self.date)):
            if self.time is None and value is not None:
                raise InputError(
                    f"{name} = {value!r} goes with time, the column that holds the time, which is not named: name it,"
                    f" or leave {name} out; sample_period is in seconds"
                )
        if not 0.0 < self.memory < math.inf:
            raise InputError(f"memory must be a number of megabytes, got {self.memory!r}")


class Measured(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A measured coordinate; its name is its key in the study.

    Attributes:
        column: the column that holds it; left out, that of its own name.
        order: of the highest derivative in its equation: 1 for a concentration, 2 for a position.
        cyclic: whether the equations do not contain the coordinate itself, as the position of a cart on a level track.
        angle: whether it is an angle: wraps are undone, sines and cosines enter the library.
        unit: of the column, for names and plots. An angle in "deg" is converted: in the equations it is in radians.
    """

    column: str | None = None
    order: int = 1
    cyclic: bool = False
    angle: bool = False
    unit: str | None = None

    def __post_init__(self) -> None:
        check_fields(self)


class Driven(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A recorded input; its name is its key in the study.

    Attributes:
        column: the column that holds it; left out, that of its own name. Where it was recorded more than once, as a
            command and as measured, a list: the column that describes the record best is taken, and the result says
            how each did. The first of every list go together, and so on.
        hold: what it does between samples: it is held ("zero"), runs linearly, or is band-limited; "auto" lets the
            likelihood decide.
        unit: of the column, for names and plots.
        delay (s): how late it acts. "auto" lets the likelihood find it beside the coefficients, where the record asks
            for one; "estimate" looks for it before, too, in a wider range.
    """

    column: str | tuple[str, ...] | None = None
    hold: Literal["auto"] | Hold = "auto"
    unit: str | None = None
    delay: float | Literal["auto", "estimate"] = "auto"

    def __post_init__(self) -> None:
        if isinstance(self.column, tuple) and not len(set(self.column)) == len(self.column) > 0:
            raise InputError(f"column must be a name, or several different ones, got {list(self.column)!r}")
        if self.hold not in ("auto", *get_args(Hold)):
            expected = ", ".join(map(repr, ("auto", *get_args(Hold))))
            raise InputError(f"hold must be one of {expected}, got {self.hold!r}")
        if isinstance(self.delay, str) and self.delay not in ("auto", "estimate"):
            raise InputError(f'delay must be a number of seconds, "auto" or "estimate", got {self.delay!r}')
        check_fields(self)
        if isinstance(self.delay, float) and not math.isfinite(self.delay):
            raise InputError(f'delay must be a number of seconds, "auto" or "estimate", got {self.delay!r}')


def _column_of(name: str, of: Measured | Driven) -> str:
    """Return the column that a coordinate or an input reads."""
    if isinstance(of.column, tuple):
        raise InputError(f"the input {name!r} is offered in {len(of.column)} columns; here it must be one: name it")
    return of.column or name


class Filtering(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How signals are filtered and differentiated.

    Attributes:
        differentiator: what filters and differentiates the coordinates.
        margin (periods of the lowest cutoff): what is dropped at each end of a record.
        decimate: whether regression sees eight samples a period of the highest cutoff, which is all that filtered
            signals hold, or every sample.
        outliers: they are taken for not measured ("gate"), kept, or clipped to three standard deviations about the
            filtered signal, which is Huber's loss.
    """

    differentiator: AnyDifferentiator = Spectral()
    margin: Annotated[float, msgspec.Meta(ge=0.0)] = 0.5
    decimate: bool = True
    outliers: Literal["gate", "keep", "clip"] = "gate"

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin < math.inf:
            raise InputError(f"margin must be a number of periods, 0 or more, got {self.margin!r}")


class Regression(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is fitted, and who proposes supports.

    Attributes:
        rows: what counts as an observation: weighted cosines, or samples.
        proposers: who proposes which terms stand in a relation; all of them are asked.
        nested: whether the smaller libraries within the library are searched, too.
    """

    rows: AnyRows = NoiseWeighted()
    proposers: tuple[AnyProposer, ...] = (EnergyThreshold(terms=30),)
    nested: bool = True

    def __post_init__(self) -> None:
        if not self.proposers:
            raise InputError("proposers must hold at least one")


class Random(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where random draws begin.

    Attributes:
        seed: of every random draw; the same seed gives the same model.
    """

    seed: Annotated[int, msgspec.Meta(ge=0)] = 0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.seed < 0:
            raise InputError(f"seed must be 0 or more, got {self.seed}")


class Study(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A whole study; every field but the coordinates has a default."""

    coordinates: dict[str, Measured]
    inputs: dict[str, Driven] = {}
    data: Data = Data()
    library: Candidates = Candidates()
    signals: Filtering = Filtering()
    regression: Regression = Regression()
    selection: Ranking = Ranking()
    likelihood: LikelihoodSearch = LikelihoodSearch()
    random: Random = Random()

    def __post_init__(self) -> None:
        check_tables(self)

    @property
    def degrees(self) -> frozenset[str]:
        """The angles that were recorded in degrees; in the equations they are in radians."""
        return frozenset(name for name, c in self.coordinates.items() if c.angle and is_degrees(c.unit))

    def measured(self) -> tuple[Coordinate, ...]:
        """Return the coordinates.

        Raises:
            InputError: there is none, a name is not usable, two names clash, or one reads the column of the time.
        """
        check_parts(self, "coordinates", Measured)
        check_parts(self, "inputs", Driven)
        if not self.coordinates:
            raise InputError("a study needs at least one coordinate: add [coordinates.NAME]")
        for name, c in self.coordinates.items():
            if self.data.time is not None and (c.column or name) == self.data.time:
                raise InputError(f"coordinate {name!r} reads the column {self.data.time!r}, which is the time")
        found = tuple(
            Coordinate(name, c.order, c.angle, c.cyclic, "rad" if name in self.degrees else c.unit)
            for name, c in self.coordinates.items()
        )
        names = [n for c in found for n in (*c.states, c.target)] + list(self.inputs)
        for name in names:
            if names.count(name) > 1:
                of = next((c for c in found if name in c.states[1:]), None)
                hint = "" if of is None else f": {how_to_give(name, of.name, of.order)}, {name} with another name"
                raise InputError(
                    f"the name {name!r} is used twice among coordinates, their derivatives and inputs{hint}"
                )
            if name in FUNCTIONS or name == "identity":
                raise InputError(f"{name!r} is the name of a function; call the coordinate or input something else")
        return found

    @property
    def clocks(self) -> frozenset[str]:
        """The inputs that are the time: of these only what a library names is a candidate."""
        return frozenset(n for n, i in self.inputs.items() if (i.column or n) == self.data.time)

    def driven(self) -> tuple[Input, ...]:
        """Return the inputs; one whose delay or hold is to be found has none, or is linear."""
        return tuple(
            Input(
                name, "linear" if i.hold == "auto" else i.hold, i.unit, i.delay if isinstance(i.delay, float) else 0.0
            )
            for name, i in self.inputs.items()
        )

    def _recorded(self) -> tuple[Input, ...]:
        return tuple(i for i in self.driven() if i.name not in self.clocks)

    def layout(self) -> Layout:
        """Return how the recordings are laid out."""
        named: list[tuple[str, Measured | Driven]] = [*self.coordinates.items(), *self.inputs.items()]
        return Layout(
            time=self.data.time,
            date=self.data.date,
            sample_period=self.data.sample_period,
            columns=tuple((name, _column_of(name, c)) for name, c in named),
            units=tuple((name, c.unit) for name, c in named if c.unit is not None),
            angles=frozenset(name for name, c in self.coordinates.items() if c.angle),
            degrees=self.degrees,
            held=frozenset(name for name, i in self.inputs.items() if i.hold == "zero"),
            inputs=frozenset(self.inputs),
            recording=self.data.recording,
            gaps=self.data.gaps,
            jitter=self.data.jitter,
            time_unit=self.data.time_unit or "s",
        )

    def _couples(self) -> bool:
        own = self.library
        if own.coupled != "auto":
            return own.coupled
        default = own.terms is None and own.basis is None and own.preset == "default"
        return default and sum(c.angle and c.order > 1 for c in self.coordinates.values()) > 1

    def forms(self) -> tuple[Form, ...]:
        """Return the forms that compete."""
        own, coordinates = self.library, self.measured()
        if own.own_form is not None:
            return (own.own_form,)
        mechanical = len(coordinates) > 1 and all(c.order == 2 for c in coordinates)
        fixed = own.terms is not None or own.preset == "paper" or not self.likelihood.enabled
        return ("relations", "lagrangian") if mechanical and not fixed else ("relations",)

    @property
    def suspects(self) -> tuple[str, ...]:
        """The states and inputs of which functions may be looked for that are not in the library: no angles."""
        own = self.library
        fixed = own.terms is not None or own.preset == "paper" or bool(own.ties) or not self.likelihood.enabled
        if fixed or not own.suspect:
            return ()
        left_out = {*(c.name for c in self.measured() if c.angle or c.cyclic), *self.clocks}
        return tuple(n for n in (*state_names(self.measured()), *self.inputs) if n not in left_out)

    @property
    def parameters(self) -> dict[str, Span]:
        """The constants within functions, and where they are looked for: those declared, and those of saturation."""
        found: dict[str, Span] = {saturation(name): "scale" for name in self.library.saturating}
        return found | self.library.parameters

    def scope(self) -> Scope:
        """Return the names and functions that the texts of the library may use."""
        coordinates, inputs, functions = self.measured(), self.driven(), self.library.functions
        names = [n for c in coordinates for n in (*c.states, c.target)] + [i.name for i in inputs]
        for name in self.parameters:
            if name in names or name in FUNCTIONS or name in functions or name == "identity":
                raise InputError(f"[library.parameters] {name!r} is taken by a state, an input or a function")
        return Scope.of(names, [Definition.of(head, body) for head, body in functions.items()], self.parameters)

    def mechanisms(self, form: Form) -> Mechanisms:
        """Return the mechanisms of Lagrange's equations or of reactions, and those left out as combinations of others.

        Raises:
            InputError: a text in [library] cannot be read, or says what the form cannot hold.
        """
        options, coordinates, inputs = self.library, self.measured(), self._recorded()
        if form == "lagrangian":
            found = lagrangian(
                coordinates,
                inputs,
                self.scope(),
                kinetic=options.kinetic,
                potential=options.potential,
                dissipation=options.dissipation,
                forces=options.forces,
            )
        else:
            found = reactions(
                coordinates,
                inputs,
                named=options.reactions,
                composition=options.composition,
                molecules=options.molecules,
                saturating=options.saturating,
                scope=self.scope(),
            )
        spans = {name: ANY_SCALE if span == "scale" else span for name, span in self.parameters.items()}
        return told_apart(tied(found, options.ties, self.scope()), coordinates, inputs, np.random.default_rng(0), spans)

    def candidates(self, target: str) -> Library:
        """Return the library of one target.

        Raises:
            InputError: a text in [library] cannot be read, or the library is too large or has no state.
        """
        options, coordinates, inputs = self.library, self.measured(), self._recorded()
        scope = self.scope()
        targets = tuple(c.target for c in coordinates) if self._couples() else (target,)
        if options.terms is not None:
            library = Library.of(options.terms, scope)
            library = library if any(t.names & set(targets) for t in library) else library + Library.of(targets, scope)
        elif options.basis is not None:
            of_its_own = default_rules(coordinates, targets, options.basis, scope)
            linear = default_rules((), targets, (), scope) if options.rules else ()
            library = Library.of((*options.basis, *targets), scope).powers(options.degree)
            library = library.thin(of_its_own if options.rules is None else (*options.rules, *linear), scope)
            library = library.with_single((parse_term(b, scope) for b in options.basis), options.parameters)
        elif options.preset == "paper":
            library = Library.of(paper_basis(coordinates, inputs), scope).powers(4)
            library = library.thin(paper_rules(coordinates, inputs, target), scope)
        else:
            library = default_library(coordinates, inputs, targets, scope, options.own_degree, options.sums is True)
            library = library.thin(options.rules or (), scope)
        library = library + Library.of(options.extra, scope)
        check_basis(coordinates, library)
        return library
