"""Sentences on candidates that were left out because these data cannot tell them from others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

TOLD = 6  # candidates
NAMED = 8  # terms of a combination


def left_out_sentences(dependent: Sequence[tuple[str, Sequence[str]]]) -> Iterator[str]:
    """Yield what these data cannot tell from what; of many candidates the first, and how many more there are.

    Args:
        dependent: every candidate that was left out of a library, with those it is a combination of.
    """
    said = list(dict.fromkeys(_sentence(term, tuple(others)) for term, others in dependent))
    yield from said[:TOLD]
    if len(said) > TOLD:
        yield f"and {len(said) - TOLD} more candidates that are combinations of others: see the report"


def _sentence(term: str, others: Sequence[str]) -> str:
    if others == ("1",):
        return f"{term} is constant in these data"
    if len(others) == 1:
        return f"these data cannot tell {term} from {others[0]}: they are in proportion"
    more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
    return f"these data cannot tell {term} from a combination of {', '.join(others[:NAMED])}{more}"
