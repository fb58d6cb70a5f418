"""Study: everything an identification depends on, as frozen options that read from and write to TOML (DESIGN 3.2)."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
import tomli_w

from odescope.errors import InputError, nearest
from odescope.library.candidates import Library
from odescope.library.defaults import check_basis, default_library, default_rules, paper_basis, paper_rules
from odescope.library.functions import FUNCTIONS
from odescope.library.parse import Definition, Scope
from odescope.library.rules import AnyRule
from odescope.readers import Layout
from odescope.records import Coordinate, Input
from odescope.regression.proposers import AnyProposer, EnergyThreshold
from odescope.regression.rows import AnyRows, NoiseWeighted
from odescope.selection.rank import Ranking
from odescope.signals.cutoff import AnyCutoff
from odescope.signals.differentiators import AnyDifferentiator, Spectral


class Data(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the recordings are and how they are laid out; see `odescope.readers.Layout`."""

    files: tuple[str, ...] = ()
    time: str | None = None
    sample_period: float | None = None
    recording: str | None = None
    gaps: Literal["refuse", "split"] = "refuse"
    jitter: float = 0.05


class Measured(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A measured coordinate; its name is its key in the study."""

    column: str | None = None
    order: int = 1
    cyclic: bool = False
    angle: bool = False
    unit: str | None = None


class Driven(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A recorded input; its name is its key in the study."""

    column: str | None = None
    hold: Literal["linear", "zero"] = "linear"
    unit: str | None = None


class Candidates(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The library: a preset, or a basis with a degree and rules, or the candidate terms themselves.

    `functions` defines functions of one's own, as `"drag(v)" = "v*abs(v)"`. With `coupled`, every relation may hold
    every target; without, its own alone.
    """

    preset: Literal["default", "paper"] = "default"
    basis: tuple[str, ...] | None = None
    degree: int = 3
    terms: tuple[str, ...] | None = None
    rules: tuple[AnyRule, ...] | None = None
    functions: dict[str, str] = {}
    coupled: bool = False


class Filtering(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How signals are filtered and differentiated; `margin` is in periods of the lowest cutoff, at each end."""

    differentiator: AnyDifferentiator = Spectral()
    margin: float = 0.5
    thin: bool = True


class Regression(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is fitted, and who proposes supports; `nested` also searches the smaller libraries within the library."""

    rows: AnyRows = NoiseWeighted()
    proposers: tuple[AnyProposer, ...] = (EnergyThreshold(),)
    nested: bool = True


class Random(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The seed of every random draw."""

    seed: int = 0


class Study(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A whole study; every field but the coordinates has a default."""

    coordinates: dict[str, Measured]
    inputs: dict[str, Driven] = {}
    data: Data = Data()
    library: Candidates = Candidates()
    signals: Filtering = Filtering()
    regression: Regression = Regression()
    selection: Ranking = Ranking()
    random: Random = Random()

    def measured(self) -> tuple[Coordinate, ...]:
        """Return the coordinates.

        Raises:
            InputError: there is none, a name is not usable, or two names clash.
        """
        if not self.coordinates:
            raise InputError("a study needs at least one coordinate: add [coordinates.NAME]")
        found = tuple(Coordinate(name, c.order, c.angle, c.cyclic, c.unit) for name, c in self.coordinates.items())
        names = [n for c in found for n in (*c.states, c.target)] + list(self.inputs)
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"the name {name!r} is used twice among coordinates, their derivatives and inputs")
            if name in FUNCTIONS or name == "identity":
                raise InputError(f"{name!r} is the name of a function; call the coordinate or input something else")
        return found

    def driven(self) -> tuple[Input, ...]:
        """Return the inputs."""
        return tuple(Input(name, i.hold, i.unit) for name, i in self.inputs.items())

    def layout(self) -> Layout:
        """Return how the recordings are laid out."""
        named: list[tuple[str, Measured | Driven]] = [*self.coordinates.items(), *self.inputs.items()]
        return Layout(
            time=self.data.time,
            sample_period=self.data.sample_period,
            columns=tuple((name, c.column or name) for name, c in named),
            units=tuple((name, c.unit) for name, c in named if c.unit is not None),
            angles=frozenset(name for name, c in self.coordinates.items() if c.angle),
            held=frozenset(name for name, i in self.inputs.items() if i.hold == "zero"),
            recording=self.data.recording,
            gaps=self.data.gaps,
            jitter=self.data.jitter,
        )

    def candidates(self, target: str) -> Library:
        """Return the library of one target.

        Raises:
            InputError: a text in [library] cannot be read, or the library is too large or has no state.
        """
        options, coordinates, inputs = self.library, self.measured(), self.driven()
        names = [n for c in coordinates for n in (*c.states, c.target)] + [i.name for i in inputs]
        scope = Scope.of(names, [_definition(head, body) for head, body in options.functions.items()])
        targets = tuple(c.target for c in coordinates) if options.coupled else (target,)
        if options.terms is not None:
            library = Library.of(options.terms, scope)
            library = library if any(t.names & set(targets) for t in library) else library + Library.of(targets, scope)
        elif options.basis is not None:
            rules = default_rules(coordinates, targets, options.basis) if options.rules is None else options.rules
            library = Library.of((*options.basis, *targets), scope).powers(options.degree)
            library = library.thin((*rules, *(default_rules((), targets, ()) if options.rules else ())), scope)
        elif options.preset == "paper":
            library = Library.of(paper_basis(coordinates, inputs), scope).powers(4)
            library = library.thin(paper_rules(coordinates, inputs, target), scope)
        else:
            library = default_library(coordinates, inputs, targets, scope).thin(options.rules or (), scope)
        check_basis(coordinates, library)
        return library


def _definition(head: str, body: str) -> Definition:
    spelled = re.fullmatch(r"\s*([A-Za-z_]\w*)\s*\(\s*([A-Za-z_]\w*(?:\s*,\s*[A-Za-z_]\w*)*)\s*\)\s*", head, re.ASCII)
    if spelled is None:
        raise InputError(f'[library.functions] wants "name(argument, ...)" = "expression"; {head!r} came')
    return Definition(spelled[1], tuple(p.strip() for p in spelled[2].split(",")), body)


def read_study(path: Path) -> Study:
    """Return the study of a TOML file.

    Raises:
        InputError: the file is missing or no TOML, a key is unknown (the nearest is named), or a value does not fit.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the study {path}: {getattr(error, 'strerror', None) or error}") from error
    try:
        return parse_study(text)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error


def parse_study(text: str) -> Study:
    """Return the study that a TOML text spells; errors as `read_study`."""
    try:
        raw = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"it is not TOML: {error}") from error
    try:
        study = msgspec.convert(raw, Study)
    except (msgspec.ValidationError, RecursionError) as error:
        raise InputError(_explained(str(error))) from error
    study.measured()
    return study


_UNKNOWN = re.compile(r"unknown field `(?P<key>.*?)`(?: - at `\$\.?(?P<path>.*)`)?")


def _explained(message: str) -> str:
    """Name the nearest known key where msgspec names an unknown one."""
    unknown = _UNKNOWN.search(message)
    if unknown is None:
        return message.replace("`$.", "`").replace("Object", "the study" if "`$" not in message else "the table")
    path = re.split(r"[.\[]", unknown["path"] or "")
    section = f"[{unknown['path']}]" if unknown["path"] else "the study"
    return f"unknown key {unknown['key']!r} in {section}; {nearest(unknown['key'], _known_keys(path))}"


def _known_keys(path: Sequence[str]) -> list[str]:
    sections: dict[str, Any] = {
        "": Study,
        "data": Data,
        "coordinates": Measured,
        "inputs": Driven,
        "library": Candidates,
        "signals": Filtering,
        "regression": Regression,
        "selection": Ranking,
        "random": Random,
    }
    if len(path) > 1 and path[0] not in ("coordinates", "inputs"):
        unions = (AnyRule, AnyProposer, AnyRows, AnyDifferentiator, AnyCutoff)
        return sorted({field for union in unions for kind in get_args(union) for field in kind.__struct_fields__})
    return list(sections.get(path[0], Study).__struct_fields__)


def study_toml(study: Study) -> str:
    """Return the study as TOML with every default spelled out."""
    return tomli_w.dumps(_without_none(msgspec.to_builtins(study)))


def moved(study: Study, old: Path, new: Path) -> Study:
    """Return the study with its file paths, relative to folder `old`, made relative to folder `new`."""
    files = []
    for file in study.data.files:
        target = (old / file).resolve()
        try:
            files.append(Path(os.path.relpath(target, new.resolve())).as_posix())
        except ValueError:  # another drive, on Windows
            files.append(target.as_posix())
    return msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, files=tuple(files)))


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value
