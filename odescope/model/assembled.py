"""From coefficients of mechanisms to relations: parts added up, each relation scaled by its leading target term."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.mechanism import Mechanism, scale_groups
from odescope.library.product import Product
from odescope.model.relation import FoundMechanism, Relation, RelationTerm

CANCELLED = 1e-13  # of what a coefficient is the sum of: what is left is rounding
EXACT = 1e-10  # standard error over coefficient: what is known but for rounding has none


def relations_of(
    mechanisms: Sequence[Mechanism], theta: FloatArray, covariance: FloatArray | None, targets: Sequence[str]
) -> tuple[Relation, ...]:
    """Return the relations that mechanisms add up to, the leading target term of each with coefficient 1 and first.

    Leading is the target of the relation's own coordinate where it stands bare, else the simplest product with it, else
    that with another target. Standard errors follow from the covariance to first order (the delta method).

    Args:
        mechanisms: those of the model.
        theta: (k,) their coefficients.
        covariance: (k, k) of the coefficients, zero where they are given; None where it is not known.
        targets: one a relation.
    """
    return tuple(_relation(r, target, mechanisms, theta, covariance) for r, target in enumerate(targets))


def _relation(
    r: int, target: str, mechanisms: Sequence[Mechanism], theta: FloatArray, covariance: FloatArray | None
) -> Relation:
    products, shares = _shares(r, mechanisms)
    coefficients, sizes = shares @ theta, np.abs(shares) @ np.abs(theta)
    kept = np.abs(coefficients) > CANCELLED * sizes
    found = [k for k in range(len(products)) if kept[k]]
    held = [k for k in found if products[k].factor is not None]
    if not held:
        return Relation(tuple(RelationTerm(products[k], float(coefficients[k])) for k in found))
    lead = min(held, key=lambda k: (products[k].factor != target, products[k].degree, -abs(coefficients[k])))
    scaled = coefficients / coefficients[lead]
    errors: list[float | None] = [None] * len(products)
    if covariance is not None:
        slopes = (shares - scaled[:, None] * shares[lead]) / coefficients[lead]
        variances = np.maximum(np.einsum("ki,ij,kj->k", slopes, covariance, slopes), 0.0)
        for k in found:
            error = float(np.sqrt(variances[k]))
            errors[k] = error if error > EXACT * abs(scaled[k]) else None
    order = [lead, *(k for k in found if k != lead)]
    return Relation(tuple(RelationTerm(products[k], 1.0 if k == lead else float(scaled[k]), errors[k]) for k in order))


def _shares(r: int, mechanisms: Sequence[Mechanism]) -> tuple[list[Product], FloatArray]:
    """Return the products of a relation, and the share of every mechanism in each, (products, k)."""
    place: dict[Product, int] = {}
    entries = list[tuple[int, int, float]]()
    for k, mechanism in enumerate(mechanisms):
        for part in mechanism.parts:
            if part.relation == r:
                entries.append((place.setdefault(part.product, len(place)), k, part.share))
    shares = np.zeros((len(place), len(mechanisms)))
    for row, k, share in entries:
        shares[row, k] += share
    return list(place), shares


def stated(
    mechanisms: Sequence[Mechanism], theta: FloatArray, covariance: FloatArray | None
) -> tuple[FoundMechanism, ...]:
    """Return the mechanisms of a model as people read them, in one scale a group of relations.

    Where an input drives a group the coefficient of its force is 1, so that masses are masses; without one the first
    square of a rate, or of a speed, has 1/2. Reactions and what is known keep their scale. Plain candidates are left
    to the relations.

    Args:
        mechanisms: those of the model.
        theta: (k,) their coefficients.
        covariance: (k, k) of the coefficients, zero where they are given; None where it is not known.
    """
    scaled, errors = theta.copy(), np.full(len(theta), np.nan)
    if covariance is not None:
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    for group in scale_groups(mechanisms, range(len(mechanisms))):
        reference = _reference(mechanisms, group)
        if reference is None:
            continue
        k, value, inside = *reference, list(group)
        scaled[inside] = theta[inside] * value / theta[k]
        kinetic = sum(scaled[j] for j in inside if mechanisms[j].kind == "kinetic" and _square(mechanisms[j]))
        scaled[inside] *= -1.0 if kinetic < 0.0 else 1.0
        if covariance is not None:
            slopes = np.eye(len(theta))[inside] - np.outer(theta[inside] / theta[k], np.eye(len(theta))[k])
            variances = np.einsum("ki,ij,kj->k", slopes, covariance, slopes) * (value / theta[k]) ** 2
            errors[inside] = np.sqrt(np.maximum(variances, 0.0))
    return tuple(
        FoundMechanism(m.name or m.term, m.kind, m.term, float(c), float(e) if e > EXACT * abs(c) else None)
        for m, c, e in zip(mechanisms, scaled, errors, strict=True)
        if m.parts and m.kind != "term"
    )


def sureness(
    mechanisms: Sequence[Mechanism], theta: FloatArray, covariance: FloatArray, targets: Sequence[str]
) -> tuple[float | None, ...]:
    """Return how many standard errors each mechanism is from zero in what `relations_of` and `stated` say of it.

    Args:
        mechanisms: those of the model.
        theta: (k,) their coefficients.
        covariance: (k, k) of the coefficients, zero where they are given.
        targets: one a relation.
    """
    relations = relations_of(mechanisms, theta, covariance, targets)
    plain = {(r, t.product): t for r, relation in enumerate(relations) for t in relation.terms}
    joint = iter(stated(mechanisms, theta, covariance))
    said = list[RelationTerm | FoundMechanism | None]()
    for m in mechanisms:
        if not m.parts:
            said.append(None)
        elif m.kind == "term":
            said.append(plain.get((m.parts[0].relation, m.parts[0].product)))
        else:
            said.append(next(joint))
    return tuple(abs(s.coefficient) / s.std_error if s is not None and s.std_error else None for s in said)


def _reference(mechanisms: Sequence[Mechanism], group: Sequence[int]) -> tuple[int, float] | None:
    """Return whose coefficient sets the scale of a group, and its value there; None where the scale is given."""
    if any(mechanisms[k].known is not None for k in group):
        return None
    # A constant force is what an input is off, or a slope: nobody knows its size beforehand.
    forces = [k for k in group if mechanisms[k].kind == "force" and mechanisms[k].names]
    if forces:
        return min(forces, key=lambda k: mechanisms[k].size), 1.0
    squares = [k for k in group if mechanisms[k].kind == "kinetic" and _square(mechanisms[k])]
    return (max(squares, key=lambda k: len(mechanisms[k].parts)), 0.5) if squares else None


def _square(mechanism: Mechanism) -> bool:
    """Say whether a mechanism is the kinetic energy of squared rates: that of a product adds half as much."""
    return all(part.product.bare and part.share == 2.0 for part in mechanism.parts)


def coefficients_of(mechanisms: Sequence[Mechanism], relations: Sequence[Relation]) -> FloatArray:
    """Return the coefficients (k,) of mechanisms in relations, in the scale of those that are known.

    Args:
        mechanisms: whose coefficients are wanted; what is in the relations and not among them is left out.
        relations: one a target.
    """
    found = {(r, t.product): t.coefficient for r, relation in enumerate(relations) for t in relation.terms}
    scale = np.ones(len(relations))
    for m in mechanisms:
        if m.known is not None:
            for part in m.parts:
                here = found.get((part.relation, part.product), 0.0)
                scale[part.relation] = m.known * part.share / here if here else 1.0
    theta = np.zeros(len(mechanisms))
    for k, m in enumerate(mechanisms):
        seen = [
            found[p.relation, p.product] * scale[p.relation] / p.share
            for p in m.parts
            if (p.relation, p.product) in found
        ]
        theta[k] = m.known if m.known is not None else float(np.mean(seen)) if seen else 0.0
    return theta
