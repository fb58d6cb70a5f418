"""Which functions come nearest to what a relation imitates: least squares on the smoothed states, at all constants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from odescope.arrays import FloatArray
from odescope.library.constants import Constant, grid_of
from odescope.library.expression import Term
from odescope.library.families import Family
from odescope.library.tape import Tape, evaluate, write_tape

SEEN = 2000  # samples on which functions are compared
ROUNDS = 3  # of choosing each function, given the others
DEARER = 2.0  # times less that one coefficient or constant more has to leave
EACH = 8  # points of each of two constants
POLISH = 30  # steps of least squares between the points of several grids
NOTHING_LEFT = 1e-10  # share of a function that others do not say


@dataclass(frozen=True)
class Choice:
    """Terms that may stand for one suspicion, and their constants: a function, or sine and cosine of one rate.

    `points` are values of the constants, by name, to look for them at; those of their grids where there are none.
    """

    terms: tuple[Term, ...] = ()
    constants: tuple[Constant, ...] = ()
    points: tuple[tuple[tuple[str, float], ...], ...] = ()

    @property
    def size(self) -> int:
        """Number of its coefficients and constants."""
        return len(self.terms) + len(self.constants)


@dataclass(frozen=True, eq=False)
class Placed:
    """A choice with values of its constants, by name."""

    choice: Choice
    values: Mapping[str, float] = field(default_factory=dict)


def choices_of(families: Sequence[Family], beside: Sequence[Term]) -> tuple[Choice, ...]:
    """Return what may stand for a suspicion.

    Args:
        families: of its variable.
        beside: what they may be multiplied by.
    """
    found = [Choice((f.term * rest,), f.constants) for rest in beside for f in families]
    waves = dict[tuple[str, ...], list[Choice]]()
    for choice in found:
        if any(text in choice.terms[0].text for text in ("sin(", "cos(")):
            rest = choice.terms[0].names - {c.name for c in choice.constants}
            waves.setdefault((*sorted(rest), *(c.name for c in choice.constants)), []).append(choice)
    pairs = [
        Choice(tuple(c.terms[0] for c in both), both[0].constants) for both in waves.values() if len(both) == len("ab")
    ]
    return (*found, *pairs)


def _left_of(rest: FloatArray, own: FloatArray, here: FloatArray) -> FloatArray | None:
    """Return what columns leave of others' rest (N,), None where they say nothing of their own.

    Args:
        rest: (N,) what others leave.
        own: (terms, N) the columns less what others say of them.
        here: (terms, N) the columns.
    """
    told = np.sum(own**2, axis=1) > NOTHING_LEFT * np.sum(here**2, axis=1)
    if not told.all():
        return None
    missed: FloatArray = rest - np.linalg.lstsq(own.T, rest)[0] @ own
    return missed


@dataclass(frozen=True, eq=False)
class Imitated:
    """What one relation says of its target at some samples, and functions that may say it.

    Shapes: said (N,), base (b, N) what stands beside the functions in any case; values by name of the variable (N,).
    """

    said: FloatArray
    base: FloatArray
    values: Mapping[str, FloatArray]
    columns: dict[Choice, tuple[list[dict[str, float]], FloatArray]] = field(default_factory=dict)
    tapes: dict[Choice, Tape] = field(default_factory=dict)

    def on_grid(self, choice: Choice) -> tuple[list[dict[str, float]], FloatArray]:
        """Return the constants of a choice at every point of their grids, and its terms there (points, terms, N)."""
        if choice not in self.columns:
            points = [dict(point) for point in choice.points] or grid_of(choice.constants, each=EACH) or [{}]
            self.columns[choice] = points, np.array([self.at(Placed(choice, point)) for point in points])
        return self.columns[choice]

    def at(self, placed: Placed) -> FloatArray:
        """Return the terms of a choice at these constants (terms, N)."""
        if placed.choice not in self.tapes:
            names = [*self.values, *(c.name for c in placed.choice.constants)]
            self.tapes[placed.choice] = write_tape(names, placed.choice.terms)
        constants = (placed.values[c.name] for c in placed.choice.constants)
        rows = [*self.values.values(), *(np.full_like(self.said, v) for v in constants)]
        with np.errstate(all="ignore"):
            columns: FloatArray = evaluate(self.tapes[placed.choice], np.array(rows))
        return np.nan_to_num(columns, posinf=0.0, neginf=0.0)

    def nearest(self, choice: Choice, others: Sequence[Placed]) -> tuple[float, Placed]:
        """Return the least sum of squares that a choice leaves beside others, and its constants there.

        Args:
            choice: one of those that may stand there.
            others: what stands beside it.
        """
        if not choice.terms:
            return self.missed(others), Placed(choice)
        points, columns = self.on_grid(choice)
        known = np.vstack([self.base, *(self.at(o) for o in others)]).T
        left, _, _ = np.linalg.svd(known / np.maximum(np.linalg.norm(known, axis=0), 1e-300), full_matrices=False)
        rest = self.said - left @ (left.T @ self.said)
        best = float(rest @ rest), Placed(choice, points[0])
        for point, here in zip(points, columns, strict=True):
            missed = _left_of(rest, here - (here @ left) @ left.T, here)
            if missed is not None and (found := float(missed @ missed)) < best[0]:
                best = found, Placed(choice, point)
        if len(choice.constants) > 1 and best[0] < float(rest @ rest):
            return min(best, self.polished(best[1], rest, left), key=lambda found: found[0])
        return best

    def polished(self, placed: Placed, rest: FloatArray, left: FloatArray) -> tuple[float, Placed]:
        """Return the sum of squares that a choice leaves at constants between those of its grids, and these.

        Where a choice has several, their grids are too coarse to compare it with others.

        Args:
            placed: where to begin.
            rest: (N,) what the columns beside it leave.
            left: (N, b) those, orthonormal.
        """
        constants, size = placed.choice.constants, max(float(np.linalg.norm(rest)), 1e-300)

        def there(coefficients: FloatArray) -> Placed:
            values = {c.name: c.at(float(p)) for c, p in zip(constants, coefficients, strict=True)}
            return Placed(placed.choice, values)

        def missed(coefficients: FloatArray) -> FloatArray:
            here = self.at(there(coefficients))
            found = _left_of(rest, here - (here @ left) @ left.T, here)
            return (rest if found is None else found) / size

        low, high = np.array([c.limits for c in constants]).T
        begin = np.clip([c.coefficient(placed.values[c.name]) for c in constants], low, high)
        found = least_squares(missed, begin, bounds=(low, high), x_scale=high - low, max_nfev=POLISH)
        return 2.0 * float(found.cost) * size**2, there(found.x)

    def missed(self, placed: Sequence[Placed]) -> float:
        """Return the sum of squares that the base and functions leave."""
        columns = np.vstack([self.base, *(self.at(p) for p in placed)])
        rest = self.said - self.coefficients(placed) @ columns if len(columns) else self.said
        return float(rest @ rest)

    def ranked(self, choices: Sequence[Choice], others: Sequence[Placed]) -> list[tuple[float, Placed]]:
        """Return every choice at its best constants, the nearest first.

        Args:
            choices: that may stand there.
            others: what stands beside.
        """
        return sorted((self.nearest(c, others) for c in choices), key=lambda found: found[0])

    def together(self, choices: Sequence[Sequence[Choice]]) -> list[Placed]:
        """Return one choice of each, so that all together come near, and none is more elaborate than that asks for."""
        chosen = list[Placed]()
        for round_ in range(ROUNDS if len(choices) > 1 else 1):
            for k, among in enumerate(choices):
                others = [*chosen[:k], *chosen[k + 1 :]]
                best = min(self.ranked(among, others), key=lambda found: found[0] * DEARER ** found[1].choice.size)[1]
                chosen = [*chosen, best] if round_ == 0 else [*chosen[:k], best, *chosen[k + 1 :]]
        return chosen

    def coefficients(self, placed: Sequence[Placed]) -> FloatArray:
        """Return those of the base, then of all terms of the choices."""
        columns = np.vstack([self.base, *(self.at(p) for p in placed)])
        scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
        found: FloatArray = np.linalg.lstsq((columns / scale[:, None]).T, self.said)[0] / scale
        return found
