"""What a name is made of, for those who typeset it: Greek letters, indices, derivatives."""

from __future__ import annotations

import re

# fmt: off
_GREEK = frozenset([
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu",
    "xi", "pi", "rho", "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda",
    "Xi", "Pi", "Sigma", "Upsilon", "Phi", "Psi", "Omega",
])
# fmt: on
_DERIVED = re.compile(r"^(?P<base>.+)_(?P<order>d+)ot$")


def is_greek(stem: str) -> bool:
    """Say whether a name is that of a Greek letter."""
    return stem in _GREEK


def split_name(name: str) -> tuple[str, str, int]:
    """Return what a name is made of, stem, index and order of the derivative: `phi1_ddot` is phi, 1 and 2.

    A derivative whose stem is a word stays in one piece: dots over the middle of a word are overlooked.
    """
    derived = _DERIVED.match(name)
    base, order = (derived["base"], len(derived["order"])) if derived else (name, 0)
    stem, _, index = base.partition("_")
    if not (stem and index):
        stem, index = base, ""
    digits = re.match(r"^([A-Za-z]+)(\d+)$", stem)
    if digits:
        stem, index = digits[1], ",".join(filter(None, (digits[2], index)))
    if order and len(stem) > 1 and not is_greek(stem):
        return name, "", 0
    return stem, index, order
