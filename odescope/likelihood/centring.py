"""Exponentials about the middle of their argument, so that their constants and coefficients are known independently.

Of k*exp(-E/T) data near a temperature T0 tell k*exp(-E/T0) and E well, and k alone hardly: it is known to as many
powers of e as E/T0 is. A fit then has a narrow curved valley to follow, and a Wald statistic of k says nothing of
whether the term is there. So k*exp(-E*(1/T - m)) is fitted, m the mean of 1/T, and of x**p, which is exp(p*log(x)), the
same. A bell about zero, exp(-v**2/w**2), is as it is: its height is what the data tell.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.constants import Constant, term_at
from odescope.library.derivative import slope
from odescope.library.expression import Atom, Call, Combination, Name, Power, Term
from odescope.library.mechanism import Mechanism
from odescope.library.tape import evaluate, write_tape


@dataclass(frozen=True)
class Centring:
    """The means over a record of what constants multiply within exponentials; nothing is centred by default."""

    constants: frozenset[str] = frozenset()
    means: Mapping[Term, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls, mechanisms: Sequence[Mechanism], constants: Collection[str], names: Sequence[str], values: FloatArray
    ) -> Centring:
        """Return the centring of what mechanisms hold.

        Args:
            mechanisms: the candidates. A coefficient that several parts share is one only if all are centred alike.
            constants: that the library declares, by name.
            names: of the variables.
            values: (variables, N) of these.
        """
        terms = [p.product.term for m in mechanisms for p in m.parts if not p.product.term.names.isdisjoint(constants)]
        through = {n for n, v in zip(names, values, strict=True) if v.min() < 0.0 < v.max()}
        found = {rest for term in terms for _, rest, _ in _exponents(term, constants) if rest.names <= {*names}}
        multiplied = [rest for rest in found if not _is_square(rest, through)]
        rows = evaluate(write_tape(names, multiplied), values) if multiplied else ()
        means = {rest: float(row.mean()) for rest, row in zip(multiplied, rows, strict=True)}
        whole = cls(frozenset(constants), {rest: mean for rest, mean in means.items() if np.isfinite(mean)})
        unlike = [m for m in mechanisms if len({whole.shift(p.product.term) for p in m.parts}) > 1]
        left = frozenset().union(*(m.names for m in unlike))
        return cls(whole.constants - left, whole.means)

    def shift(self, term: Term) -> Combination:
        """Return what is added to the exponents of a term: constants times numbers."""
        parts = _exponents(term, self.constants)
        return Combination.of((-c * self.means[rest], kept) for c, rest, kept in parts if rest in self.means)

    def centred(self, term: Term) -> Term:
        """Return a term about the middle of its exponents."""
        if self.constants.isdisjoint(term.names) or not self.shift(term).parts:
            return term
        factors: list[tuple[Atom, Power]] = []
        for atom, power in term.factors:
            alone = Term(((atom, power),))
            if isinstance(atom, Call) and (own := self.shift(alone)).parts:
                moved = Combination.of((*atom.argument.parts, *((c / power, t) for c, t in own.parts)))
                atom = Call(atom.function, moved)
            factors.append((atom, power))
        return Term.of(factors)

    def sizes(self, mechanisms: Sequence[Mechanism], values: Mapping[str, float]) -> FloatArray:
        """Return by what coefficients of the centred terms are multiplied to be those of the terms (mechanisms,).

        Args:
            mechanisms: that the coefficients are of.
            values: of the constants, by name.
        """
        exponents = (self._at(self._shift_of(m), values) for m in mechanisms)
        return np.exp(np.fromiter(exponents, dtype=np.float64, count=len(mechanisms)))

    def slopes(
        self, mechanisms: Sequence[Mechanism], constants: Mapping[str, Constant], values: Mapping[str, float]
    ) -> FloatArray:
        """Return the derivatives of the logarithms of `sizes` with respect to all coefficients.

        Args:
            mechanisms: (k) that the coefficients are of, the settings of constants among them.
            constants: all, by name.
            values: of these.

        Returns:
            (k, k), a column a coefficient.
        """
        found = np.zeros((len(mechanisms), len(mechanisms)))
        for j, setting in enumerate(mechanisms):
            if setting.kind == "constant" and setting.place in self.constants:
                gain = constants[setting.place].slope(values[setting.place])
                for k, m in enumerate(mechanisms):
                    found[k, j] = gain * self._at(slope(self._shift_of(m), setting.place), values)
        return found

    def _shift_of(self, mechanism: Mechanism) -> Combination:
        return self.shift(mechanism.parts[0].product.term) if mechanism.parts else Combination()

    @staticmethod
    def _at(combination: Combination, values: Mapping[str, float]) -> float:
        return sum(c * term_at(t, values)[0] for c, t in combination.parts)


def _is_square(term: Term, names: Collection[str]) -> bool:
    """Say whether a term is an even power of one of some variables: exp(-v^2/w^2) is told where v is near zero."""
    return len(term.factors) == 1 and all(a.text in names and power % 2 == 0 for a, power in term.factors)


def _exponents(term: Term, constants: Collection[str]) -> list[tuple[float, Term, Term]]:
    """Return what stands in the exponents of a term: number, variables, and the constants that multiply these."""
    found = list[tuple[float, Term, Term]]()
    for atom, power in term.factors:
        for c, t in atom.argument.parts if isinstance(atom, Call) and atom.function == "exp" else ():
            kept = Term(tuple(f for f in t.factors if isinstance(f[0], Name) and f[0].name in constants))
            rest = Term(tuple(f for f in t.factors if f not in kept.factors))
            if kept.factors and rest.factors and rest.names.isdisjoint(constants):
                found.append((float(power) * c, rest, kept))
    return found
