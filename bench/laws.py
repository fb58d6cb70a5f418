"""Whether a model is the law of a rig, however either is written: judged by accelerations at random states.

A law is a row of terms that add up to zero. A model holds it when at the model's own accelerations the terms are
linearly dependent, and without any one of them they are not. So relations and mechanisms, solved for the accelerations
or not, expanded or not, compare alike. A model has the exact structure when it holds as many rows as there are targets
of the rig's equations of motion and what the rig names beside, or of these equations solved for the accelerations (not
some of the one and some of the other: a row that is solved has terms of friction that the others have not). Where the
zero of an angle is off, a term may come as any combination of itself at shifted angles: sin(q - q0) as a sin(q) + b
cos(q). A dry friction tanh(v/w) with w below a fifth of the root mean square of v counts as sign(v).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from truths import Truth, relations

from odescope.library.expression import Call, Combination, Term
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.model.model import Model
from odescope.model.relation import Relation

POINTS = 600
SHARP = 5.0  # rms of the argument of a tanh from which it is a sign
DEPENDENT = 1e-6  # least singular value over the largest, of terms of size 1
SHIFTS = np.linspace(0.0, 2.0, 5)  # rad: shifted copies of a trigonometric term of degree 2 or less span all the others
Row = tuple[Product, ...]


@dataclass(frozen=True)
class Verdict:
    """What a model is worth as a law.

    Attributes:
        exact: whether it has the structure of the truth.
        off: root mean square error of its accelerations over that of the true ones, of the worst target.
        physical: relative errors of the coefficients of the rig's equations of motion, by target and term; what acts
            beside the inputs is left out.
        stated: error and standard error of the coefficients as the model writes them.
    """

    exact: bool
    off: float
    physical: Mapping[str, float]
    stated: tuple[tuple[float, float], ...]


def judge(
    truth: Truth, zero: Sequence[float], also: Iterable[Row], found: Model, seen: np.ndarray, rng: np.random.Generator
) -> Verdict:
    """Return the verdict on a model.

    Args:
        truth: with the constants that act beside the inputs.
        zero: of every coordinate, what its reading is off.
        also: rows that follow from the truth's.
        found: in the truth's coordinates and inputs.
        seen: (variables, N) states and inputs without noise, as they are read.
        rng: draws the states, from the ranges that were seen.
    """
    low, high = seen.min(axis=1, keepdims=True), seen.max(axis=1, keepdims=True)
    at = rng.uniform(low, high, (len(seen), POINTS))
    found = stepped(found, seen)
    # A model whose coordinates are readings less an offset lives by these.
    offsets = offsets_of(found)
    mine, real = shifted(at, offsets), shifted(at, zero)
    theirs, true = accelerations(found, mine), accelerations(truth.model, real)
    usable = np.isfinite(theirs).all(axis=0)
    if usable.mean() < 0.9:  # poles nearly everywhere
        return Verdict(False, np.inf, {}, ())
    mine, real, theirs, true = mine[:, usable], real[:, usable], theirs[:, usable], true[:, usable]
    free = rng.standard_normal(theirs.shape)
    forms = ([*equations(truth.model.relations), *also], solved(truth.model))

    def held(shifts: Sequence[float], columns: np.ndarray) -> bool:
        counts = [sum(holds(truth.model, row, shifts, columns, theirs, free) for row in rows) for rows in forms]
        return max(counts) >= len(truth.targets)

    # Equations of motion in the readings themselves leave a zero out that is off, if they hold its coordinate.
    named = set().union(*(p.term.names for row in forms[0] for p in row))
    missed = (z and not o and c.name in named for z, o, c in zip(zero, offsets, truth.model.coordinates, strict=True))
    blind = any(missed) and held(np.zeros(len(zero)), mine)
    exact = held(zero, real) and not blind
    scale = np.sqrt(np.mean(true**2, axis=1))
    off = float(np.max(np.sqrt(np.mean((theirs - true) ** 2, axis=1)) / scale))
    stated = tuple(pair for relation in found.relations for pair in errors(found, relation, mine, true))
    return Verdict(exact, off, physical(truth.model, real, theirs), stated)


def offsets_of(model: Model) -> np.ndarray:
    """Return the reading less the coordinate (c,) that a model has found; zeros for a model that knows of none."""
    return np.array([getattr(c, "offset", None) or 0.0 for c in model.coordinates])


def shifted(columns: np.ndarray, zero: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return states and inputs whose coordinates, which come first, are less by these zeros."""
    moved = columns.copy()
    moved[: len(zero)] -= np.asarray(zero)[:, None]
    return moved


def equations(these: Iterable[Relation]) -> list[Row]:
    """Return the rows of relations as they stand."""
    return [tuple(t.product for t in relation.terms) for relation in these]


def solved(model: Model) -> list[Row]:
    """Return the rows of a model solved for the accelerations, of those that it does not hold that way already."""
    if len(model.targets) == 1 or all(
        {t.factor for t in r.terms} <= {None, r.terms[0].factor} for r in model.relations
    ):
        return []
    return [
        (*(Product(q.target, t) for _, t in q.denominator.parts), *(Product(None, t) for _, t in q.numerator.parts))
        for q in model.quotients
    ]


