"""Conservation laws: weighted sums of species that stay constant, by composition, by stoichiometry, or by the data."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, product

import numpy as np
from scipy.special import chdtri  # scipy.stats has it under a clearer name, and takes a second to import

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.library.expression import signed_sum
from odescope.library.mechanism import Mechanism
from odescope.library.product import Product
from odescope.recordings.coordinate import Coordinate

FINEST = 1000  # denominator of a stoichiometry: what ties multiply by floats are still ratios of small numbers
MOST_LAWS = 500  # non-negative laws looked at on the way; beyond it those of the echelon form have to do
BLOCKS = 16  # a recording, for what varies slowly: the noise of their means is small
LEVEL = 1e-3  # chance that noise makes a sum that is constant look as if it were not
TOLERANCE = 1.2  # factor by which the noise may be larger than it is said to be
CLEAR = 12.0  # variance of a member over that of the sum's noise, so that its weight is a whole number and no other
FLOOR = 1e-6  # of what a species varies: no sum of columns without noise is constant to better
LARGEST_WEIGHT = 3
MOST_MEMBERS = 4

_COUNTED = re.compile(r"(?:(?P<count>[1-9]\d{0,3})\s+)?(?P<moiety>[A-Za-z_]\w*)", re.ASCII)


@dataclass(frozen=True)
class ConstantSum:
    """A weighted sum of species that stays constant in every recording of some data.

    Attributes:
        weights: whole numbers, of the species with a weight.
        values: one a recording: the mean of the sum.
    """

    weights: Mapping[str, float]
    values: tuple[float, ...]

    def __str__(self) -> str:
        return signed_sum((weight, name) for name, weight in self.weights.items())


def species_of(coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return the names of coordinates that are amounts of species.

    Raises:
        InputError: the equation of one is not of order 1.
    """
    for c in coordinates:
        if c.order != 1:
            raise InputError(f"{c.name!r} cannot be a species of a reaction: its order is {c.order}; set order = 1")
    return tuple(c.name for c in coordinates)


def moieties_of(composition: Mapping[str, str]) -> dict[str, Counter[str]]:
    """Return how often every moiety stands in every species.

    A species is written as its moieties with blanks between, a count before the moiety it counts: "6 C 12 H 6 O". One
    that is repeated counts again: "s s e" is "2 s e". Nothing at all is for what may come from nothing and vanish.

    Raises:
        InputError: a text is no such list.
    """
    found = dict[str, Counter[str]]()
    for species, text in composition.items():
        found[species], rest = Counter(), text.strip()
        while rest:
            match = _COUNTED.match(rest)
            if match is None or not (match.end() == len(rest) or rest[match.end()].isspace()):
                raise InputError(
                    f"cannot read the composition of {species!r}, {text!r}, from {rest!r} on: expected names of"
                    " moieties with blanks between, a count before the one it counts, such as '2 s e'"
                )
            found[species][match["moiety"]] += int(match["count"] or 1)
            rest = rest[match.end() :].lstrip()
    return found


def conserved_by_composition(composition: Mapping[str, str]) -> tuple[Mapping[str, float], ...]:
    """Return the sums that are constant where every reaction balances: one a moiety, less those that others imply.

    Raises:
        InputError: a composition cannot be read.
    """
    species, held = tuple(composition), moieties_of(composition)
    moieties = dict.fromkeys(m for s in species for m in held[s])
    return _laws(_independent([_whole([Fraction(held[s][m]) for s in species]) for m in moieties]), species)


def conserved(coordinates: Sequence[Coordinate], mechanisms: Sequence[Mechanism]) -> tuple[Mapping[str, float], ...]:
    """Return the sums that are constant whatever the coefficients of these mechanisms are.

    A basis of the left null space of the stoichiometry, in small whole numbers and without negative ones where that
    can be. A species whose relation is not its rate of change with coefficient 1 plus products without targets is in
    no law.

    Args:
        coordinates: the species, of order 1, one a relation.
        mechanisms: reactions and the bare targets, and whatever else stands in the relations.

    Raises:
        InputError: a coordinate is not of order 1.
    """
    species = species_of(coordinates)
    changes = _echelon(_changes(coordinates, mechanisms))
    laws = [*_nonnegative(changes, len(species)), *_null_space(changes, len(species))]
    return _laws(_independent(laws), species)


