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
from odescope.library.rules import AnyRule
from odescope.library.ties import tied
from odescope.likelihood.search import LikelihoodSearch
from odescope.recordings.checks import is_degrees
from odescope.recordings.coordinate import Coordinate, Hold, Input, state_names
from odescope.recordings.gaps import Gaps
from odescope.recordings.layout import Layout
from odescope.regression.proposers import EnergyThreshold
from odescope.regression.rank import told_apart
from odescope.regression.rows import NoiseWeighted
from odescope.selection.ranking import Ranking
from odescope.signals.differentiators import Spectral

if TYPE_CHECKING:  # pieces of one's own go in from Python; what a file may name beside the kinds below, see pieces
    from odescope.regression.proposers import Proposer as AnyProposer
    from odescope.regression.rows import RowChoice as AnyRows
    from odescope.signals.differentiators import Differentiator as AnyDifferentiator
else:
    from odescope.regression.proposers import AnyProposer
    from odescope.regression.rows import AnyRows
    from odescope.signals.differentiators import AnyDifferentiator


Span = tuple[float, float] | Literal["scale"]
ANY_SCALE = (0.3, 3.0)  # where a constant is drawn from whose range the data will say

LeftOut = tuple[tuple[Mechanism, tuple[Mechanism, ...]], ...]  # each with what it is a combination of
Mechanisms = tuple[tuple[Mechanism, ...], LeftOut]  # candidates, and those left out


