"""Which functions come nearest to what a relation imitates: least squares on the smoothed states, at all constants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.constants import Constant, grid_of
from odescope.library.expression import ONE, Name, Term
from odescope.library.families import FILLED, HALF, LARGEST_AT, ORDER, Family
from odescope.library.tape import Tape, evaluate, write_tape
from odescope.likelihood.least_within import LARGEST, Curves, least_within
from odescope.likelihood.unexplained import unexplained

SEEN = 2000  # samples on which functions are compared
ROUNDS = 3  # of choosing each function, given the others
MOST_DIVIDED = 3  # terms that one function multiplies
DEARER = 2.0  # times less that one coefficient or constant more has to leave
EACH = 8  # points of each of two constants
NEAR = 8  # functions that come nearest on the grid of their constant, which is fitted to rank them
POLISH = 30  # steps of least squares between the points of several grids


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

    @property
    def common(self) -> bool:
        """Whether one function multiplies several terms."""
        names = {c.name for c in self.constants}
        held = [{f for f in t.factors if names & Term((f,)).names} for t in self.terms]
        return len(held) > 1 and bool(held[0]) and all(factors == held[0] for factors in held)

    @property
    def saturates(self) -> bool:
        """Whether it is a saturation, such as x/(half_x + x), with or without something beside."""
        return any(c.name.startswith(f"{HALF}_") for c in self.constants)


@dataclass(frozen=True, eq=False)
class Placed:
    """A choice with values of its constants, by name."""

    choice: Choice
    values: Mapping[str, float] = field(default_factory=dict)


def choices_of(
    families: Sequence[Family], beside: Sequence[Term], falling: Sequence[Term] = (), divided: Sequence[Term] = ()
) -> tuple[Choice, ...]:
    """Return what may stand for a suspicion.

    A function with two constants is not multiplied by its own variable: with it the curve would be any. Nor is what
    its constant is before, K/(K + x): x/(K + x) is the same curve then; nor x/(c**2 + x**2) of an amount: that is
    Hill's rate of order 2, and the record says which order. An exponential that rises and one that falls stand together
    where each has a scale of its own, as in Butler and Volmer's law of an electrode. What fills up, 1 - exp(-x/c), is
    multiplied by something else: beside a constant it is the exponential that falls. A function of one constant may
    multiply all that a fraction of its variable divides, as warmth speeds up growth and what limits it.

    Args:
        families: of its variable.
        beside: what they may be multiplied by.
        falling: what an exponential that falls may be multiplied by, too.
        divided: what a fraction divides, a function of whose variable may multiply all of it.
    """
    alone = {f for f in families if any(f.term.power_of(Name(c.name)) for c in f.constants)}
    if any(c.name.startswith(f"{ORDER}_") for f in families for c in f.constants):
        alone |= {f for f in families if any(c.name.startswith(f"{LARGEST_AT}_") for c in f.constants)}
    single = [f for f in families if len(f.constants) < 2 and f not in alone]
    filling = {f for f in families if any(c.name.startswith(f"{FILLED}_") for c in f.constants)}
    able = ((f, rest) for rest in beside for f in families if rest != ONE or f not in filling)
    made = ((f, rest) for f, rest in able if f.variable not in rest.names or (f in single and f not in filling))
    more = ((f, rest) for rest in falling if rest not in beside for f in families if f.falls)
    found = [Choice((f.term * rest,), f.constants) for f, rest in (*made, *more)]
    waves = dict[tuple[str, ...], list[Choice]]()
    for choice in found:
        if any(text in choice.terms[0].text for text in ("sin(", "cos(")):
            rest = choice.terms[0].names - {c.name for c in choice.constants}
            waves.setdefault((*sorted(rest), *(c.name for c in choice.constants)), []).append(choice)
    pairs = [
        Choice(tuple(c.terms[0] for c in both), both[0].constants) for both in waves.values() if len(both) == len("ab")
    ]
    ways = [
        Choice((up.term * rest, down.term * rest), (*up.constants, *down.constants))
        for rest, up, down in product(beside, families, families)
        if up.rises and down.falls and down.constants != up.constants
    ]
    rests = [rest for rest in divided if rest != ONE]
    common = (f for f in single if f.constants and not any(f.variable in rest.names for rest in rests))
    few = common if 1 < len(rests) <= MOST_DIVIDED else ()
    return (*found, *pairs, *ways, *(Choice(tuple(f.term * rest for rest in rests), f.constants) for f in few))


@dataclass(frozen=True, eq=False)
class Samples:
    """Variables at some samples, by name (N,), and functions of them, each evaluated on its grid once."""

    values: Mapping[str, FloatArray]
    grids: dict[Choice, tuple[list[dict[str, float]], FloatArray]] = field(default_factory=dict)
    tapes: dict[tuple[Choice, ...], Tape] = field(default_factory=dict)
    fewer: dict[int, Samples] = field(default_factory=dict)

    def thinned(self, every: int) -> Samples:
        """Return one sample of so many."""
        if every == 1:
            return self
        if every not in self.fewer:
            self.fewer[every] = Samples({name: column[::every] for name, column in self.values.items()})
        return self.fewer[every]

    @cached_property
    def columns(self) -> FloatArray:
        """The variables (v, N)."""
        return np.array(list(self.values.values()))

    def tape(self, choices: Sequence[Choice]) -> Tape:
        """Return the tape of the terms of several choices, of the variables and the constants of these."""
        together = tuple(choices)
        if together not in self.tapes:
            names = [*self.values, *(c.name for choice in together for c in choice.constants)]
            self.tapes[together] = write_tape(names, [t for choice in together for t in choice.terms])
        return self.tapes[together]

    def curves(self, choices: Sequence[Choice]) -> Curves:
        """Return the terms of several choices as compiled kernels take them."""
        tape, constants = self.tape(choices), [c for choice in choices for c in choice.constants]
        numbers = [(c.nominal, 0.0 if c.relative else c.reach, c.low, c.high) for c in constants]
        nominal, reach, low, high = np.array(numbers).reshape(-1, 4).T.copy()
        return Curves(self.columns, tape.instructions, tape.outputs, nominal, reach, low, high)

    def on_grid(self, choice: Choice) -> tuple[list[dict[str, float]], FloatArray]:
        """Return the constants of a choice at every point of their grids, and its terms there (points, terms, N)."""
        if choice not in self.grids:
            points = [dict(point) for point in choice.points] or grid_of(choice.constants, each=EACH) or [{}]
            self.grids[choice] = points, self.at_all(choice, points)
        return self.grids[choice]

    def at(self, placed: Placed) -> FloatArray:
        """Return the terms of a choice at these constants (terms, N)."""
        there: FloatArray = self.at_all(placed.choice, [placed.values])[0]
        return there

    def at_all(self, choice: Choice, points: Sequence[Mapping[str, float]]) -> FloatArray:
        """Return the terms of a choice at each of several values of its constants (points, terms, N)."""
        tape, samples = self.tape((choice,)), self.columns.shape[1]
        many, names = len(points), len(self.columns)
        rows = np.empty((tape.inputs, many, samples))
        rows[:names] = self.columns[:, None]
        for row, c in zip(rows[names:], choice.constants, strict=True):
            row[:] = np.array([point[c.name] for point in points])[:, None]
        with np.errstate(all="ignore"):
            columns = evaluate(tape, rows.reshape(len(rows), many * samples))
        columns[~(np.abs(columns) < LARGEST)] = 0.0
        # In rows, as where functions stand together: another layout would compile the kernel once more.
        return np.ascontiguousarray(columns.reshape(len(columns), many, samples).swapaxes(0, 1))


@dataclass(frozen=True, eq=False)
class Imitated:
    """What one relation says of its target at some samples, and functions that may say it.

    Shapes: said (N,), base (b, N) what stands beside the functions in any case.
    """

    said: FloatArray
    base: FloatArray
    samples: Samples

    def nearest(self, choice: Choice, others: Sequence[Placed]) -> tuple[float, Placed]:
        """Return the least sum of squares that a choice leaves beside others, and its constants there.

        Args:
            choice: one of those that may stand there.
            others: what stands beside it.
        """
        return self.ranked([choice], others)[0]

    def _nearest(self, choice: Choice, around: tuple[FloatArray, FloatArray]) -> tuple[float, Placed]:
        """Return the least sum of squares that a choice leaves, and its constants there.

        Where a choice has several, their grids are too coarse to compare it with others: they are fitted.

        Args:
            choice: one of those that may stand there.
            around: what stands beside it, as `beside` returns it.
        """
        there, rest = around
        whole = float(rest @ rest)
        if not choice.terms:
            return whole, Placed(choice)
        points, columns = self.samples.on_grid(choice)
        squares = np.sum(unexplained(rest, there, columns) ** 2, axis=1)
        k = int(np.argmin(squares))
        if not squares[k] < whole:
            return whole, Placed(choice, points[0])
        best = float(squares[k]), Placed(choice, points[k])
        return self._polished(best, around) if len(choice.constants) > 1 else best

    def _polished(self, found: tuple[float, Placed], around: tuple[FloatArray, FloatArray]) -> tuple[float, Placed]:
        """Return a function with its constants fitted from those of a grid, and the sum of squares that it leaves.

        Args:
            found: the sum of squares, and the function.
            around: what stands beside it, as `beside` returns it.
        """
        squares, (placed,) = self.fitted([found[1]], around, POLISH)
        return min(found, (squares, placed), key=lambda one: one[0])

    def beside(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return orthonormal rows (b, N) that span rows (b, N), and what these leave of what is said (N,)."""
        sizes = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)[:, None]
        there = np.ascontiguousarray(np.linalg.qr((rows / sizes).T)[0].T)
        return there, self.said - (there @ self.said) @ there

    def fitted(
        self, placed: Sequence[Placed], around: tuple[FloatArray, FloatArray], steps: int
    ) -> tuple[float, tuple[Placed, ...]]:
        """Return the sum of squares that functions leave at the best constants near these, and the functions there.

        Coefficients are eliminated at every step (variable projection); steps are those of Levenberg and Marquardt,
        within the ranges of the constants.

        Args:
            placed: functions, and where to begin.
            around: what stands beside them, as `beside` returns it.
            steps: at most.
        """
        (there, rest), constants = around, [c for p in placed for c in p.choice.constants]
        size = max(float(np.linalg.norm(rest)), 1e-300)

        if not any(p.choice.terms for p in placed):
            return float(rest @ rest), tuple(placed)
        values = {n: v for p in placed for n, v in p.values.items()}
        begin = np.array([c.coefficient(values[c.name]) for c in constants])
        limits = np.array([c.limits for c in constants]).reshape(-1, 2)
        curves = self.samples.curves([p.choice for p in placed])
        end, squares = least_within(rest / size, there, curves, begin, limits, steps if constants else 0)
        found = {c.name: c.at(p) for c, p in zip(constants, end.tolist(), strict=True)}
        return squares * size**2, tuple(Placed(p.choice, {n: found[n] for n in p.values}) for p in placed)

    def missed(self, placed: Sequence[Placed]) -> float:
        """Return the sum of squares that the base and functions leave."""
        columns = np.vstack([self.base, *(self.samples.at(p) for p in placed)])
        rest = self.said - self.coefficients(placed) @ columns if len(columns) else self.said
        return float(rest @ rest)

    def ranked(self, choices: Sequence[Choice], others: Sequence[Placed]) -> list[tuple[float, Placed]]:
        """Return every choice at its best constants, the nearest first.

        Args:
            choices: that may stand there.
            others: what stands beside.
        """
        around = self.beside(np.vstack([self.base, *(self.samples.at(o) for o in others)]))
        found = sorted((self._nearest(c, around) for c in choices), key=lambda one: one[0])
        near, far = found[:NEAR], found[NEAR:]
        near = [self._polished(one, around) if len(one[1].choice.constants) == 1 else one for one in near]
        return sorted([*near, *far], key=lambda one: one[0])

    def together(self, choices: Sequence[Sequence[Choice]]) -> list[Placed]:
        """Return one choice of each, so that all together come near, and none is more elaborate than that asks for.

        One that comes near beside others may come near to nothing by itself: a second descent begins with all there.
        """
        ends = [self._descended(choices, dearer) for dearer in ((DEARER, 1.0) if len(choices) > 1 else (DEARER,))]
        return min(ends, key=lambda placed: self.missed(placed) * DEARER ** sum(p.choice.size for p in placed))

    def _descended(self, choices: Sequence[Sequence[Choice]], dearer: float) -> list[Placed]:
        """Return one choice of each, each chosen in turn with the others as they are.

        Args:
            choices: one of each is to be chosen.
            dearer: times less that one coefficient or constant more has to leave in the first round.
        """
        chosen = list[Placed]()
        for round_ in range(ROUNDS if len(choices) > 1 else 1):
            before, price = [(p.choice, p.values) for p in chosen], DEARER if round_ else dearer
            for k, among in enumerate(choices):
                others = [*chosen[:k], *chosen[k + 1 :]]
                found = self.ranked(among, others)
                best = min(found, key=lambda one: one[0] * price ** one[1].choice.size)[1]
                chosen = [*chosen, best] if round_ == 0 else [*chosen[:k], best, *chosen[k + 1 :]]
            if [(p.choice, p.values) for p in chosen] == before:
                break
        return chosen

    def coefficients(self, placed: Sequence[Placed]) -> FloatArray:
        """Return those of the base, then of all terms of the choices."""
        columns = np.vstack([self.base, *(self.samples.at(p) for p in placed)])
        scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
        found: FloatArray = np.linalg.lstsq((columns / scale[:, None]).T, self.said)[0] / scale
        return found