def constant_sums(columns: Sequence[FloatArray], names: Sequence[str], noise: FloatArray) -> tuple[ConstantSum, ...]:
    """Return the sums of two to four species, with weights from -3 to 3, that are constant in data but for noise.

    The variance of the sum about its mean in each recording, sample by sample and in means of blocks, is what the noise
    makes (chi-square, with noise up to 1.2 times as large), while every member varies by far more. What follows from
    simpler laws is left out.

    Args:
        columns: one a recording, (species, N): as measured, not smoothed.
        names: of the species.
        noise: (recordings, species) standard deviations of their noise, white.

    Raises:
        InputError: shapes do not agree, or a value is not finite.
    """
    _check_columns(columns, names, noise)
    spread = np.array([np.std(np.concatenate([x[i] for x in columns])) for i in range(len(names))])
    scatter, freedom, variance = _scatters(columns, np.maximum(noise, FLOOR * spread) ** 2)
    if not len(freedom):
        return ()
    allowed = TOLERANCE**2 * chdtri(freedom, LEVEL / len(freedom))
    excess = np.diagonal(scatter[-1]) / freedom[-1] - variance[-1]  # of the blocks of all recordings together
    found = list[tuple[int, ...]]()
    for k in range(2, min(MOST_MEMBERS, len(names)) + 1):
        weights = _weights(k)
        for members in combinations(range(len(names)), k):
            inside = np.ix_(range(len(freedom)), members, members)
            sums = np.einsum("wi,qij,wj->wq", weights, scatter[inside], weights)
            noises = weights**2 @ variance[:, list(members)].T
            constant = np.all(sums <= allowed * noises, axis=1)
            clear = excess[list(members)].min() >= CLEAR * noises[:, -1]
            for w in weights[constant & clear]:
                law = dict(zip(members, w.astype(int).tolist(), strict=True))
                found.append(tuple(law.get(i, 0) for i in range(len(names))))
    rows = _independent([_whole([Fraction(w) for w in law]) for law in found])
    return tuple(
        ConstantSum(law, tuple(float(np.array(row, dtype=float) @ x.mean(axis=1)) for x in columns))
        for row, law in zip(rows, _laws(rows, names), strict=True)
    )


def _check_columns(columns: Sequence[FloatArray], names: Sequence[str], noise: FloatArray) -> None:
    for k, x in enumerate(columns):
        if x.ndim != 2 or len(x) != len(names) or not x.shape[1]:
            raise InputError(f"recording {k} has shape {x.shape}, expected {len(names)} species by samples")
        if not np.isfinite(x).all():
            raise InputError(f"recording {k} has values that are not finite; leave those samples out")
    if noise.shape != (len(columns), len(names)) or not (np.isfinite(noise).all() and (noise >= 0.0).all()):
        raise InputError(
            f"expected standard deviations of noise of shape {len(columns), len(names)}, none negative, got {noise!r}"
        )


