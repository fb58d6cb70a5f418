"""Sentences on candidates that were left out because these data cannot tell them from others."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

TOLD = 6  # candidates
NAMED = 8  # terms of a combination
_NAME = re.compile(r"[A-Za-z_]\w*")


def left_out_sentences(dependent: Sequence[tuple[str, Sequence[str]]], constant: Sequence[str] = ()) -> Iterator[str]:
    """Yield what these data cannot tell from what; of many candidates the first, and how many more there are.

    Args:
        dependent: every candidate that was left out of a library, with those it is a combination of.
        constant: sums that stay constant in the data, which make combinations of all that holds their names.
    """
    names = {name for total in constant for name in _NAME.findall(total)}
    by_sums = dict.fromkeys(
        term for term, others in dependent if len(others) > 1 and not names.isdisjoint(_NAME.findall(term))
    )
    said = list(dict.fromkeys(_sentence(term, others) for term, others in dependent if term not in by_sums))
    if by_sums:
        first, *more = by_sums
        what = f"{first} and {len(more)} more candidates are" if more else f"{first} is"
        stay = "stays" if len(constant) == 1 else "stay"
        said.append(f"{what} left out: while {' and '.join(constant)} {stay} constant, others say the same")
    yield from said[:TOLD]
    if len(said) > TOLD:
        yield f"and {len(said) - TOLD} more candidates that are combinations of others: see the report"


def _sentence(term: str, others: Sequence[str]) -> str:
    if list(others) == ["1"]:
        return f"{term} is constant in these data"
    if len(others) == 1:
        return f"these data cannot tell {term} from {others[0]}: they are in proportion"
    more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
    return f"these data cannot tell {term} from a combination of {', '.join(others[:NAMED])}{more}"
