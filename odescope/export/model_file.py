"""model.json: writing it, and reading it with every key checked (DESIGN 3.3)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import msgspec

from odescope.errors import InputError
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.explicit import explicit
from odescope.model.model import Json, Model
from odescope.model.relation import Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input


class _Coordinate(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    order: int
    angle: bool
    cyclic: bool
    unit: str | None


class _Input(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    name: str
    hold: Literal["linear", "zero"]
    unit: str | None
    delay: float | None = None  # written only where there is one


class _Term(msgspec.Struct, forbid_unknown_fields=True):
    factor: str | None
    term: str
    coefficient: float
    std_error: float | None


class _Relation(msgspec.Struct, forbid_unknown_fields=True):
    terms: list[_Term]


class _File(msgspec.Struct, forbid_unknown_fields=True):
    format: Literal["odescope/model"]
    version: Literal[1]
    coordinates: list[_Coordinate]
    inputs: list[_Input]
    states: list[str]
    targets: list[str]
    relations: list[_Relation]
    explicit: dict[str, str]
    scores: dict[str, Any]
    domain: dict[str, tuple[float, float]]
    provenance: dict[str, Any]


def to_json(model: Model) -> str:
    """Return the text of model.json; floats round-trip."""
    file = _File(
        format="odescope/model",
        version=1,
        coordinates=[_Coordinate(c.name, c.order, c.angle, c.cyclic, c.unit) for c in model.coordinates],
        inputs=[_Input(i.name, i.hold, i.unit, i.delay or None) for i in model.inputs],
        states=list(model.states),
        targets=list(model.targets),
        relations=[
            _Relation([_Term(t.factor, t.term.text, t.coefficient, t.std_error) for t in r.terms])
            for r in model.relations
        ],
        explicit={q.target: q.text for q in explicit(model)},
        scores=_finite(dict(model.scores)),
        domain={name: (float(low), float(high)) for name, (low, high) in model.domain.items()},
        provenance=_finite(dict(model.provenance)),
    )
    return msgspec.json.format(msgspec.json.encode(file), indent=2).decode() + "\n"


def _finite(value: Any) -> Any:
    # JSON has no infinity; null says that there is no such number.
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(k): _finite(v) for k, v in value.items()}
    return [_finite(v) for v in value] if isinstance(value, list | tuple) else value


def read_model(path: Path) -> Model:
    """Return the model of a file.

    Raises:
        InputError: the file is missing, no JSON, has missing or extra keys, or terms that cannot be read.
    """
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
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(_explained(str(error))) from error
    coordinates = tuple(Coordinate(c.name, c.order, c.angle, c.cyclic, c.unit) for c in file.coordinates)
    inputs = tuple(Input(i.name, i.hold, i.unit, i.delay or 0.0) for i in file.inputs)
    if not coordinates:
        raise InputError("it has no coordinate")
    names = [n for c in coordinates for n in (*c.states, c.target)] + [i.name for i in inputs]
    if len(set(names)) < len(names):
        raise InputError(f"the name {max(names, key=names.count)!r} is used twice")
    scope = Scope.of([n for c in coordinates for n in c.states] + [i.name for i in inputs])
    relations = tuple(Relation(tuple(_read_term(t, scope) for t in r.terms)) for r in file.relations)
    scores: dict[str, Json] = file.scores
    model = Model(coordinates, inputs, relations, scores, file.domain, file.provenance)
    for what, came, expected in (("states", file.states, model.states), ("targets", file.targets, model.targets)):
        if tuple(came) != expected:
            raise InputError(f"its {what} are {', '.join(came)}, but its coordinates make them {', '.join(expected)}")
    return model


def _explained(message: str) -> str:
    if "`$.format`" in message:
        return 'its format is not "odescope/model"'
    if "`$.version`" in message:
        return "its version is not 1, the only one known here"
    if "recursion" in message:
        return "it is nested too deep"
    return message.replace("`$.", "`").replace("Object", "an object")


def _read_term(t: _Term, scope: Scope) -> RelationTerm:
    if not math.isfinite(t.coefficient):
        raise InputError(f"the coefficient of {t.term!r} is not finite")
    if t.std_error is not None and not t.std_error >= 0.0:
        raise InputError(f"the standard error of {t.term!r} is negative")
    return RelationTerm(Product(t.factor, parse_term(t.term, scope)), t.coefficient, t.std_error)