def _scatters(columns: Sequence[FloatArray], variance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return sums of squares and products about the mean, (q, species, species), degrees of freedom, and variances.

    Of every recording and of all of them together, sample by sample and in means of blocks: samples alone hide what
    drifts slowly within the noise, blocks alone what oscillates fast. The last are the blocks of all.

    Args:
        columns: one a recording, (species, N).
        variance: (recordings, species) of the noise.
    """
    scatters, freedoms, variances = list[FloatArray](), list[int](), list[FloatArray]()
    for blocks in (None, BLOCKS):
        scatter, freedom, own = list[FloatArray](), list[int](), list[FloatArray]()
        for x, v in zip(columns, variance, strict=True):
            count = x.shape[1] if blocks is None else min(blocks, x.shape[1])
            if count < 2:
                continue
            starts = np.linspace(0, x.shape[1], count + 1).astype(int)
            sums = np.add.reduceat(x - x.mean(axis=1, keepdims=True), starts[:-1], axis=1)
            scaled = sums / np.sqrt(np.diff(starts))
            scatter.append(scaled @ scaled.T)
            freedom.append(count - 1)
            own.append(v)
        if scatter:
            scatters += [*scatter, np.sum(scatter, axis=0)]
            freedoms += [*freedom, sum(freedom)]
            variances += [*own, np.average(own, axis=0, weights=freedom)]
    return np.array(scatters), np.array(freedoms, dtype=float), np.array(variances)


def _weights(members: int) -> FloatArray:
    """Return weights (w, members) of sums, none of them zero, each direction once."""
    whole = [w for w in range(-LARGEST_WEIGHT, LARGEST_WEIGHT + 1) if w]
    found = [w for w in product(whole, repeat=members) if w[0] > 0 and math.gcd(*w) == 1]
    return np.array(found, dtype=float)


def _changes(coordinates: Sequence[Coordinate], mechanisms: Sequence[Mechanism]) -> list[list[Fraction]]:
    """Return what a law must not notice: of every product of a mechanism what it adds to each species."""
    changes, rates = list[list[Fraction]](), [False] * len(coordinates)
    barred = set[int]()
    for m in mechanisms:
        if m.known == 0.0:
            continue
        rows = dict[Product, list[float]]()
        for part in m.parts:
            own = part.product == Product(coordinates[part.relation].target)
            if own and m.known is not None and math.isclose(m.known * part.share, 1.0):
                rates[part.relation] = True
            elif part.product.factor is not None:
                barred.add(part.relation)
            else:
                row = rows.setdefault(part.product, [0.0] * len(coordinates))
                row[part.relation] += part.share
        for row in rows.values():
            largest = max(map(abs, row)) or 1.0
            changes.append([Fraction(share / largest).limit_denominator(FINEST) for share in row])
    barred |= {i for i, rate in enumerate(rates) if not rate}
    return [*changes, *([Fraction(i == j) for j in range(len(coordinates))] for i in sorted(barred))]


def _echelon(rows: Sequence[Sequence[Fraction | int]]) -> list[list[Fraction]]:
    """Return the reduced row echelon form without rows of zeros."""
    found = list[list[Fraction]]()
    for given in rows:
        row = [Fraction(value) for value in given]
        for other in found:
            row = _cleared(row, other)
        if any(row):
            lead = next(value for value in row if value)
            row = [value / lead for value in row]
            found = [*(_cleared(other, row) for other in found), row]
    return sorted(found, key=_leading)


def _leading(row: Sequence[Fraction]) -> int:
    return next(k for k, value in enumerate(row) if value)


def _cleared(row: list[Fraction], by: list[Fraction]) -> list[Fraction]:
    """Return a row less the multiple of one that leads with 1 which makes it zero there."""
    factor = row[_leading(by)]
    return [a - factor * b for a, b in zip(row, by, strict=True)] if factor else row


def _null_space(echelon: Sequence[Sequence[Fraction]], width: int) -> list[list[int]]:
    leads = {_leading(row): row for row in echelon}
    return [
        _whole([-leads[k][free] if k in leads else Fraction(k == free) for k in range(width)])
        for free in range(width)
        if free not in leads
    ]


def _nonnegative(changes: Sequence[Sequence[Fraction]], width: int) -> list[list[int]]:
    """Return the laws without negative weights of which no part is a law (the algorithm of Farkas); none if too many.

    Sums of two that change oppositely are unchanged; what contains another is not needed any more.
    """
    laws = [[int(i == j) for j in range(width)] for i in range(width)]
    for change in changes:
        effects = [sum(w * c for w, c in zip(law, change, strict=True)) for law in laws]
        kept = [law for law, e in zip(laws, effects, strict=True) if not e]
        up = [(law, e) for law, e in zip(laws, effects, strict=True) if e > 0]
        down = [(law, -e) for law, e in zip(laws, effects, strict=True) if e < 0]
        if len(up) * len(down) > MOST_LAWS:
            return []
        kept += [_whole([f * v + e * w for v, w in zip(a, b, strict=True)]) for a, e in up for b, f in down]
        members = [{k for k, w in enumerate(law) if w} for law in kept]
        laws = [
            law
            for k, law in enumerate(kept)
            if not any(m < members[k] or (m == members[k] and j < k) for j, m in enumerate(members))
        ]
    return laws


def _whole(row: Sequence[Fraction | int]) -> list[int]:
    """Return the smallest whole numbers in these ratios, the first of them positive."""
    exact = [Fraction(value) for value in row]
    scale = math.lcm(*(value.denominator for value in exact))
    numbers = [int(value * scale) for value in exact]
    divisor = math.gcd(*numbers) or 1
    sign = -1 if next((n for n in numbers if n), 1) < 0 else 1
    return [sign * n // divisor for n in numbers]


def _independent(laws: Sequence[list[int]]) -> list[list[int]]:
    """Return laws none of which follows from the others: few species first, then few negatives, then small numbers."""
    chosen = list[list[int]]()
    for law in sorted(laws, key=lambda w: (sum(map(bool, w)), sum(n < 0 for n in w), sum(map(abs, w)))):
        if len(_echelon([*chosen, law])) > len(chosen):
            chosen.append(law)
    return chosen


def _laws(rows: Sequence[Sequence[int]], species: Sequence[str]) -> tuple[dict[str, float], ...]:
    return tuple({s: float(w) for s, w in zip(species, row, strict=True) if w} for row in rows)
