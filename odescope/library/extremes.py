"""The larger and the smaller of two: half their sum, and half the size of their difference, added or taken away."""

from __future__ import annotations

from dataclasses import dataclass

from odescope.library.expression import Call, Combination, Term

EXTREMES = {"max": 0.5, "min": -0.5}  # of the size of the difference, beside half the sum


@dataclass(frozen=True)
class Extreme:
    """The larger ("max") or the smaller ("min") of two combinations, a number or what comes later second."""

    name: str
    first: Combination
    second: Combination

    @staticmethod
    def of(name: str, first: Combination, second: Combination) -> Extreme:
        """Return the larger or the smaller of two, in whatever order they come.

        Args:
            name: "max" or "min".
            first: of the two.
            second: the other.
        """
        one, other = sorted((first, second), key=lambda c: (not c.names, c.text))
        return Extreme(name, one, other)

    @staticmethod
    def read(total: Combination) -> Extreme | None:
        """Return what a sum is the written-out form of; None where it is of none that is any shorter."""
        sizes = [
            (c, t, atom.argument)
            for c, t in total.parts
            for atom, power in t.factors
            if isinstance(atom, Call) and atom.function == "abs" and power == 1 and len(t.factors) == 1
        ]
        names = [name for name, half in EXTREMES.items() if len(sizes) == 1 and sizes[0][0] == half]
        if not names:
            return None
        ((_, size, difference),) = sizes
        rest, halves = [(c, t) for c, t in total.parts if t != size], [(0.5 * c, t) for c, t in difference.parts]
        first, second = (Combination.of([*rest, *((sign * c, t) for c, t in halves)]) for sign in (1.0, -1.0))
        found = Extreme.of(names[0], first, second)
        return found if len(found.first.parts) + len(found.second.parts) <= len(rest) else None

    @property
    def difference(self) -> Combination:
        """The first less the second."""
        return Combination.of([*self.first.parts, *((-c, t) for c, t in self.second.parts)])

    @property
    def total(self) -> Combination:
        """What it is written out as."""
        size = Term(((Call("abs", self.difference), 1),))
        halves = ((0.5 * c, t) for c, t in (*self.first.parts, *self.second.parts))
        return Combination.of([*halves, (EXTREMES[self.name], size)])
