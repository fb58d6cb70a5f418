"""A sine of the time or of a position without which a few terms do not say a target.

The former is a forcing that was not recorded, or a coefficient that goes to and fro: how people meet over a year, how
long a swing is. The latter is what repeats along a way: the cogging of a motor, a gear.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.library.expression import ONE, Term
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.smoothed_targets import rates

SHARE = 0.4  # least share of what terms leave of a target that goes with a sine
TERMS = 5  # of a relation, beside the sine
PRICE = 3  # terms more that stand for sine, cosine and their rate where there are none
LEAST = 3.0  # periods in the longest recording
FINE = 4  # times as fine as one more period in that recording are the rates that are compared
DENSE = 8  # averages in a period, at least; along a position at its usual rate
CLEARER = 0.8  # of what a sine leaves: a coefficient with a sine leaves less, where it is tried in its place
FACTORS = 2  # powers in a product that a sine of the time may multiply
HALVES = 2  # places of a position in what it usually moves from one average to the next
TOGETHER = 2**22  # numbers in memory at once
INDEPENDENT = 1e-7  # share of a column that those chosen before do not say


@dataclass(frozen=True)
class Forcing:
    """A rate of what is lacking in a relation, known to within `width`, and its share of what terms leave.

    It is in rad a second, or in rad a unit of `variable`, a position; the sine multiplies the term `beside`.
    """

    variable: str | None
    relation: int
    rate: float
    width: float
    share: float
    beside: Term = ONE


@dataclass(frozen=True, eq=False)
class _Along:
    """What a sine may go with: the time, or a position.

    Shapes: place (N,) of every average on a grid of `step`, from 0 on; a sine has a phase of its own in each of `runs`,
    and `least` steps a period or more.
    """

    variable: str | None
    place: IntArray
    step: float
    runs: tuple[tuple[int, int], ...]
    least: int


@dataclass(frozen=True, eq=False)
class _Columns:
    """The plain terms of a relation at the smoothed states and its target last, (terms + 1, N)."""

    terms: tuple[Term, ...]
    values: FloatArray


def periodic(space: SearchSpace, positions: Sequence[str] = ()) -> Forcing | None:
    """Return the rate at which a sine helps the terms of a relation most, None where none clearly does.

    At every rate that a record resolves sine and cosine are given, of the time with a phase for each recording or of a
    position, and a forward selection takes terms of the relation beside them; it is compared with one without. Those
    of the time may multiply a term, where that leaves clearly less.

    Args:
        space: whose relations and smoothed states are meant.
        positions: those of its states that a sine may be of, beside the time.
    """
    relations, time = _columns(space), _time(space)
    moving = (_position(space, name) for name in positions)
    alone = [f for along in (time, *moving) if along is not None for f in _forcings(relations, along)]
    clearest = max(alone, key=_share, default=None)
    swinging = max(_forcings(relations, time, FACTORS), key=_share, default=None)
    if clearest is None or (swinging is not None and 1.0 - swinging.share < CLEARER * (1.0 - clearest.share)):
        clearest = swinging
    return clearest if clearest is not None and clearest.share > SHARE else None


def _share(forcing: Forcing) -> float:
    return forcing.share


def _time(space: SearchSpace) -> _Along:
    segments = space.segments
    place = np.zeros(len(segments.filtered), dtype=np.int64)
    for low, high in segments.runs:
        place[low:high] = np.arange(high - low)
    return _Along(None, place, segments.step, segments.runs, DENSE)


def _position(space: SearchSpace, name: str) -> _Along | None:
    """Return a position, None for one that rests."""
    segments = space.segments
    values = segments.filtered[:, space.frame.states.index(name)]
    moved = np.concatenate([np.diff(values[low:high]) for low, high in segments.runs])
    step = float(np.sqrt(np.mean(moved**2))) / HALVES if len(moved) else 0.0
    if not step > 0.0:
        return None
    # A place is off by half a step at most, a sixteenth of a turn of the fastest sine.
    place = np.rint((values - values.min()) / step).astype(np.int64)
    return _Along(name, place, step, ((0, len(values)),), DENSE * HALVES)


def _forcings(relations: Sequence[_Columns], along: _Along, factors: int = 0) -> list[Forcing]:
    """Return the best rate for every relation, and for every term that the sine may multiply.

    Args:
        relations: their columns.
        along: what the sine goes with.
        factors: powers in a term that it multiplies, at most; 0: the sine stands alone.
    """
    longest = 1 + max(int(along.place[low:high].max(initial=0)) for low, high in along.runs)
    length = 2 ** int(np.ceil(np.log2(FINE * longest)))
    number = np.arange(length // 2 + 1)
    rate = 2.0 * np.pi * number / (length * along.step)
    width = 2.0 * np.pi / (longest * along.step)
    number = number[(rate > LEAST * width) & (rate < 2.0 * np.pi / (along.least * along.step))]
    found = list[Forcing]()
    for relation, columns in enumerate(relations if len(number) else ()):
        products = _products(columns.values, along.runs)
        alone = float(_left(products[None], TERMS + PRICE)[0])
        if not columns.terms or not alone > 0.0:
            continue
        for beside, weight in _multiplied(columns, factors):
            left = _beside_sines(columns.values, products, along, weight, number, length)
            best = int(np.argmin(left))
            share = 1.0 - float(left[best]) / alone
            found.append(Forcing(along.variable, relation, float(rate[number[best]]), width, share, beside))
    return found


def _multiplied(columns: _Columns, factors: int) -> list[tuple[Term, FloatArray]]:
    """Return the terms of so many powers that a sine may multiply, each with its values; with 0 the sine alone."""
    if factors == 0:
        return [(ONE, np.ones(columns.values.shape[1]))]
    each = zip(columns.terms, columns.values, strict=False)
    return [(t, v) for t, v in each if sum(power for _, power in t.factors) <= factors]


def _beside_sines(
    columns: FloatArray, products: FloatArray, along: _Along, weight: FloatArray, number: IntArray, length: int
) -> FloatArray:
    """Return the squares that terms leave of a target beside sine and cosine of each rate, (rates,).

    Args:
        columns: (k, N), the target last.
        products: (k, k) of these less their means.
        along: what the sines go with.
        weight: (N,) of what they multiply.
        number: (rates,) of each rate in the transform.
        length: of that.
    """
    spectra = _spectra(columns, along, weight, number, length)
    sums = _sums(along, weight, number, length)
    each = max(TOGETHER // len(columns) ** 2, 1)
    parts = np.split(np.arange(len(number)), range(each, len(number), each))
    beside = (_with_sines(products, [s[p] for s in spectra], [[z[p] for z in s] for s in sums]) for p in parts)
    return np.concatenate([_left(part, TERMS) for part in beside])


def _columns(space: SearchSpace) -> list[_Columns]:
    """Return the columns of every relation."""
    found, nothing = [], np.zeros(len(space.mechanisms))
    for relation, target in enumerate(rates(space)):
        products = (p.product for m in space.mechanisms for p in m.parts if p.relation == relation)
        terms = tuple(dict.fromkeys(p.term for p in products if p.factor is None and p.term != ONE))
        found.append(_Columns(terms, np.vstack([*space.evaluated(terms, nothing), target])))
    return found


def _products(columns: FloatArray, runs: tuple[tuple[int, int], ...]) -> FloatArray:
    """Return the inner products of columns (k, N) less their means over every recording, (k, k)."""
    centred = [_centred(columns[:, low:high]) for low, high in runs]
    found: FloatArray = sum((c @ c.T for c in centred), np.zeros((len(columns), len(columns))))
    return found


def _centred(columns: FloatArray) -> FloatArray:
    found: FloatArray = columns - columns.mean(axis=1, keepdims=True)
    return found


def _spectra(
    columns: FloatArray, along: _Along, weight: FloatArray, number: IntArray, length: int
) -> list[NDArray[np.complex128]]:
    """Return the sums of columns (k, N) less their means times weight exp(-i w place), (rates, k) of every run.

    Args:
        columns: of all recordings.
        along: what the sines go with.
        weight: (N,) of what they multiply.
        number: (rates,) of each rate in the transform.
        length: of that.
    """
    # One column at a time: a transform is longer than its columns, and most of its rates are not asked for.
    return [
        np.column_stack(
            [
                _transform(along.place[low:high], weight[low:high] * own, length)[number]
                for own in _centred(columns[:, low:high])
            ]
        )
        for low, high in along.runs
    ]


def _transform(place: IntArray, values: FloatArray, length: int) -> NDArray[np.complex128]:
    """Return the discrete Fourier transform of values (N,) at their places, those at one place together."""
    return np.fft.rfft(np.bincount(place, values, length))


def _sums(along: _Along, weight: FloatArray, number: IntArray, length: int) -> list[Sequence[FloatArray]]:
    """Return the squared lengths cc, ss of cosine and sine less their means, and their product cs, of every run.

    Args:
        along: what the sines go with.
        weight: (N,) of what they multiply.
        number: (rates,) of each rate in the transform.
        length: of that.
    """
    found = list[Sequence[FloatArray]]()
    for low, high in along.runs:
        count, place, own = high - low, along.place[low:high], weight[low:high]
        # Sums over the averages of exp(-i w t) and exp(-2 i w t), from which those of cosines, sines and products.
        once, twice = _transform(place, own, length)[number], _transform(place, own**2, length)[2 * number]
        whole = float(own @ own)
        cc = 0.5 * (whole + twice.real) - once.real**2 / count
        ss = 0.5 * (whole - twice.real) - once.imag**2 / count
        cs = -0.5 * twice.imag + once.real * once.imag / count
        found.append((cc, ss, cs))
    return found


def _with_sines(
    products: FloatArray, spectra: Sequence[NDArray[np.complex128]], sums: Sequence[Sequence[FloatArray]]
) -> FloatArray:
    """Return inner products of what a constant, a sine and a cosine of each run leave of columns, (rates, k, k).

    Args:
        products: (k, k) of the columns less their means.
        spectra: (rates, k) of every run, see `_spectra`.
        sums: (rates,) three of every run, see `_sums`.
    """
    result = np.repeat(products[None], len(spectra[0]), axis=0)
    for (cc, ss, cs), spectrum in zip(sums, spectra, strict=True):
        cosine, sine = spectrum.real, -spectrum.imag
        # Cholesky of [[cc, cs], [cs, ss]]: a cosine of length one, and what it leaves of the sine.
        root = np.sqrt(np.maximum(cc, 1e-300))
        rest = np.maximum(ss - (cs / root) ** 2, 0.0)
        first = cosine / root[:, None]
        second = sine - (cs / root)[:, None] * first
        sound: BoolArray = rest > INDEPENDENT * (cc + ss)
        second = np.where(sound[:, None], second / np.sqrt(np.where(sound, rest, 1.0))[:, None], 0.0)
        for direction in (first, second):
            result -= direction[:, :, None] * direction[:, None, :]
    return result


def _left(products: FloatArray, terms: int) -> FloatArray:
    """Return the squares that a forward selection of so many columns leaves of the last one.

    Args:
        products: inner products of the columns, (cases, k, k).
        terms: to choose.
    """
    here, case = products.copy(), np.arange(len(products))
    sizes = np.diagonal(products, axis1=1, axis2=2)[:, :-1]
    for _ in range(min(terms, sizes.shape[1])):
        rest = np.diagonal(here, axis1=1, axis2=2)[:, :-1]
        told = rest > INDEPENDENT * sizes
        gain = np.where(told, here[:, :-1, -1] ** 2 / np.where(told, rest, 1.0), -1.0)
        chosen = gain.argmax(axis=1)
        row = here[case, chosen] * (gain[case, chosen] > 0.0)[:, None]
        pivot = np.where(gain[case, chosen] > 0.0, here[case, chosen, chosen], 1.0)
        here -= row[:, :, None] * row[:, None, :] / pivot[:, None, None]
    found: FloatArray = np.maximum(here[:, -1, -1], 0.0)
    return found
