"""A model in the unit of time that its log was recorded in, for people: files have seconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import msgspec

from odescope.library.expression import Call, Name
from odescope.model.model import Model
from odescope.model.recorded import clocks
from odescope.model.relation import FoundMechanism, Relation, RelationTerm
from odescope.recordings.headings import UNITS_OF_TIME, TimeUnit, in_seconds

T = TypeVar("T", RelationTerm, FoundMechanism)


def recorded_unit(model: Model) -> TimeUnit:
    """Return the unit of the time column that a model was identified with."""
    return next((u for u in UNITS_OF_TIME if u == model.provenance.get("time_unit")), UNITS_OF_TIME[0])


def told_unit(model: Model) -> TimeUnit:
    """Return the unit that people are told times in: that of the log, but seconds where it has milliseconds.

    Machines are logged in these, whose speeds are per second.
    """
    unit = recorded_unit(model)
    return UNITS_OF_TIME[0] if unit == "ms" else unit


def counted_in(seconds: float, unit: TimeUnit) -> float:
    """Return how many of a unit of time so many seconds are."""
    more, fewer = in_seconds(unit)
    return seconds * fewer / more


def in_told_time(model: Model) -> Model:
    """Return a model whose rates are per unit of the time that people are told; the same where not all can be said so.

    A coefficient in seconds is multiplied by the seconds of the unit once for every 1/s in its own unit. That is not
    known where a rate, or the time, is within a function, or where terms are parts of an energy.
    """
    more, fewer = in_seconds(told_unit(model))
    unit = more / fewer
    rates = {c.derivative(k): k for c in model.coordinates for k in range(1, c.order + 1)}
    reacts = all(m.kind == "reaction" for m in model.mechanisms) and not (model.mechanisms and max(rates.values()) > 1)
    terms = (t.term for r in model.relations for t in r.terms)
    inside = {n for t in terms for atom, _ in t.factors if isinstance(atom, Call) for n in atom.argument.names}
    if unit == 1.0 or not reacts or not inside.isdisjoint(rates) or any(n in clocks(model) for n in inside):
        return model
    relations = (_relation(r, c.order, rates, unit) for r, c in zip(model.relations, model.coordinates, strict=True))
    return replace(model, relations=tuple(relations), mechanisms=tuple(_times(m, unit) for m in model.mechanisms))


def _relation(relation: Relation, order: int, rates: Mapping[str, int], unit: float) -> Relation:
    """Return a relation in a unit of time.

    Args:
        relation: in seconds.
        order: of its target.
        rates: how many times the rate of a coordinate each is, by name.
        unit: seconds in it.
    """

    def power(t: RelationTerm) -> float:
        held = sum(rates.get(atom.name, 0) * power for atom, power in t.term.factors if isinstance(atom, Name))
        return order - (0 if t.factor is None else rates[t.factor]) - float(held)

    return Relation(tuple(_times(t, unit ** power(t)) for t in relation.terms))


def _times(one: T, by: float) -> T:
    error = None if one.std_error is None else one.std_error * by
    if isinstance(one, RelationTerm):
        return replace(one, coefficient=one.coefficient * by, std_error=error)
    return msgspec.structs.replace(one, coefficient=one.coefficient * by, std_error=error)
