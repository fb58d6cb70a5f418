"""Names of a model as another language takes them: those that it reserves, or cannot spell, are given others."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Names:
    """What a language asks of names.

    Attributes:
        reserved: its keywords, and what the written code uses for itself.
        longest: characters that a name may have.
        underscore: whether a name may begin with one.
    """

    reserved: frozenset[str]
    longest: int = 1000
    underscore: bool = False

    def spelled(self, names: Sequence[str]) -> dict[str, str]:
        """Return by name how each is written; no two alike."""
        taken = {name for name in names if self._fits(name)}
        found = dict[str, str]()
        for name in names:
            found[name] = name if name in taken else self._other(name, taken)
            taken.add(found[name])
        return found

    def _fits(self, name: str) -> bool:
        return name not in self.reserved and len(name) <= self.longest and (self.underscore or not name.startswith("_"))

    def _other(self, name: str, taken: Collection[str]) -> str:
        stem = name if self.underscore or not name.startswith("_") else "v" + name
        other, count = stem, 0
        while other in taken or not self._fits(other):
            count += 1
            ending = "_" if count == 1 else f"_{count}"
            other = stem[: self.longest - len(ending)] + ending
        return other


def renamed(spelling: Mapping[str, str]) -> tuple[str, ...]:
    """Return a line for every name that is not written as it is."""
    return tuple(f"{name} is written {other}" for name, other in spelling.items() if name != other)
