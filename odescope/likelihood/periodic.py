"""A forcing that was not recorded: a sine of the time without which a few terms do not say a target.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.library.expression import ONE
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.smoothed_targets import rates

SHARE = 0.4  # least share of what terms leave of a target that goes with a sine
TERMS = 5  # of a relation, beside the sine
PRICE = 3  # terms more that stand for sine, cosine and their rate where there are none
LEAST = 3.0  # periods in the longest recording
FINE = 4  # times as fine as one more period in that recording are the rates that are compared
DENSE = 8  # averages in a period, at least
TOGETHER = 2**22  # numbers in memory at once
INDEPENDENT = 1e-7  # share of a column that those chosen before do not say


@dataclass(frozen=True)
class Forcing:
    """A rate in rad/s of what is lacking in a relation, known to within `width`, and its share of what terms leave."""

    relation: int
    rate: float
    width: float
    share: float


def periodic(space: SearchSpace) -> Forcing | None:
    """Return the rate at which a sine helps the terms of a relation most, None where none clearly does.

    At every rate that a record resolves sine and cosine are given, each recording with a phase of its own, and a
    forward selection takes terms of the relation beside them; it is compared with one without.
    """
    segments = space.segments
    longest = max(high - low for low, high in segments.runs)
    length = 2 ** int(np.ceil(np.log2(FINE * longest)))
    number = np.arange(length // 2 + 1)
    rate = 2.0 * np.pi * number / (length * segments.step)
    width = 2.0 * np.pi / (longest * segments.step)
    number = number[(rate > LEAST * width) & (rate < 2.0 * np.pi / (DENSE * segments.step))]
    turns, counts = 2.0 * np.pi * number / length, [high - low for low, high in segments.runs]
    found = list[Forcing]()
    for relation, columns in enumerate(_columns(space) if len(number) else ()):
        if len(columns) > 1:
            each = max(TOGETHER // len(columns) ** 2, 1)
            parts = np.split(np.arange(len(number)), range(each, len(number), each))
            products, spectra = _products(columns, segments.runs), _spectra(columns, segments.runs, number, length)
            beside = (_with_sines(products, [s[part] for s in spectra], counts, turns[part]) for part in parts)
            left = np.concatenate([_left(part, TERMS) for part in beside])
            alone = _left(products[None], TERMS + PRICE)[0]
            best = int(np.argmin(left))
            if alone > 0.0:
                found.append(
                    Forcing(relation, float(rate[number[best]]), width, 1.0 - float(left[best]) / float(alone))
                )
    clearest = max(found, key=lambda forcing: forcing.share, default=None)
    return clearest if clearest is not None and clearest.share > SHARE else None


def _columns(space: SearchSpace) -> list[FloatArray]:
    """Return the plain terms of every relation at the smoothed states and its target last, (terms + 1, N)."""
    found, nothing = [], np.zeros(len(space.mechanisms))
    for relation, target in enumerate(rates(space)):
        products = (p.product for m in space.mechanisms for p in m.parts if p.relation == relation)
        terms = dict.fromkeys(p.term for p in products if p.factor is None and p.term != ONE)
        found.append(np.vstack([*space.evaluated([*terms], nothing), target]))
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
    columns: FloatArray, runs: tuple[tuple[int, int], ...], number: IntArray, length: int
) -> list[NDArray[np.complex128]]:
    """Return the discrete Fourier transform of columns (k, N) less their means, (rates, k) of every recording.

    Args:
        columns: of all recordings.
        runs: where each recording begins and ends in them.
        number: (rates,) of each rate in the transform.
        length: of that.
    """
    # One column at a time: a transform is longer than its columns, and most of its rates are not asked for.
    return [
        np.column_stack([np.fft.rfft(own, length)[number] for own in _centred(columns[:, low:high])])
        for low, high in runs
    ]


def _with_sines(
    products: FloatArray, spectra: Sequence[NDArray[np.complex128]], counts: Sequence[int], turns: FloatArray
) -> FloatArray:
    """Return inner products of what a constant, a sine and a cosine of each recording leave of columns, (rates, k, k).

    Args:
        products: (k, k) of the columns less their means.
        spectra: (rates, k) of every recording, see `_spectra`.
        counts: averages of every recording.
        turns: (rates,) radians from one average to the next.
    """
    result = np.repeat(products[None], len(turns), axis=0)
    for count, spectrum in zip(counts, spectra, strict=True):
        cosine, sine = spectrum.real, -spectrum.imag
        # Sums over the samples of exp(-i w t) and exp(-2 i w t), from which those of cosines, sines and products.
        once, twice = (np.exp(-1j * k * turns) for k in (1, 2))
        once, twice = ((1.0 - z**count) / (1.0 - z) for z in (once, twice))
        cc = 0.5 * (count + twice.real) - once.real**2 / count
        ss = 0.5 * (count - twice.real) - once.imag**2 / count
        cs = -0.5 * twice.imag + once.real * once.imag / count
        # Cholesky of [[cc, cs], [cs, ss]]: a cosine of length one, and what it leaves of the sine.
        root = np.sqrt(np.maximum(cc, 1e-300))
        rest = np.maximum(ss - (cs / root) ** 2, 0.0)
        first = cosine / root[:, None]
        second = sine - (cs / root)[:, None] * first
        sound: BoolArray = rest > INDEPENDENT * count
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
