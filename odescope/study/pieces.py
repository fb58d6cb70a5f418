"""Pieces of one's own: proposers, differentiators and rows that are not odescope's.

From Python any object with the right method will do. A study file names only what an installed package offers under an
entry point, by the entry point's name as its `kind`: nothing that a file says is imported or executed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_args

import msgspec
import tomli_w

from odescope.errors import InputError, nearest
from odescope.regression.proposers import AnyProposer
from odescope.regression.rows import AnyRows
from odescope.signals.differentiators import AnyDifferentiator
from odescope.study.options import Filtering, Regression, Study
from odescope.study.wrong_types import in_words_of_toml


@dataclass(frozen=True)
class Place:
    """Where in a study a piece of one's own may stand, the group of its entry points, and the method that it needs."""

    section: str
    key: str
    group: str
    method: str
    kinds: tuple[type, ...]
    default: object

    @property
    def several(self) -> bool:
        """Whether there may be more than one."""
        return isinstance(self.default, tuple)

    @property
    def defaults(self) -> tuple[object, ...]:
        """The default, alone or several."""
        return self.default if isinstance(self.default, tuple) else (self.default,)

    def pieces(self, study: Study) -> tuple[object, ...]:
        """Return what stands here in a study."""
        found = getattr(getattr(study, self.section), self.key)
        return tuple(found) if self.several else (found,)

    def name(self, k: int) -> str:
        """Return what the k-th piece is called in messages."""
        return f"{self.section}.{self.key}" + (f"[{k}]" if self.several else "")

    def installed(self) -> dict[str, EntryPoint]:
        """Return what installed packages offer, by kind."""
        own = {str(kind.__struct_config__.tag) for kind in self.kinds}  # type: ignore[attr-defined]
        return {e.name: e for e in entry_points(group=self.group) if e.name not in own}


PLACES = (
    Place(
        "signals", "differentiator", "odescope.differentiators", "derivatives", get_args(AnyDifferentiator),
        Filtering().differentiator,
    ),
    Place("regression", "rows", "odescope.rows", "row_map", get_args(AnyRows), Regression().rows),
    Place("regression", "proposers", "odescope.proposers", "supports", get_args(AnyProposer), Regression().proposers),
)  # fmt: skip


@dataclass(frozen=True)
class Own:
    """A piece of one's own that a study file names: its place, its number among those there, and the object."""

    place: Place
    number: int
    piece: object


@dataclass(frozen=True)
class Unsaid:
    """A piece that a study file cannot name: where it stands, and what it is."""

    where: str
    what: str
    group: str

    @property
    def comment(self) -> str:
        """The line that stands for it in a file."""
        return f"{self.where} was {self.what}, which no installed package offers by name: it is left out here"

    @property
    def note(self) -> str:
        """What the user should know of it."""
        return (
            f"the study file cannot name {self.what} ({self.where}) and leaves it out, so that running the file gives"
            f" another result: offer it in a package, as an entry point of the group {self.group}"
        )


def own_pieces(raw: Mapping[str, object]) -> tuple[dict[str, object], tuple[Own, ...]]:
    """Return the tables of a study file with defaults where it names pieces of one's own, and these pieces.

    Raises:
        InputError: an entry point cannot be loaded or lacks its method, or an option is unknown or does not fit.
    """
    plain, found = dict(raw), list[Own]()
    for place in PLACES:
        section = plain.get(place.section)
        if not isinstance(section, dict) or place.key not in section:
            continue
        given, installed = section[place.key], place.installed()
        listed = given if place.several and isinstance(given, list) else [given]
        stand_in, kept = msgspec.to_builtins(place.defaults[0]), []
        for k, table in enumerate(listed):
            kind = table.get("kind") if isinstance(table, dict) else None
            if isinstance(kind, str) and kind in installed:
                found.append(Own(place, k, _made(place, installed[kind], table, place.name(k))))
                kept.append(stand_in)
            else:
                kept.append(table)
        plain[place.section] = {**section, place.key: kept if listed is given else kept[0]}
    return plain, tuple(found)


