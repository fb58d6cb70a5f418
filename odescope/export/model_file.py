"""model.json: writing it, and reading it with every key checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from odescope.errors import InputError, as_path, check_kind
from odescope.files import model_in, write_file
from odescope.json_text import encoded
from odescope.library.mechanism import Kind
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.explicit import blocks, short_explicit
from odescope.model.model import Model
from odescope.model.relation import FoundMechanism, FoundParameter, Relation, RelationTerm
from odescope.model.scores import ModelScores
from odescope.recordings.checks import is_degrees
from odescope.recordings.coordinate import Coordinate, Input

OPTIONAL = ("delay", "offset")  # keys of an input and of a coordinate that a file may leave out
NAMED = "named_terms"  # key of the provenance: the terms that hold a constant, with its name in them
LONGEST_EXPLICIT = 2000  # characters: a longer fraction is for nobody to read


class _Term(msgspec.Struct, forbid_unknown_fields=True):
    factor: str | None
    term: str
    coefficient: float
    std_error: float | None


class _Relation(msgspec.Struct, forbid_unknown_fields=True):
    terms: list[_Term]


class _Mechanism(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    kind: Kind
    term: str
    coefficient: float
    std_error: float | None


class _Parameter(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    value: float
    std_error: float | None
    terms: list[str]


class _File(msgspec.Struct, forbid_unknown_fields=True):
    format: Literal["odescope/model"]
    version: Literal[1]
    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    states: list[str]
    targets: list[str]
    relations: list[_Relation]
    explicit: dict[str, str]
    scores: ModelScores
    domain: dict[str, tuple[float, float]]
    provenance: dict[str, Any]
    mechanisms: tuple[_Mechanism, ...] = ()
    parameters: tuple[_Parameter, ...] = ()


class _Keys(msgspec.Struct):
    """The part of a file in which a key may be missing without msgspec's notice."""

    coordinates: list[dict[str, msgspec.Raw]]
    inputs: list[dict[str, msgspec.Raw]]


def to_json(model: Model) -> str:
    """Return the text of model.json; floats round-trip, and null stands for a number that is not finite."""
    check_kind(model, Model, "what is written")
    file: dict[str, object] = {
        "format": "odescope/model",
        "version": 1,
        "coordinates": [_prompt(c) for c in model.coordinates],
        "inputs": [_prompt(i) for i in model.inputs],
        "states": model.states,
        "targets": model.targets,
        "relations": [
            _Relation([_Term(t.factor, t.term.text, t.coefficient, t.std_error) for t in r.terms])
            for r in model.relations
        ],
        "explicit": _explicit(model),
        "scores": model.scores or ModelScores(),
        "domain": {name: (float(low), float(high)) for name, (low, high) in model.domain.items()},
        "provenance": dict(model.provenance),
    }
    if model.mechanisms:
        file["mechanisms"] = [_Mechanism(m.name, m.kind, m.term, m.coefficient, m.std_error) for m in model.mechanisms]
    if model.parameters:
        file["parameters"] = [_Parameter(p.name, p.value, p.std_error, list(p.terms)) for p in model.parameters]
        file["provenance"] = {**model.provenance, NAMED: {p.name: p.written for p in model.parameters if p.written}}
    return msgspec.json.format(encoded(file), indent=2).decode() + "\n"


def write_model(model: Model, path: Path | str) -> None:
    """Write a model to a file, complete beside its place before it takes it; `read_model` reads it back.

    Raises:
        InputError: it cannot be written.
    """
    write_file(as_path(path, "a model file"), to_json(model))


def _explicit(model: Model) -> dict[str, str]:
    """Return the fractions that are short enough to be read, by target in the order of the targets."""
    found = dict[str, str]()
    for block in blocks(model.relations, model.targets):
        found |= {t: q.text for t, q in short_explicit(model.relations, block).items()}
    return {t: found[t] for t in model.targets if t in found and len(found[t]) <= LONGEST_EXPLICIT}


def _prompt(channel: Coordinate | Input) -> dict[str, object]:
    """Return a coordinate or an input as plain data, its offset or delay only where there is one."""
    return {key: value for key, value in msgspec.structs.asdict(channel).items() if key not in OPTIONAL or value}


def read_model(path: Path | str) -> Model:
    """Return the model of a file, or that of a folder of results.

    Raises:
        InputError: the file is missing, no JSON, has missing or extra keys, or terms that cannot be read.
    """
    path = model_in(as_path(path, "a model file"))
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read the model {path}: {error.strerror or error}") from error
    try:
        return from_json(data)
    except InputError as error:
        raise InputError(f"{path} is not a model that odescope can read: {error}") from error


