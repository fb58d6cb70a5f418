"""Terms as a person would type them: a quotient with a bar, x**n where the exponent is a constant, max(x - c, 0)."""

from __future__ import annotations

import re
from collections.abc import Iterable

from odescope.library.expression import Atom, Call, Combination, Name, Power, Term, signed_sum
from odescope.library.extremes import Extreme

_FIRST_POWER = re.compile(r"\)\*\*1(?![\d.])")


def readable(term: Term) -> str:
    """Return a term as text that reads back as the same: x_dot/v0 for v0**-1*x_dot, x**n for exp(n*log(x))."""
    # Without a power a sum would be multiplied out when it is read back.
    top = [
        _raised(atom, power) + ("**1" if power == 1 and _is_sum(atom) else "")
        for atom, power in term.factors
        if power > 0
    ]
    bottom = [_raised(atom, -power) for atom, power in term.factors if power < 0]
    below = "*".join(bottom)
    over = f"/({below})" if len(bottom) > 1 else f"/{below}" if bottom else ""
    return ("*".join(top) or "1") + over


def displayed(term: Term) -> str:
    """Return a term as people are shown it: as `readable` has it, with no power that only keeps a sum together."""
    return without_first_powers(readable(term))


def without_first_powers(text: str) -> str:
    """Return what `readable` gave without the powers that only keep sums together, (1 - x)*y for (1 - x)**1*y."""
    return _FIRST_POWER.sub(")", text)


def _raised(atom: Atom, power: Power) -> str:
    if isinstance(atom, Name):
        body = atom.name
    elif atom.function == "exp" and (found := _exponential(atom.argument)) is not None:
        body = found if power == 1 else f"({found})"
    elif not atom.function and (larger := _extreme(atom.argument)) is not None:
        body = larger
    else:
        body = f"{atom.function}({_argument(atom.argument)})"
    return body if power == 1 else f"{body}**{power}"


def _is_sum(atom: Atom) -> bool:
    """Say whether an atom is a sum in brackets."""
    return isinstance(atom, Call) and not atom.function and _extreme(atom.argument) is None


def _extreme(argument: Combination) -> str | None:
    """Return max(a, b) or min(a, b) for what one of them is written out as, None for another sum."""
    found = Extreme.read(argument)
    if found is None:
        return None
    first, second = (sorted(c.parts, key=lambda part: part[0] < 0.0) for c in (found.first, found.second))
    return f"{found.name}({_sum(first)}, {_sum(second) if second else 0})"


def _sum(parts: Iterable[tuple[float, Term]]) -> str:
    return signed_sum(((c, readable(t)) for c, t in parts), inverse=True)


def _argument(argument: Combination) -> str:
    """Return the argument of a function; what divides all of a sum stands below it once, as in (y - x)/s."""
    dividing = [{f for f in t.factors if isinstance(f[0], Name) and f[1] == -1} for _, t in argument.parts]
    below = set[tuple[Atom, Power]]().union(*dividing[:1]).intersection(*dividing)
    if len(dividing) < 2 or len(below) != 1:
        return _sum(argument.parts)
    above = [(c, Term(tuple(f for f in t.factors if f not in below))) for c, t in argument.parts]
    above.sort(key=lambda part: part[0] < 0.0)
    return f"({signed_sum((c, readable(t)) for c, t in above)})/{next(iter(below))[0].text}"


def _exponential(argument: Combination) -> str | None:
    """Return x**n for the argument n*log(x) of an exponential, x**(-n) for -n*log(x), None for another."""
    if len(argument.parts) != 1 or abs(argument.parts[0][0]) != 1.0:
        return None
    logarithms = [a for a, p in argument.parts[0][1].factors if isinstance(a, Call) and a.function == "log" and p == 1]
    exponents = [a for a, p in argument.parts[0][1].factors if isinstance(a, Name) and p == 1]
    if len(logarithms) != 1 or len(exponents) != 1 or len(argument.parts[0][1].factors) != 2:
        return None
    inner = logarithms[0].argument
    alone = len(inner.parts) == 1 and inner.parts[0][0] == 1.0
    base = readable(inner.parts[0][1]) if alone else signed_sum((c, readable(t)) for c, t in inner.parts)
    factors = inner.parts[0][1].factors if alone else ()
    single = len(factors) == 1 and factors[0][1] == 1 and (isinstance(factors[0][0], Name) or factors[0][0].function)
    power = exponents[0].name if argument.parts[0][0] > 0.0 else f"(-{exponents[0].name})"
    return f"{base if single else f'({base})'}**{power}"
