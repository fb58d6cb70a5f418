"""Terms as LaTeX."""

from __future__ import annotations

from collections.abc import Iterable

from odescope.library.expression import Power
from odescope.library.functions import FUNCTIONS
from odescope.library.names import is_greek, split_name
from odescope.library.printer import Language


def latex_name(name: str) -> str:
    r"""Return LaTeX of a state, target or input: `phi1_ddot` becomes \ddot{\phi}_{1}."""
    stem, index, order = split_name(name)
    stem, index = stem.replace("_", r"\_"), index.replace("_", r"\_")
    body = f"\\{stem}" if is_greek(stem) else stem if len(stem) == 1 else rf"\mathrm{{{stem}}}"
    if order:
        body = rf"\{'d' * order}ot{{{body}}}" if order <= 4 else rf"{{{body}}}^{{({order})}}"
    return body + (f"_{{{index}}}" if index else "")


def latex_sum(parts: Iterable[tuple[float, str]], digits: int = 6) -> str:
    """Return LaTeX of a signed sum of coefficient and text, coefficients to `digits` significant digits."""
    bodies = list[tuple[bool, str]]()
    for coefficient, text in parts:
        size = latex_number(f"{abs(coefficient):.{digits}g}")
        bodies.append((coefficient < 0, size if text == "1" else text if size == "1" else rf"{size} \, {text}"))
    return latex_joined(bodies)


def latex_joined(bodies: Iterable[tuple[bool, str]]) -> str:
    """Return LaTeX of a sum of bodies, each with whether it is negative."""
    out = ""
    for negative, body in bodies:
        out += (("-" if negative else "") if not out else (" - " if negative else " + ")) + body
    return out or "0"


def latex_number(text: str) -> str:
    """Return LaTeX of a number as Python writes it."""
    if "e" not in text:
        return text
    mantissa, exponent = text.split("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}"


def latex_fraction(numerator: str, denominator: str) -> str:
    """Return LaTeX of a fraction."""
    return rf"\frac{{{numerator}}}{{{denominator}}}"


def _name(name: str, power: Power) -> str:
    body = latex_name(name)
    return body if power == 1 else rf"{{{body}}}^{{{power}}}"


def _call(function: str, argument: str, power: Power) -> str:
    if function == "sqrt":
        return rf"\sqrt{{{argument}}}" if power == 1 else rf"\left({argument}\right)^{{{_halved(power)}}}"
    if function == "abs":
        return rf"\left|{argument}\right|{_up(power)}"
    return rf"{FUNCTIONS[function].latex}{_up(power)}\left({argument}\right)"


def _halved(power: Power) -> str:
    """Return half of a power, as a fraction where it is of a whole number."""
    return f"{power:g}/2" if power % 2 else f"{power / 2:g}"


def _up(power: Power) -> str:
    return "" if power == 1 else f"^{{{power}}}"


LATEX = Language(
    name=_name,
    call=_call,
    group=lambda inside, power: rf"\left({inside}\right){_up(power)}",
    product=lambda factors: r" \, ".join(factors) or "1",
    sum=latex_sum,
    fraction=latex_fraction,
    extreme=lambda name, first, second, power: rf"\{name}{_up(power)}\left({first}, \, {second}\right)",
)