def from_json(data: bytes | str) -> Model:
    """Return the model that a model.json spells; nothing in it is evaluated.

    Raises:
        InputError: no JSON, missing or extra keys, or terms that cannot be read.
    """
    try:
        file = msgspec.json.decode(data, type=_File)
        keys = msgspec.json.decode(data, type=_Keys)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(_explained(str(error))) from error
    _check_complete("coordinates", keys.coordinates, [f for f in Coordinate.__struct_fields__ if f not in OPTIONAL])
    _check_complete("inputs", keys.inputs, [f for f in Input.__struct_fields__ if f not in OPTIONAL])
    coordinates, inputs = file.coordinates, file.inputs
    if not coordinates:
        raise InputError("it has no coordinate")
    names = [n for c in coordinates for n in (*c.states, c.target)] + [i.name for i in inputs]
    if len(set(names)) < len(names):
        raise InputError(f"the name {max(names, key=names.count)!r} is used twice")
    scope = Scope.of([n for c in coordinates for n in c.states] + [i.name for i in inputs])
    _check_radians(coordinates)
    relations = tuple(Relation(tuple(_read_term(t, scope) for t in r.terms)) for r in file.relations)
    mechanisms = tuple(_read_mechanism(m) for m in file.mechanisms)
    named = _named_terms(file.provenance.pop(NAMED, {}))
    parameters = tuple(_read_parameter(p, named.get(p.name, ())) for p in file.parameters)
    scores = None if file.scores == ModelScores() else file.scores
    model = Model(coordinates, inputs, relations, scores, file.domain, file.provenance, mechanisms, parameters)
    for what, came, expected in (("states", file.states, model.states), ("targets", file.targets, model.targets)):
        if tuple(came) != expected:
            raise InputError(f"its {what} are {', '.join(came)}, but its coordinates make them {', '.join(expected)}")
    return model


def _check_complete(where: str, found: Sequence[Mapping[str, msgspec.Raw]], wanted: Sequence[str]) -> None:
    """Refuse a coordinate or an input without a key that has a default in memory: a file leaves nothing to guess."""
    for k, keys in enumerate(found):
        for name in wanted:
            if name not in keys:
                raise InputError(f"an object is missing required field `{name}` - at `{where}[{k}]`")


def _check_radians(coordinates: Sequence[Coordinate]) -> None:
    for c in coordinates:
        if c.angle and is_degrees(c.unit):
            raise InputError(
                f'the angle {c.name!r} has the unit {c.unit!r}, but equations of angles are in radians: write "unit":'
                f' "rad", and in "provenance", where the column that is read is in degrees, "degrees": ["{c.name}"]'
            )


def _explained(message: str) -> str:
    if "`$.format`" in message:
        return 'its format is not "odescope/model"'
    if "`$.version`" in message:
        return "its version is not 1, the only one known here"
    if "recursion" in message:
        return "it is nested too deep"
    if "`$" not in message and not message.startswith("Object"):  # no JSON, or no table of it
        return f"expected the model.json of odescope identify, or the folder that it is in; {message}"
    return message.replace("`$.", "`").replace("Object", "an object")


def _read_mechanism(m: _Mechanism) -> FoundMechanism:
    _check_numbers(m.name, m.coefficient, m.std_error)
    return FoundMechanism(m.name, m.kind, m.term, m.coefficient, m.std_error)


def _named_terms(found: object) -> dict[str, tuple[str, ...]]:
    try:
        return msgspec.convert(found, dict[str, tuple[str, ...]])
    except msgspec.ValidationError as error:
        raise InputError(f"its provenance holds {NAMED!r}, which is no lists of terms: {error}") from error


def _read_parameter(p: _Parameter, written: tuple[str, ...]) -> FoundParameter:
    _check_numbers(p.name, p.value, p.std_error)
    return FoundParameter(p.name, p.value, p.std_error, tuple(p.terms), written)


def _check_numbers(what: str, coefficient: float, std_error: float | None) -> None:
    if not math.isfinite(coefficient):
        raise InputError(f"the coefficient of {what!r} is not finite")
    if std_error is not None and not std_error >= 0.0:
        raise InputError(f"the standard error of {what!r} is negative")


def _read_term(t: _Term, scope: Scope) -> RelationTerm:
    _check_numbers(t.term, t.coefficient, t.std_error)
    return RelationTerm(Product(t.factor, parse_term(t.term, scope)), t.coefficient, t.std_error)
