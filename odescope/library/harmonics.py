"""Sines and cosines of sums and differences of angles: no identity such as sin**2 + cos**2 = 1 holds among them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations_with_replacement, product


def harmonics(angles: Sequence[str], degree: int) -> Iterator[tuple[str, ...]]:
    """Yield the cosines and sines of k.q, k whole numbers over the angles with sum |k| = degree; nothing for 1.

    Of each pair k and -k there is one.

    Args:
        angles: their names.
        degree: see above.
    """
    if degree == 0:
        yield ()
    for chosen in combinations_with_replacement(angles, degree):
        multiples = list(Counter(chosen).items())
        for signs in product((1, -1), repeat=max(0, len(multiples) - 1)) if multiples else ():
            argument = _multiple(*multiples[0])
            for sign, (angle, k) in zip(signs, multiples[1:], strict=True):
                argument += (" + " if sign > 0 else " - ") + _multiple(angle, k)
            yield (f"cos({argument})",)
            yield (f"sin({argument})",)


def _multiple(angle: str, k: int) -> str:
    return angle if k == 1 else f"{k}*{angle}"