class Data(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the recordings are and how they are laid out; see `odescope.recordings.layout.Layout`.

    `memory` is what an identification may take, in MB: of a longer log the chunks are read one by one.
    """

    files: tuple[str, ...] = ()
    time: str | None = None
    sample_period: float | None = None
    recording: str | None = None
    gaps: Gaps = "bridge"
    jitter: float | None = None
    memory: float = 1000.0

    def __post_init__(self) -> None:
        if not 0.0 < self.memory < math.inf:
            raise InputError(f"memory must be a number of megabytes, got {self.memory!r}")


class Measured(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A measured coordinate; its name is its key in the study. An angle of the unit "deg" is converted to radians."""

    column: str | None = None
    order: int = 1
    cyclic: bool = False
    angle: bool = False
    unit: str | None = None


class Driven(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A recorded input; its name is its key in the study. It acts `delay` seconds late.

    `hold` says what it does between samples: is held ("zero"), runs linearly, or is band-limited; "auto" lets the
    likelihood decide. A delay of "auto" lets it find one beside the coefficients, where the record asks for one;
    "estimate" looks for it before, too, in a wider range.
    """

    column: str | None = None
    hold: Literal["auto"] | Hold = "auto"
    unit: str | None = None
    delay: float | Literal["auto", "estimate"] = "auto"

    def __post_init__(self) -> None:
        if self.hold not in ("auto", *get_args(Hold)):
            expected = ", ".join(map(repr, ("auto", *get_args(Hold))))
            raise InputError(f"hold must be one of {expected}, got {self.hold!r}")
        if self.delay not in ("auto", "estimate") and not (isinstance(self.delay, float) and math.isfinite(self.delay)):
            raise InputError(f'delay must be a number of seconds, "auto" or "estimate", got {self.delay!r}')


Form = Literal["relations", "lagrangian", "reactions"]

_BELONG: dict[str, Form] = {
    "kinetic": "lagrangian",
    "potential": "lagrangian",
    "dissipation": "lagrangian",
    "forces": "lagrangian",
    "composition": "reactions",
    "reactions": "reactions",
}


class Candidates(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The library: a preset, or a basis with a degree and rules, or the candidate terms themselves; and its form.

    `form` is what the candidates are terms of: of "relations" between states, targets and inputs; of the energies,
    dissipation and forces of Lagrange's equations ("lagrangian"), each of which may be named instead of its default; or
    "reactions", named, or all between complexes of at most so many `molecules` that a `composition` allows, with fluxes
    that saturate in the `saturating` species too. "auto" lets
    Lagrange's equations compete with relations where there are several coordinates, all of order 2. `ties` are linear
    equalities between coefficients, see `odescope.library.ties`.

    `parameters` are constants within functions, such as v0 in "tanh(x_dot/v0)", each with the range that it is looked
    for in, or "scale" for one from the data.

    `functions` defines functions of one's own, as `"drag(v)" = "v*abs(v)"`. With `coupled`, every relation may hold
    every target; without, its own alone. "auto" couples the default library of several angles: a chain of pendulums has
    short relations between its accelerations, and long explicit ones.

    With `suspect`, functions that are not in the library (roots, logarithms, exponentials, tanh, sines, ...) compete
    where several powers or fractions of a variable seem to imitate one, or a residual goes with a variable: in
    relations, unless these are the paper's or `terms` names their candidates one by one.
    """

    preset: Literal["default", "paper"] = "default"
    basis: tuple[str, ...] | None = None
    degree: Annotated[int, msgspec.Meta(ge=1, le=12)] = 3
    terms: tuple[str, ...] | None = None
    rules: tuple[AnyRule, ...] | None = None
    functions: dict[str, str] = {}
    coupled: bool | Literal["auto"] = "auto"
    form: Literal["auto"] | Form = "auto"
    kinetic: tuple[str, ...] | None = None
    potential: tuple[str, ...] | None = None
    dissipation: tuple[str, ...] | None = None
    forces: dict[str, tuple[str, ...]] | None = None
    composition: dict[str, str] | None = None
    reactions: tuple[str, ...] | None = None
    molecules: Annotated[int, msgspec.Meta(ge=1, le=4)] = 2
    ties: tuple[str, ...] = ()
    saturating: tuple[str, ...] = ()
    parameters: dict[str, Span] = {}
    suspect: bool = True

    def __post_init__(self) -> None:
        if self.form not in ("auto", *get_args(Form)):
            raise InputError(f'form must be "auto", {", ".join(map(repr, get_args(Form)))}; {self.form!r} came')
        for name, form in _BELONG.items():
            if getattr(self, name) is not None and self.form not in ("auto", form):
                raise InputError(f'[library] {name} belongs to form = "{form}", but form is "{self.form}"')
        if self.own_form == "reactions" and self.reactions is None and self.composition is None:
            raise InputError(
                'form = "reactions" needs [library] reactions, such as ["S + E -> C"], or a composition of the species'
            )
        for name, span in self.parameters.items():
            if not (name.isidentifier() and name.isascii()):
                raise InputError(f"[library.parameters] {name!r} is no name: use letters, digits and underscores")
            if span != "scale" and not (np.isfinite(span).all() and span[0] < span[1]):
                raise InputError(
                    f"[library.parameters] {name} wants a range with its lower end first, such as [0.1, 10.0], or"
                    f' "scale" for one from the data; {list(span)!r} came'
                )
        if self.degree < 1:
            raise InputError(f"degree must be at least 1, got {self.degree}")
        if self.terms is not None and self.basis is not None:
            raise InputError("terms and basis exclude each other: name the terms, or a basis to build them from")
        fixed = "terms" if self.terms is not None else "the paper's preset" if self.preset == "paper" else None
        if self.rules is not None and fixed and self.basis is None:
            raise InputError(f"rules do not apply to {fixed}; leave them out, or name a basis")

    @property
    def own_form(self) -> Form | None:
        """The form that the library asks for by name or by what it gives; None where it leaves that open."""
        if self.form != "auto":
            return self.form
        asked = {form for name, form in _BELONG.items() if getattr(self, name) is not None}
        if len(asked) > 1:
            raise InputError("[library] names energies and reactions: they belong to different forms, give one")
        return next(iter(asked), None)


class Filtering(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How signals are filtered and differentiated; `margin` is in periods of the lowest cutoff, at each end.

    `outliers` are taken for not measured ("gate"), kept, or clipped to three standard deviations about the filtered
    signal, which is Huber's loss.
    """

    differentiator: AnyDifferentiator = Spectral()
    margin: Annotated[float, msgspec.Meta(ge=0.0)] = 0.5
    decimate: bool = True
    outliers: Literal["gate", "keep", "clip"] = "gate"

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin < math.inf:
            raise InputError(f"margin must be a number of periods, 0 or more, got {self.margin!r}")


class Regression(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is fitted, and who proposes supports; `nested` also searches the smaller libraries within the library."""

    rows: AnyRows = NoiseWeighted()
    proposers: tuple[AnyProposer, ...] = (EnergyThreshold(terms=30),)
    nested: bool = True

    def __post_init__(self) -> None:
        if not self.proposers:
            raise InputError("proposers must hold at least one")


class Random(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The seed of every random draw."""

    seed: Annotated[int, msgspec.Meta(ge=0)] = 0

    def __post_init__(self) -> None:
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

    @property
    def degrees(self) -> frozenset[str]:
        """The angles that were recorded in degrees; in the equations they are in radians."""
        return frozenset(name for name, c in self.coordinates.items() if c.angle and is_degrees(c.unit))

    def measured(self) -> tuple[Coordinate, ...]:
        """Return the coordinates.

        Raises:
            InputError: there is none, a name is not usable, two names clash, or one reads the column of the time.
        """
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
                raise InputError(f"the name {name!r} is used twice among coordinates, their derivatives and inputs")
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
            sample_period=self.data.sample_period,
            columns=tuple((name, c.column or name) for name, c in named),
            units=tuple((name, c.unit) for name, c in named if c.unit is not None),
            angles=frozenset(name for name, c in self.coordinates.items() if c.angle),
            degrees=self.degrees,
            held=frozenset(name for name, i in self.inputs.items() if i.hold == "zero"),
            inputs=frozenset(self.inputs),
            recording=self.data.recording,
            gaps=self.data.gaps,
            jitter=self.data.jitter,
        )

    def _couples(self) -> bool:
        own = self.library
        if own.coupled != "auto":
            return own.coupled
        default = own.terms is None and own.basis is None and own.preset == "default"
        return default and sum(c.angle for c in self.coordinates.values()) > 1

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
            library = default_library(coordinates, inputs, targets, scope).thin(options.rules or (), scope)
        check_basis(coordinates, library)
        return library