def _made(place: Place, entry: EntryPoint, table: Mapping[str, object], where: str) -> object:
    """Return the piece that a table describes."""
    offered = f"kind {entry.name!r} at `{where}`, which {entry.dist.name if entry.dist else entry.value} offers,"
    try:
        kind = entry.load()
    except Exception as error:  # whatever another package does when it is imported
        raise InputError(f"{offered} cannot be loaded ({error}); mend or remove that package") from error
    if not isinstance(kind, type) or not callable(getattr(kind, place.method, None)):
        raise InputError(f"{offered} is no class with a method {place.method}, which this place needs")
    options = {key: value for key, value in table.items() if key != "kind"}
    known = _fields(kind)
    for key in options:
        if key not in known:
            raise InputError(f"unknown key {key!r} in [{where}]; {nearest(key, known)}")
    if not known:
        return kind()
    try:
        return msgspec.convert(options, kind)
    except msgspec.ValidationError as error:
        raise InputError(in_words_of_toml(str(error).replace("`$", f"`{where}"))) from error


def _fields(kind: type) -> list[str]:
    """Return the names of the options of a class: those of a msgspec struct or a dataclass, else none."""
    if issubclass(kind, msgspec.Struct):
        return list(kind.__struct_encode_fields__)
    return [f.name for f in dataclasses.fields(kind) if f.init] if dataclasses.is_dataclass(kind) else []


def put_in(study: Study, own: tuple[Own, ...]) -> Study:
    """Return the study with pieces of one's own in their places."""
    for one in own:
        pieces = list(one.place.pieces(study))
        pieces[one.number] = one.piece
        study = _with(study, one.place, tuple(pieces) if one.place.several else pieces[0])
    return study


def _with(study: Study, place: Place, value: object) -> Study:
    section = msgspec.structs.replace(getattr(study, place.section), **{place.key: value})
    return msgspec.structs.replace(study, **{place.section: section})


def tables(study: Study) -> tuple[dict[str, dict[str, object]], tuple[Unsaid, ...]]:
    """Return the study as tables for TOML, every default spelled out, and the pieces that these cannot name."""
    plain, said, unsaid = study, list[tuple[Place, list[dict[str, object]]]](), list[Unsaid]()
    for place in PLACES:
        named = []
        for k, piece in enumerate(place.pieces(study)):
            table = table_of(place, piece)
            if table is None:
                unsaid.append(Unsaid(place.name(k), _name(piece), place.group))
            else:
                named.append(table)
        said.append((place, named))
        plain = _with(plain, place, place.default)
    found: dict[str, Any] = msgspec.to_builtins(plain)
    for place, named in said:
        if named:
            found[place.section][place.key] = named if place.several else named[0]
    whole: dict[str, dict[str, object]] = _without_none(found)
    return whole, tuple(unsaid)


def table_of(place: Place, piece: object) -> dict[str, object] | None:
    """Return the table that names a piece in a study file, or None where none can."""
    kind = type(piece)
    if kind in place.kinds:
        table: dict[str, object] = msgspec.to_builtins(piece)
        return table
    entry = _offered(place, kind)
    if entry is None:
        return None
    if not _fields(kind):
        return None if getattr(piece, "__dict__", None) else {"kind": entry.name}
    try:
        options = _without_none(msgspec.to_builtins(piece))
        tomli_w.dumps(options)
    except (TypeError, ValueError, AttributeError):  # an option that is no number, text or list of these
        return None
    return {"kind": entry.name, **{key: value for key, value in options.items() if key != "kind"}}


def versions(study: Study) -> tuple[str, ...]:
    """Return which packages, in which version, the pieces of a study come from that are not odescope's."""
    found = []
    for place in PLACES:
        for piece in place.pieces(study):
            entry = None if type(piece) in place.kinds else _offered(place, type(piece))
            if entry is not None and entry.dist is not None:
                found.append(f"{entry.dist.name} {entry.dist.version}")
    return tuple(found)


def _offered(place: Place, kind: type) -> EntryPoint | None:
    """Return the entry point that offers a class; only packages that are imported already are looked into."""
    package = kind.__module__.partition(".")[0]
    for entry in place.installed().values():
        if entry.module.partition(".")[0] == package:
            try:
                if entry.load() is kind:
                    return entry
            except (ImportError, AttributeError):
                continue  # an entry that names nothing offers nothing; who names it in a file is told
    return None


def _name(piece: object) -> str:
    """Return what a piece is, on one line and the same in every run."""
    kind = type(piece)
    return ascii(f"{kind.__qualname__} of {kind.__module__}").strip("'\"")


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value
