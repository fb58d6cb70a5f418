"""The full sweep of a million samples of a hundred candidates, streamed in blocks; a process of its own for its memory.

    ./run python bench/large_sweep.py --samples 1000000

Prints one line of JSON: seconds of the factor (candidates evaluated on the way), of the sweep, and how many supports.
The candidates are products of at most two of 13 signals; no more than a block of their values exists at a time.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from threadpoolctl import threadpool_limits

from odescope.library.candidates import Library
from odescope.library.parse import Scope
from odescope.library.tape import evaluate, write_tape
from odescope.regression.factor import BLOCK_ROWS, factorise, merge
from odescope.regression.proposers import EnergyThreshold
from odescope.selection.sweep import sweep

SIGNALS, CANDIDATES = 13, 100


def signals(samples: int) -> np.ndarray:
    """Return (13, samples): tones whose frequencies have no common measure, noise, and the last a law of the others."""
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, samples * 1e-3, samples)
    values = np.empty((SIGNALS, samples))
    for k in range(SIGNALS - 1):
        values[k] = np.sin(np.sqrt(k + 2.0) * t + k) + 0.1 * rng.standard_normal(samples)
    values[-1] = values[0] - 0.5 * values[1] * values[2] + 0.01 * rng.standard_normal(samples)
    return values


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000)
    options = parser.parse_args()
    names = [f"a{k}" for k in range(SIGNALS)]
    library = Library.of(names, Scope.of(names)).powers(2).products(())[:CANDIDATES]
    tape, columns = write_tape(names, [p.term for p in library]), signals(options.samples)
    proposers, everything = (EnergyThreshold(),), (tuple(range(CANDIDATES)),)

    def blocks(begin: int, end: int) -> Iterator[np.ndarray]:
        for start in range(begin, end, BLOCK_ROWS):
            yield evaluate(tape, np.ascontiguousarray(columns[:, start : min(start + BLOCK_ROWS, end)])).T

    small = factorise(blocks(0, 2 * CANDIDATES))  # kernels are loaded before the clock starts
    sweep(small.restrict(range(5)), library[:5], (tuple(range(5)),), proposers)
    edges = np.linspace(0, options.samples, (os.cpu_count() or 1) + 1).astype(int).tolist()
    with threadpool_limits(1, "blas"):
        begin = time.perf_counter()
        with ThreadPoolExecutor(len(edges) - 1) as pool:
            factor = merge(list(pool.map(lambda a, b: factorise(blocks(a, b)), edges[:-1], edges[1:])))
        factored = time.perf_counter()
        found = sweep(factor, library, everything, proposers)
        swept = time.perf_counter()
    law = tuple(sorted(library.index(t) for t in Library.of(("a0", "a1*a2", "a12"), Scope.of(names)).products(())))
    print(
        json.dumps(
            {
                "factor": factored - begin,
                "sweep": swept - factored,
                "supports": len(found.supports),
                "law": law in found.supports,
            }
        )
    )


if __name__ == "__main__":
    main()
