"""Model: as many relations, linear in the targets, as there are targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import ArrayLike

import odescope
from odescope.errors import InputError
from odescope.library.constants import term_at
from odescope.library.expression import Term
from odescope.library.parse import Scope, parse_term
from odescope.library.readable import displayed, readable
from odescope.library.tape import Tape, write_tape
from odescope.model.coefficients import CoefficientRow, mechanism_rows, other_rows, rows_with_errors, term_rows
from odescope.model.display import equations_html, equations_latex
from odescope.model.equations import Equation, Named, relation_with_names, shown_equations, with_names
from odescope.model.explicit import Quotient, explicit
from odescope.model.given import GivenInputs, GivenState
from odescope.model.mechanism_display import read_term
from odescope.model.notes import trust
from odescope.model.relation import FoundMechanism, FoundParameter, Relation, in_order
from odescope.model.scores import ModelScores
from odescope.model.screen import screen
from odescope.model.switches import Switched, switched
from odescope.model.worth import uncertain
from odescope.recordings.coordinate import Coordinate, Input, state_names
from odescope.recordings.record import Recorded

SHOWN_DIGITS = 6  # of coefficients at a prompt

Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]


@dataclass(frozen=True)
class Model:
    """A(x, u) y' = b(x, u), with y' the targets.

    `domain` is the range of each state and input in the data the model comes from, `scores` how well it did, where that
    is known; `provenance` is plain data for people and reports. `mechanisms` are the terms of energies, forces or
    reactions that the relations add up from, where the model was found as such; `parameters` are the constants within
    functions that were found. The relations are in the order of the targets.
    """

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    relations: tuple[Relation, ...]
    scores: ModelScores | None = None
    domain: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    provenance: Mapping[str, Json] = field(default_factory=dict)
    mechanisms: tuple[FoundMechanism, ...] = ()
    parameters: tuple[FoundParameter, ...] = ()

    def __post_init__(self) -> None:
        if len(self.relations) != len(self.targets):
            raise InputError(
                f"a model of {len(self.targets)} targets needs as many relations; {len(self.relations)} came"
            )
        known = set(self.states) | {i.name for i in self.inputs}
        for relation in self.relations:
            for t in relation.terms:
                if t.factor is not None and t.factor not in self.targets:
                    raise InputError(f"the factor {t.factor!r} is no target; the targets are {', '.join(self.targets)}")
                unknown = t.term.names - known
                if unknown:
                    raise InputError(f"the term {t.term} names {min(unknown)!r}, which is neither state nor input")
            if all(t.factor is None for t in relation.terms):
                raise InputError("a relation of the model holds no target")
        object.__setattr__(self, "relations", in_order(self.relations, self.targets))

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Every coordinate, then the first derivatives, and so on."""
        return state_names(self.coordinates)

    @cached_property
    def targets(self) -> tuple[str, ...]:
        """The highest derivative of each coordinate."""
        return tuple(c.target for c in self.coordinates)

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """States, then inputs: the rows that the tape reads."""
        return (*self.states, *(i.name for i in self.inputs))

    @cached_property
    def held(self) -> frozenset[str]:
        """The states and inputs that the equations hold."""
        return frozenset[str]().union(*(t.product.term.names for r in self.relations for t in r.terms))

    @cached_property
    def tape(self) -> Tape:
        """Tape of A, row by row, then b: (T * T + T) outputs."""
        matrix = [r.part(target) for r in self.relations for target in self.targets]
        right = [r.right for r in self.relations]
        return write_tape(self.variables, [*matrix, *right])

    @cached_property
    def switched(self) -> Switched:
        """The same with the signs of states as inputs, as a simulation takes it."""
        return switched(self.relations, self.targets, self.states, tuple(i.name for i in self.inputs))

    @cached_property
    def quotients(self) -> tuple[Quotient, ...]:
        """The explicit form, one quotient a target, however long.

        An InputError where the relations do not determine the targets, or couple more than five of them.
        """
        return explicit(self.relations, self.targets)

    @cached_property
    def equations(self) -> tuple[Equation, ...]:
        """The equations as people are shown them, one a target: quotients where these are short, else relations."""
        shown = shown_equations(self.relations, self.coordinates, self.inputs, self.mechanisms)
        named = (with_names(equation, self._written) for equation in shown)
        return tuple(e.divided.apart if isinstance(e, Quotient) else e for e in named)

    @cached_property
    def shown_relations(self) -> tuple[Relation, ...]:
        """The relations with the names of constants."""
        return tuple(relation_with_names(r, self._written) for r in self.relations)

    @cached_property
    def shown_mechanisms(self) -> tuple[FoundMechanism, ...]:
        """The mechanisms as people are shown them, with the names of constants, and quotients with a bar."""
        whole = {term.text: named for term, (share, named) in self._written.items() if share == 1.0}
        written = {text: readable(named) for text, named in whole.items()}
        terms = (read_term(m.term, Scope.of(self.variables)) for m in self.mechanisms)
        typed = {t.text: displayed(t) for t in terms if t is not None}
        typed |= {text: displayed(named) for text, named in whole.items()}
        return tuple(
            msgspec.structs.replace(m, term=written.get(m.term, m.term), name=typed.get(m.name, m.name))
            for m in self.mechanisms
        )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What equations and mechanisms may name as they are shown: states, inputs and constants."""
        return (*self.variables, *(p.name for p in self.parameters))

    @property
    def named_terms(self) -> tuple[Term, ...]:
        """The terms that name constants as they are shown."""
        return tuple(named for _, named in self._written.values())

    @cached_property
    def _written(self) -> Named:
        """Terms with the names of constants, by those with numbers that stand in the relations; see `Named`."""
        plain = Scope.of(self.variables)
        named = Scope.of(self.variables, constants=[p.name for p in self.parameters])
        values: dict[str, float | None] = {p.name: p.value for p in self.parameters}
        found = dict[Term, tuple[float, Term]]()
        for p in self.parameters:
            for text, written in zip(p.terms, p.written, strict=False):
                term = parse_term(written, named)
                share, _ = term_at(term, values)
                if np.isfinite(share) and share:
                    found[parse_term(text, plain)] = share, term
        return found

    @cached_property
    def coefficients(self) -> tuple[CoefficientRow, ...]:
        """Every number of the model with its standard error, for a dataframe: see `CoefficientRow`."""
        mechanisms, terms = mechanism_rows(self.shown_mechanisms), term_rows(self.shown_relations, self.targets)
        rest = other_rows([p for p in self.parameters if p.written], self.coordinates, self.inputs, self.scores)
        named = {term.text: displayed(term) for term in self.named_terms}
        found = (*mechanisms, *terms, *rest)
        return tuple(replace(row, term=named.get(row.term, row.term)) for row in found)

    # Verbs stand above the model: a method is the function of the package that has its name.

    def simulate(
        self, t: ArrayLike, inputs: GivenInputs, initial: GivenState, rtol: float = 1e-8, atol: float | None = None
    ) -> odescope.Trajectory:
        """Return the free run of the model under sampled inputs, see `odescope.simulate`.

        Args:
            t: (N,) ascending sample times in seconds.
            inputs: as they were recorded, by name or (N, inputs); None where there are none.
            initial: states at t[0], by name or (n,).
            rtol: relative tolerance of a step.
            atol: absolute tolerance of a step; by default by the sizes of states.
        """
        return odescope.simulate(self, t, inputs, initial, rtol, atol)

    def validate(self, data: Recorded, noise: Mapping[str, float] | None = None) -> odescope.Validation:
        """Return how well the model predicts recordings that it has not seen, see `odescope.validate`."""
        return odescope.validate(self, data, noise)

    def save(self, path: Path | str) -> None:
        """Write the model to a file, which `odescope.read_model` reads back, see `odescope.write_model`."""
        odescope.write_model(self, path)

    def __repr__(self) -> str:
        said = (uncertain(self.scores), *trust(self.scores))
        equations = odescope.to_text(self, SHOWN_DIGITS).splitlines()
        return screen(equations, [s for s in said if s], "odescope.to_text(model), model.coefficients")

    def _repr_html_(self) -> str:
        """Return what a notebook shows: mechanisms, equations, coefficients, and how far to trust them."""
        return equations_html(
            self.equations,
            trust(self.scores),
            self.shown_mechanisms,
            self.names,
            self.parameters,
            rows_with_errors(self.coefficients),
        )

    def _repr_latex_(self) -> str:
        """Return mechanisms and equations as LaTeX for a notebook."""
        return equations_latex(self.equations, self.shown_mechanisms, self.names, self.parameters)


def without_delays(model: Model) -> Model:
    """Return a model for inputs as they act, from which what they were late by has been taken."""
    return replace(model, inputs=tuple(msgspec.structs.replace(i, delay=0.0) for i in model.inputs))