def values(model: Model, row: Iterable[Product], columns: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return a row's products (N, terms) at states and inputs, and accelerations."""
    terms = [Combination.of([(1.0, p.expanded)]) for p in row]
    return evaluate(write_tape((*model.variables, *model.targets), terms), np.vstack([columns, targets])).T


def accelerations(model: Model, columns: np.ndarray) -> np.ndarray:
    """Return the targets (T, N) of a model; NaN where its relations determine none."""
    count = len(model.targets)
    entries = evaluate(model.tape, columns).T
    matrix, right = entries[:, : count * count].reshape(-1, count, count), entries[:, count * count :]
    good = np.isfinite(entries).all(axis=1)
    good[good] = np.abs(np.linalg.det(matrix[good])) > 1e-12
    targets = np.full((len(entries), count), np.nan)
    targets[good] = np.linalg.solve(matrix[good], right[good][:, :, None])[:, :, 0]
    return targets.T


def holds(
    model: Model, row: Row, zero: Sequence[float], columns: np.ndarray, targets: np.ndarray, free: np.ndarray
) -> bool:
    """Say whether the terms of a row are dependent at these accelerations, and all of them are needed for that.

    Args:
        model: names the variables.
        row: of the truth.
        zero: of every coordinate, what its reading is off.
        columns: (variables, N) states and inputs as the truth takes them.
        targets: (T, N) accelerations that are judged.
        free: (T, N) any others: terms that are dependent even there are the same term twice.
    """
    groups, loose = list[np.ndarray](), list[np.ndarray]()
    for one in row:
        turned = [k for k, c in enumerate(model.coordinates) if zero[k] and c.name in one.term.names]
        moves = [np.zeros(len(zero))]
        for shifts in product(SHIFTS, repeat=len(turned)):
            moves.append(np.zeros(len(zero)))
            moves[-1][turned] = shifts
        groups.append(np.hstack([values(model, [one], shifted(columns, m), targets) for m in moves]))
        loose.append(np.hstack([values(model, [one], shifted(columns, m), free) for m in moves]))
    owner = np.repeat(np.arange(len(row)), [g.shape[1] for g in groups])
    kept = independent(np.hstack(loose))
    owner, matrix = owner[kept], np.hstack(groups)[:, kept]
    matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)  # a target that does not accelerate
    return dependent(matrix) and not any(dependent(matrix[:, owner != k]) for k in set(owner))


def independent(matrix: np.ndarray) -> list[int]:
    """Return the columns that are no combination of those before them."""
    kept, basis = list[int](), np.empty((len(matrix), 0))
    for k, column in enumerate(matrix.T / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)[:, None]):
        rest = column - basis @ (basis.T @ column)
        rest -= basis @ (basis.T @ rest)
        size = np.linalg.norm(rest)
        if size > DEPENDENT:
            kept.append(k)
            basis = np.column_stack([basis, rest / size])
    return kept


def dependent(matrix: np.ndarray) -> bool:
    sizes = np.linalg.svd(matrix, compute_uv=False)
    return bool(sizes[-1] < DEPENDENT * sizes[0])


def physical(model: Model, columns: np.ndarray, targets: np.ndarray) -> dict[str, float]:
    """Return how far the coefficients of the truth's relations are off that fit these accelerations best."""
    off = dict[str, float]()
    for target, relation in zip(model.targets, model.relations, strict=True):
        fitted = coefficients(model, equations([relation])[0], columns, targets)
        for t, c in zip(relation.terms[1:], fitted, strict=True):
            if t.text != "1":
                off[f"{target}: {t.text}"] = float(c / t.coefficient - 1.0)
    return off


def errors(model: Model, relation: Relation, columns: np.ndarray, targets: np.ndarray) -> list[tuple[float, float]]:
    """Return error and standard error of a relation's coefficients, given the true accelerations."""
    lead = next(t for t in relation.terms if t.factor is not None and t.coefficient == 1.0 and t.std_error is None)
    others = [t for t in relation.terms if t is not lead]
    right = coefficients(model, tuple(t.product for t in (lead, *others)), columns, targets)
    return [(t.coefficient - c, t.std_error) for t, c in zip(others, right, strict=True) if t.std_error is not None]


def coefficients(model: Model, row: Row, columns: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the coefficients of all terms but the first, whose coefficient is 1, that add up to zero best."""
    lead, *others = values(model, row, columns, targets).T
    matrix = np.column_stack(others)
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    return np.linalg.lstsq(matrix / sizes, -lead, rcond=None)[0] / sizes


def stepped(model: Model, seen: np.ndarray) -> Model:
    """Return a model in which every tanh that is sharp over what was seen is a sign."""

    def sharp(argument: Combination) -> bool:
        return bool(np.sqrt(np.mean(evaluate(write_tape(model.variables, [argument]), seen) ** 2)) > SHARP)

    def changed(term: Term) -> Term:
        factors = []
        for atom, power in term.factors:
            if isinstance(atom, Call) and atom.function == "tanh" and sharp(atom.argument):
                atom = Call("sign", atom.argument)
            factors.append((atom, power))
        return Term.of(factors)

    terms = [
        tuple(replace(t, product=replace(t.product, term=changed(t.term))) for t in relation.terms)
        for relation in model.relations
    ]
    return replace(model, relations=tuple(map(Relation, terms)))


def rows_of(truth: Truth, laws: Iterable[Sequence[tuple[str | None, str, float]]]) -> list[Row]:
    """Return further laws of a truth's rig as rows."""
    target = truth.targets[0]
    parsed = [relations(truth.coordinates, truth.inputs, {target: law}).mechanisms for law in laws]
    return [tuple(m.parts[0].product for m in mechanisms) for mechanisms in parsed]
