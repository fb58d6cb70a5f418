"""The coefficients of a model as a table: one row a number that was found, with what is known of its error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from odescope.library.mechanism import Kind
from odescope.library.readable import displayed
from odescope.model.relation import FoundMechanism, FoundParameter, Relation, interval_of
from odescope.model.rounding import rounded
from odescope.model.scores import ModelScores
from odescope.recordings.coordinate import Coordinate, Input

RowKind = Literal["term", "constant", "offset", "delay"] | Kind
PLAIN: tuple[RowKind, ...] = ("term", "constant", "offset", "delay")  # what is no mechanism
UNITS: Mapping[RowKind, str] = {"delay": " s"}


@dataclass(frozen=True)
class CoefficientRow:
    """One number of a model: `pandas.DataFrame(model.coefficients)` is the table.

    `kind` says what it is: of a "term" of an equation; of a mechanism ("kinetic", "potential", "dissipation", "force",
    "reaction", "tie"), of which terms are made; a "constant" within functions, the "offset" of a sensor, the "delay" of
    an input in seconds. `equation` is the target whose equation a term is in, None for what stands in several.

    The coefficient of a term has the sign that it has where the target stands on the left: x_ddot = -4*x + u has the
    rows x with -4 and u with 1. A term that holds a target is on the left itself: x_ddot + 0.3*x_ddot*x**2 = u has
    the rows x_ddot, x_ddot*x**2 with 0.3, and u.

    `lower` and `upper` are the ends of the 95 % interval, `z` is the coefficient over its standard error; they are
    None, as that is, where no error was computed, or where the number is a convention.
    """

    equation: str | None
    term: str
    coefficient: float
    std_error: float | None
    lower: float | None
    upper: float | None
    z: float | None
    kind: RowKind

    @staticmethod
    def of(kind: RowKind, equation: str | None, term: str, value: float, std_error: float | None) -> CoefficientRow:
        """Return the row of a number.

        Args:
            kind: what it is.
            equation: the target whose equation it is in.
            term: what it multiplies, or what it is called.
            value: the number.
            std_error: of it.
        """
        lower, upper = interval_of(value, std_error) or (None, None)
        z = value / std_error if std_error else None
        return CoefficientRow(equation, term, value, std_error, lower, upper, z, kind)


def term_rows(relations: Sequence[Relation], targets: Sequence[str]) -> Iterator[CoefficientRow]:
    """Yield the coefficients of relations; that of a target which is alone on the left is 1, and no row.

    As in the equations that people are shown, a single product of a target is divided out.
    """
    for target, relation in zip(targets, relations, strict=True):
        divided = relation.divided
        left = divided.left
        if not (len(left) == 1 and left[0].product.bare and left[0].coefficient == 1.0):
            for t in left:
                yield CoefficientRow.of("term", target, t.text, t.coefficient, t.std_error)
        for t in divided.terms:
            if t.factor is None:
                text = displayed(t.term)
                # 0 is added because -0.0 is no number that anyone writes.
                yield CoefficientRow.of("term", target, text, 0.0 - t.coefficient, t.std_error)


def mechanism_rows(mechanisms: Sequence[FoundMechanism]) -> Iterator[CoefficientRow]:
    """Yield the coefficients of mechanisms."""
    for m in mechanisms:
        yield CoefficientRow.of(m.kind, None, m.name, m.coefficient, m.std_error)


def other_rows(
    parameters: Sequence[FoundParameter],
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    scores: ModelScores | None,
) -> Iterator[CoefficientRow]:
    """Yield constants within functions, offsets of sensors and delays of inputs, where there are any.

    Args:
        parameters: of the model.
        coordinates: of the model.
        inputs: of the model.
        scores: hold the standard errors of offsets and delays.
    """
    found = scores or ModelScores()
    for p in parameters:
        yield CoefficientRow.of("constant", None, p.name, p.value, p.std_error)
    for c in coordinates:
        if c.offset:
            error = found.offsets[c.name].std_error if c.name in found.offsets else None
            yield CoefficientRow.of("offset", None, c.name, c.offset, error)
    for i in inputs:
        if i.delay:
            error = found.delays[i.name].std_error if i.name in found.delays else None
            yield CoefficientRow.of("delay", None, i.name, i.delay, error)


def rows_with_errors(rows: Sequence[CoefficientRow]) -> list[CoefficientRow]:
    """Return the rows whose standard errors stand neither in equations nor beside them.

    Constants and mechanisms are shown with theirs; what terms have is then said by the mechanisms that make them up.
    """
    made_of = any(row.kind not in PLAIN for row in rows)
    shown = ("offset", "delay") if made_of else ("term", "offset", "delay")
    return [row for row in rows if row.std_error is not None and row.kind in shown]


def coefficient_lines(rows: Sequence[CoefficientRow]) -> list[str]:
    """Return rows as lines of text: where it stands, what it multiplies, the number and its standard error."""
    sizes = [rounded(row.coefficient, row.std_error) for row in rows]
    texts = [
        value + (f" +- {error}" if error else "") + UNITS.get(row.kind, "")
        for row, (value, error) in zip(rows, sizes, strict=True)
    ]
    heads = [row.equation or row.kind for row in rows]
    first, second = (max(map(len, part), default=0) for part in (heads, [row.term for row in rows]))
    return [f"{head:{first}}  {row.term:{second}}  {text}" for head, row, text in zip(heads, rows, texts, strict=True)]
