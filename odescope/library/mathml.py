"""Terms as MathML.

Presentation MathML that reads back without guessing: factors are joined by an invisible times, a function and its
argument by the sign for application, so that a program (or a voice) finds the same value as the eye.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from html import escape

from odescope.library.expression import Power
from odescope.library.names import is_greek, split_name
from odescope.library.printer import Language

TIMES = '<mo lspace="0.08em" rspace="0.08em">&#x2062;</mo>'
APPLY, MINUS = "<mo>&#x2061;</mo>", "<mo>−</mo>"
ACCENTS = {1: "˙", 2: "¨"}
_ONE = "<mn>1</mn>"
_MARKUP = re.compile(r"<[^>]*>|&#x206.;")
LINE = 66  # characters, about, of one line of a sum: more would not fit a printed page


def mathml_name(name: str) -> str:
    """Return MathML of a state, target or input: `phi1_ddot` becomes a phi with two dots and the index 1."""
    stem, index, order = split_name(name)
    body = f"<mi>{escape(_letter(stem))}</mi>"
    if order in ACCENTS:
        # Not accent="true": without a mathematical font the dots would then fall into the letter.
        body = f"<mover>{body}<mo>{ACCENTS[order]}</mo></mover>"
    if index:
        body = f"<msub>{body}<mtext>{escape(index)}</mtext></msub>"
    if order and order not in ACCENTS:
        body = f"<msup>{body}<mrow><mo>(</mo><mn>{order}</mn><mo>)</mo></mrow></msup>"
    return body


def mathml_number(text: str) -> str:
    """Return MathML of a number that is not negative, as Python writes it."""
    if "e" not in text:
        return f"<mn>{text}</mn>"
    mantissa, exponent = text.split("e")
    power = int(exponent)
    return f"<mn>{mantissa}</mn><mo>×</mo><msup><mn>10</mn>{_exponent(power)}</msup>"


def mathml_sum(parts: Iterable[tuple[float, str]], digits: int = 6) -> str:
    """Return MathML of a signed sum of coefficient and MathML, to `digits` significant digits, over lines if long."""
    bodies = list[tuple[bool, str]]()
    for coefficient, product in parts:
        size = mathml_number(f"{abs(coefficient):.{digits}g}")
        body = size if product == _ONE else product if size == _ONE else size + TIMES + product
        bodies.append((coefficient < 0, body))
    return mathml_joined(bodies)


def mathml_joined(bodies: Iterable[tuple[bool, str]], line: int = LINE) -> str:
    """Return MathML of a sum of bodies, each with whether it is negative, over lines of so many characters if long."""
    rows: list[list[str]] = [[]]
    width = 0
    for negative, body in bodies:
        sign = MINUS if negative else "<mo>+</mo>" if any(rows) else ""
        length = written_length(body) + 3
        if rows[-1] and width + length > line:
            rows.append([])
            width = 0
        rows[-1].append(sign + body)
        width += length
    if len(rows) == 1:
        return f"<mrow>{''.join(rows[0]) or '<mn>0</mn>'}</mrow>"
    lines = "".join(f'<mtr><mtd columnalign="left"><mrow>{"".join(row)}</mrow></mtd></mtr>' for row in rows)
    return f'<mtable class="lines">{lines}</mtable>'


def written_length(body: str) -> int:
    """Return about how many characters of MathML are seen."""
    return len(_MARKUP.sub("", body))


def mathml_fraction(numerator: str, denominator: str) -> str:
    """Return MathML of a fraction."""
    return f"<mfrac>{numerator}{denominator}</mfrac>"


def math(body: str) -> str:
    """Return MathML elements as one displayed formula."""
    return f'<math xmlns="http://www.w3.org/1998/Math/MathML" display="block"><mrow>{body}</mrow></math>'


def _letter(stem: str) -> str:
    if not is_greek(stem):
        return stem
    case = "CAPITAL" if stem[0].isupper() else "SMALL"
    return unicodedata.lookup(f"GREEK {case} LETTER {'LAMDA' if stem.lower() == 'lambda' else stem.upper()}")


def _exponent(power: Power) -> str:
    return f"<mn>{power}</mn>" if power >= 0 else f"<mrow>{MINUS}<mn>{-power}</mn></mrow>"


def _raised(body: str, power: Power) -> str:
    return body if power == 1 else f"<msup>{body}{_exponent(power)}</msup>"


def _name(name: str, power: Power) -> str:
    body = mathml_name(name)
    return body if power == 1 else _raised(f"<mrow>{body}</mrow>", power)


def _call(function: str, argument: str, power: Power) -> str:
    if function == "sqrt":
        return f"<msqrt>{argument}</msqrt>" if power == 1 else _halved(argument, power)
    head = f"<mi>{escape(function)}</mi>"
    return f"<mrow>{_raised(head, power)}{APPLY}{_bracketed(argument)}</mrow>"


def _halved(argument: str, power: Power) -> str:
    """Return what is under a root, raised to half of the root's power."""
    if power % 2 == 0:
        return _raised(_bracketed(argument), int(power / 2))
    half = mathml_fraction(f"<mn>{power:g}</mn>", "<mn>2</mn>")
    return f"<msup>{_bracketed(argument)}{half}</msup>"


def _bracketed(body: str) -> str:
    return f"<mrow><mo>(</mo>{body}<mo>)</mo></mrow>"


MATHML = Language(
    name=_name,
    call=_call,
    group=lambda inside, power: _raised(_bracketed(inside), power),
    product=lambda factors: TIMES.join(factors) or _ONE,
    sum=mathml_sum,
    fraction=lambda over, under: mathml_fraction(f"<mrow>{over}</mrow>", f"<mrow>{under}</mrow>"),
    extreme=lambda name, first, second, power: _call(name, f"{first}<mo>,</mo>{second}", power),
)
