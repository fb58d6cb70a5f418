"""Friction of a speed relative to an input: a belt that carries, wind that drives; and what a propeller does.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from itertools import product

from odescope.arrays import FloatArray
from odescope.events import Progress
from odescope.library.expression import Call
from odescope.library.friction import speeds
from odescope.likelihood.beginnings import EVIDENT
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.suspicion import suspicions
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed, relations_form
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.stages import refine_form
from odescope.pipeline.temperatures import AT_FIRST
from odescope.pipeline.units import units_of
from odescope.pipeline.wider import (
    basis_of,
    evidently_better,
    follows_surely,
    regressed_with,
    with_basis,
    with_extra,
    within,
)
from odescope.pipeline.work import Work
from odescope.study.options import Study

DEGREE = 2  # of the products beside such friction: more imitates it
ALIKE = 0.1  # size of the smaller over that of the larger: of less the difference is the larger one


@dataclass(frozen=True)
class RelativeSpeeds:
    """Searches with friction relative to an input; each is made once, though it may be asked for twice.

    Attributes:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        found: what searches with such candidates ended with, by these.
    """

    work: Work
    filtered: Filtered
    found: dict[tuple[str, ...], tuple[Posed, Refinement | None]] = field(default_factory=dict)

    def first(self, regressed: Regressed) -> tuple[Posed, Refinement] | None:
        """Return relations with friction relative to an input, and their model; None where this promises nothing.

        What lies on a belt rubs by its speed relative to the belt, a balloon drifts by that of the wind, and the
        difference of an input and a speed is in no function of one of the two. Behind a propeller that turns both ways
        go products of its speed and the ship's with the size of one of them: two functions of one input. The model is
        kept where it follows the record surely and imitates nothing: such friction may itself be part of an imitation.
        Nothing is tried where no input may be a speed, or a library was written by hand.

        Args:
            regressed: what regression in the default library found.
        """
        study = self.work.study
        for wide, found in self._promising(_multiplied(study, regressed)):
            if not found.explicit < regressed.explicit - EVIDENT:
                continue
            posed, refinement = self._refined(wide, found)
            if refinement is None or not (follows_surely(refinement) and _holds_an_input(study, refinement)):
                continue
            if not any(s.terms for s in suspicions(refinement, study.suspects, study.parameters)):
                return posed, replace(refinement, finished=True)
        return None

    def where_wanting(self, posed: Posed, refinement: Refinement | None) -> tuple[Posed, Refinement | None]:
        """Return relations and their model: with friction relative to an input, where that is evidently better.

        Differences of smoothed states may be too blunt for friction that is steep: where a model is wanting the
        likelihood is asked.

        Args:
            posed: the relations.
            refinement: the model so far, if there is one.
        """
        study = self.work.study
        if refinement is not None and not refinement.wanting:
            return posed, refinement
        for wide, found in self._promising(study.inputs):
            wider, other = self._refined(wide, found)
            if other is not None and _holds_an_input(study, other) and evidently_better(other, refinement):
                return wider, other
        return posed, refinement

    def _promising(self, sources: Collection[str]) -> Iterator[tuple[Work, Regressed]]:
        """Yield the work with the most promising candidates of each kind, and what regression finds with them.

        The friction is too steep for products to be told from it by differences: a forward selection ranks it.
        Differences come first, for products with sizes imitate such friction.
        """
        study = self.work.study
        if study.library.by_hand or not study.suspects or not self.filtered.sample.complete:
            return
        plain = with_basis(self.work, basis_of(study), DEGREE)
        for kind in (_of_differences, _of_sizes):
            wider = (with_extra(plain, extra) for extra in kind(self.filtered, sources))
            tried = [(w, r) for w in wider if (r := regressed_with(w, self.filtered)) is not None]
            if tried:
                yield min(tried, key=lambda one: one[1].explicit)

    def _refined(self, wide: Work, regressed: Regressed) -> tuple[Posed, Refinement | None]:
        """Return the relations of a wider study, and the model that a search in them ends with."""
        extra = tuple(wide.study.library.extra)
        if extra not in self.found:
            wide.monitor.tell(Progress("suspicion", "search with friction relative to an input", 0, 1))
            wide = within(wide, AT_FIRST)
            posed = relations_form(wide.study, (regressed,), lambda _: regressed)
            self.found[extra] = posed, refine_form(wide, self.filtered, posed)
        return self.found[extra]


def _multiplied(study: Study, regressed: Regressed) -> list[str]:
    """Return the inputs that the best relations hold in products, which may imitate friction; all, if there is none."""
    products = (t.term for r in regressed.relations for t in r.terms if t.text not in study.inputs)
    held = frozenset[str]().union(*(term.names for term in products))
    return [name for name in study.inputs if name in held or not regressed.relations]


def _holds_an_input(study: Study, refinement: Refinement) -> bool:
    """Say whether a function of a model holds an input, by itself or with something else."""
    atoms = (a for r in refinement.relations for t in r.terms for a, _ in t.product.term.factors)
    return any(isinstance(a, Call) and not a.argument.names.isdisjoint(study.inputs) for a in atoms)


def _of_differences(filtered: Filtered, sources: Collection[str]) -> Iterator[tuple[str, ...]]:
    """Yield friction of the difference of an input and a speed, and its size, of one pair after the other.

    Args:
        filtered: the records and their signals.
        sources: the inputs.
    """
    units, values = units_of(filtered), _values(filtered)
    for source, (speed, own) in product(sources, _moving(filtered)):
        alike = len({units.get(n) for n in (source, speed)} - {None}) < 2
        small, large = sorted(float(abs(values[n]).max()) for n in (source, speed))
        if alike and small > ALIKE * large:
            between, difference = f"{source} - {speed}", values[source] - values[speed]
            both_ways = float(difference.min()) < 0.0 < float(difference.max())
            bent = (f"abs({between})",) if both_ways else ()  # else the difference itself
            yield f"sign({between})", f"({between})**1*abs({between})", *bent, *own


def _of_sizes(filtered: Filtered, sources: Collection[str]) -> Iterator[tuple[str, ...]]:
    """Yield products of a speed and an input that has both signs, with the size of one: with one sign it is a square.

    Args:
        filtered: the records and their signals.
        sources: the inputs.
    """
    values = _values(filtered)
    for source, (speed, own) in product(sources, _moving(filtered)):
        if min(-values[source].min(), values[source].max()) > ALIKE * float(abs(values[source]).max()):
            yield f"{source}*abs({source})", f"{speed}*abs({source})", f"{source}*abs({speed})", *own


def _moving(filtered: Filtered) -> list[tuple[str, tuple[str, ...]]]:
    """Return what may be a speed, and its own quadratic friction, which the library has of rates."""
    coordinates = filtered.signals.coordinates
    rates = [(c.derivative(1), ()) for c in coordinates if c.order == 2]
    return [*rates, *((name, (f"{name}*abs({name})",)) for name in speeds(coordinates))]


def _values(filtered: Filtered) -> dict[str, FloatArray]:
    """Return states, targets and inputs by name, (N,)."""
    signals = filtered.signals
    return dict(zip(signals.names, signals.joined(), strict=True))
