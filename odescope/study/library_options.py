"""The [library] table of a study: what may stand in the equations, and in which form."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec
import numpy as np

from odescope.errors import InputError
from odescope.library.rules import AnyRule
from odescope.study.kinds import check_fields

Span = tuple[float, float] | Literal["scale"]
Form = Literal["relations", "lagrangian", "reactions"]

MOST_DEGREE = 12

_DEGREE = 3
_MOLECULES = 2
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

    Attributes:
        preset: the library where none is named: that of odescope, or the 330 products of the paper.
        basis: functions of states and inputs whose products are the candidates, as "sin(phi)".
        degree: how many functions of the basis a product holds at most, powers counted; other
            than 3, also products of the default library, targets aside.
        terms: the candidates themselves, in place of a basis.
        extra: candidates of relations beside those of the preset or the basis, which nothing multiplies.
        rules: what products of the basis must obey to stay; left out, those that the kinds of coordinates ask for.
        functions: functions of one's own, as `"drag(v)" = "v*abs(v)"`.
        coupled: whether every relation may hold every target, or its own alone. "auto" couples the default library of
            several angles of order 2: a chain of pendulums has short relations between its accelerations, and long
            explicit ones.
        sums: whether the default library has sines and cosines of sums and differences of angles in the place of
            products of those of different angles. "auto" has products, and tries sums where all angles are of order 1
            (phases, headings) and a relation would be shorter with them.
        form: what the candidates are terms of: of "relations" between states, targets and inputs; of the energies,
            dissipation and forces of Lagrange's equations ("lagrangian"); or "reactions" with one rate each. "auto"
            lets Lagrange's equations compete with relations where there are several coordinates, all of order 2.
        kinetic: the terms of the kinetic energy; left out, products of two rates times harmonics and powers of
            positions.
        potential: the terms of the potential energy; left out, harmonics and powers of positions.
        dissipation: the terms of Rayleigh's function; left out, dry, viscous and quadratic friction.
        forces: on each coordinate the terms of the force; left out, every input on every coordinate.
        composition: what each species is made of, as `{ C = "s e" }`: reactions that balance are the candidates.
        reactions: the reactions themselves, as "S + E <-> C".
        molecules: how many molecules either side of a reaction from a `composition` has at most.
        ties: linear equalities between coefficients, and values that are known, as "x_dot**2 in kinetic = 0.9".
        saturating: species in which fluxes may saturate, as S/(K + S).
        parameters: constants within functions, as v0 in "tanh(x_dot/v0)", each with the range that it is looked for in,
            or "scale" for a range from the data.
        suspect: whether functions that are not in the library (roots, logarithms, exponentials, tanh, sines, ...)
            compete where several powers or fractions of a variable seem to imitate one, or a residual goes with a
            variable or is periodic in time or along a position: in relations, unless these are the paper's, or `terms`
            names their candidates one by one.
    """

    preset: Literal["default", "paper"] = "default"
    basis: tuple[str, ...] | None = None
    degree: Annotated[int, msgspec.Meta(ge=1, le=MOST_DEGREE)] = _DEGREE
    terms: tuple[str, ...] | None = None
    extra: tuple[str, ...] = ()
    rules: tuple[AnyRule, ...] | None = None
    functions: dict[str, str] = {}
    coupled: bool | Literal["auto"] = "auto"
    sums: bool | Literal["auto"] = "auto"
    form: Literal["auto"] | Form = "auto"
    kinetic: tuple[str, ...] | None = None
    potential: tuple[str, ...] | None = None
    dissipation: tuple[str, ...] | None = None
    forces: dict[str, tuple[str, ...]] | None = None
    composition: dict[str, str] | None = None
    reactions: tuple[str, ...] | None = None
    molecules: Annotated[int, msgspec.Meta(ge=1, le=4)] = _MOLECULES
    ties: tuple[str, ...] = ()
    saturating: tuple[str, ...] = ()
    parameters: dict[str, Span] = {}
    suspect: bool = True

    def __post_init__(self) -> None:
        if self.form not in ("auto", *get_args(Form)):
            raise InputError(f'form must be "auto", {", ".join(map(repr, get_args(Form)))}; {self.form!r} came')
        check_fields(self)
        for name, form in _BELONG.items():
            if getattr(self, name) is not None and self.form not in ("auto", form):
                raise InputError(f'[library] {name} belongs to form = "{form}", but form is "{self.form}"')
        if self.own_form == "reactions" and self.reactions is None and self.composition is None:
            raise InputError(
                'form = "reactions" needs [library] reactions, such as ["S + E -> C"], or a composition of the species'
            )
        if self.extra and self.own_form not in (None, "relations"):
            raise InputError(f'[library] extra belongs to form = "relations", but the form is "{self.own_form}"')
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
        for name, given in (("rules", self.rules), ("degree", self.own_degree)):
            if given is not None and fixed and self.basis is None:
                raise InputError(f"[library] {name} would do nothing to {fixed}; leave it out, or name a basis")
        if self.sums != "auto" and not self.by_default:
            raise InputError("[library] sums is for the default library; name sin(a - b) in yours, or leave sums out")
        self._check_effects()

    def _check_effects(self) -> None:
        """Refuse what would change nothing."""
        form = self.own_form
        if self.molecules != _MOLECULES and (form != "reactions" or self.composition is None):
            raise InputError(
                f"[library] molecules = {self.molecules} is for the reactions that a composition allows, and there is"
                ' none: write composition = { S = "s", E = "e", C = "s e" }, or leave molecules out'
            )
        if self.saturating and form != "reactions":
            raise InputError(
                '[library] saturating is for fluxes of reactions, form = "reactions"; in relations name them in the'
                ' basis, such as "S/(K + S)" with K in [library.parameters]'
            )

    @property
    def by_default(self) -> bool:
        """Whether the candidates are those of the default library, with or without some more."""
        return self.basis is None and self.terms is None and self.preset == "default"

    @property
    def by_hand(self) -> bool:
        """Whether a user chose candidates: what was left out is not to be put in again."""
        return not self.by_default or self.own_degree is not None or bool(self.extra)

    @property
    def own_degree(self) -> int | None:
        """The degree that was asked for, None for the usual one."""
        return None if self.degree == _DEGREE else self.degree

    @property
    def own_form(self) -> Form | None:
        """The form that the library asks for by name or by what it gives; None where it leaves that open."""
        if self.form != "auto":
            return self.form
        asked = {form for name, form in _BELONG.items() if getattr(self, name) is not None}
        if len(asked) > 1:
            raise InputError("[library] names energies and reactions: they belong to different forms, give one")
        return next(iter(asked), None)
