"""Whether the rate of a quantity follows from what was measured, as it does of an amount, and not of a position."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement
from math import comb

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.checks import order_hints
from odescope.signals.estimate import Signals
from odescope.signals.rates import explained

STRETCHES = 25  # of each record: a transient that is over soon is in several
FOLDS = 5  # of stretches, which are held out in turn
ROWS_A_TERM, MOST_TERMS = 8, 120  # of a polynomial: of more, or of fewer rows, a line has to do
MOST_ROWS = 20_000  # that are fitted
DEGREES = (1, 2, 3)  # products of two are what amounts react by
UNEXPLAINED, FOLLOWS = 0.5, 0.95  # part of a rate that a law of order 1 has to explain more of, one of order 2 at least


def rate_explained(rate: Sequence[FloatArray], values: Sequence[FloatArray]) -> float:
    """Return the part of the variance of a rate that polynomials in measured values explain on stretches held out.

    The rate of an amount is a function of all amounts; a position passes the same place at different speeds. One that
    creeps from one place to another, once and without swinging, looks like an amount. Inputs take no part: under a
    controller, a force is a function of position and speed, and tells the speed.

    Args:
        rate: (n,) of every record.
        values: (c, n) of the quantity and the others, likewise.
    """
    fold = np.concatenate([np.arange(len(r)) * STRETCHES // len(r) % FOLDS for r in rate])
    step = -(-len(fold) // MOST_ROWS)
    target, z, fold = np.concatenate(rate)[::step], np.concatenate(values, axis=1)[:, ::step], fold[::step]
    z = (z - z.mean(axis=1, keepdims=True)) / np.maximum(z.std(axis=1, keepdims=True), 1e-300)
    found = 0.0
    for degree in DEGREES if len(z) > 1 else (1, 3):
        if degree == 1 or comb(len(z) + degree, degree) <= min(len(target) / ROWS_A_TERM, MOST_TERMS):
            found = max(found, explained(target, _held_out(_polynomials(z, degree), target, fold)))
    return found


def order_advice(signals: Signals) -> tuple[str, ...]:
    """Return a sentence for each coordinate of order 1 that moves as a position does, or may be one by its unit."""
    seen = second_order_hints(signals)
    return (*seen.values(), *order_hints([c for c in signals.coordinates if c.name not in seen]))


def second_order_hints(signals: Signals) -> dict[str, str]:
    """Return a sentence, by name, for each coordinate of order 1 that moves as a position does, values and rate."""
    known = [*signals.states, *(i.name for i in signals.inputs)]
    first = [c for c in signals.coordinates if c.order == 1]
    rates = {c.name: [run[signals.row(c.target)] for run in signals.columns] for c in first}
    states = [run[[signals.row(name) for name in known]] for run in signals.columns]
    with_rates = [np.vstack([run, *(rate[k] for rate in rates.values())]) for k, run in enumerate(states)]
    said = dict[str, str]()
    for c in first:
        alone = rate_explained(rates[c.name], states)
        if alone > UNEXPLAINED:
            continue
        again = rate_explained([np.gradient(rate, signals.period) for rate in rates[c.name]], with_rates)
        if again > FOLLOWS:
            said[c.name] = (
                f"what was measured explains {100.0 * max(alone, 0.0):.0f} % of the rate of {c.name}, and together with"
                f" that rate {100.0 * again:.0f} % of the second derivative: {c.name} moves as a position does; give"
                f" order = 2 in [coordinates.{c.name}], or --order 2"
            )
    return said


def _polynomials(z: FloatArray, degree: int) -> FloatArray:
    """Return the products (n, p) of up to so many rows of (c, n), the constant one first."""
    factors = np.vstack([np.ones(z.shape[1]), z])
    chosen = combinations_with_replacement(range(len(factors)), degree)
    return np.column_stack([np.prod(factors[list(k)], axis=0) for k in chosen])


def _held_out(terms: FloatArray, target: FloatArray, fold: FloatArray) -> FloatArray:
    """Return what the terms (n, p) predict of the target (n,) in each fold, fitted to the others."""
    found = np.empty_like(target)
    for k in range(FOLDS):
        out = fold == k
        scale = np.maximum(np.linalg.norm(terms[~out], axis=0), 1e-300)
        found[out] = terms[out] @ (np.linalg.lstsq(terms[~out] / scale, target[~out], rcond=1e-10)[0] / scale)
    return found
