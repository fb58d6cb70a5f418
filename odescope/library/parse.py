"""Terms from text, by a whitelisting walk over Python's syntax tree: nothing that is read is ever evaluated."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from odescope.errors import InputError, nearest
from odescope.library.expression import Atom, Call, Combination, Name, Power, Term
from odescope.library.extremes import EXTREMES, Extreme
from odescope.library.functions import FUNCTIONS

MAXIMUM_LENGTH = 1000
MAXIMUM_DEPTH = 100
MAXIMUM_POWER = 16
_HEAD = re.compile(r"\s*([A-Za-z_]\w*)\s*\(\s*([A-Za-z_]\w*(?:\s*,\s*[A-Za-z_]\w*)*)\s*\)\s*", re.ASCII)


@dataclass(frozen=True)
class Definition:
    """A function of one's own: `Definition("drag", ("v",), "abs(v)*v")`; wherever it is used, its body stands."""

    name: str
    parameters: tuple[str, ...]
    body: str

    @staticmethod
    def of(head: str, body: str) -> Definition:
        """Return the definition of a function from its head, such as "drag(v)", and its body.

        Raises:
            InputError: the head is no name with arguments.
        """
        spelled = _HEAD.fullmatch(head)
        if spelled is None:
            raise InputError(f'[library.functions] wants "name(argument, ...)" = "expression"; {head!r} came')
        return Definition(spelled[1], tuple(p.strip() for p in spelled[2].split(",")), body)


@dataclass(frozen=True)
class Scope:
    """What a text may name: states, targets and inputs, and definitions beside the built-in functions.

    `constants` are names too, of numbers that are looked for; None where there can be none. `read` holds the terms that
    were read, by their texts: rules read theirs for every product of a library.
    """

    names: frozenset[str]
    definitions: Mapping[str, Definition]
    constants: frozenset[str] | None = None
    read: dict[str, Term] = field(default_factory=dict, init=False, repr=False, compare=False)

    @staticmethod
    def of(
        names: Collection[str], definitions: Collection[Definition] = (), constants: Collection[str] | None = None
    ) -> Scope:
        """Return a scope.

        Args:
            names: of states, targets and inputs.
            definitions: functions of one's own.
            constants: names of numbers that are looked for; None where there can be none.

        Raises:
            InputError: a definition takes the name of a built-in function, a variable or another definition, or names a
                parameter twice.
        """
        for d in definitions:
            if sum(d.name == other.name for other in definitions) > 1:
                raise InputError(f"the function {d.name!r} is defined twice")
            if len(set(d.parameters)) < len(d.parameters):
                raise InputError(f"the function {d.name!r} has two parameters of one name")
            if d.name in {*FUNCTIONS, *EXTREMES, *names, "identity"}:
                raise InputError(f"the function {d.name!r} cannot be defined: that name is taken; choose another")
        numbers = None if constants is None else frozenset(constants)
        return Scope(frozenset(names) | (numbers or frozenset()), {d.name: d for d in definitions}, numbers)


def parse_term(text: str, scope: Scope) -> Term:
    """Return the term that `text` spells: a product of powers of names and known functions.

    Raises:
        InputError: the text is too long or too deep, is no such product, or names something unknown.
    """
    if text in scope.read:
        return scope.read[text]
    combination = _Walk(text, scope, {}).whole()
    if len(combination.parts) != 1 or combination.parts[0][0] != 1.0:
        raise _refused(
            text,
            "a term is one product of known functions, without sums or numbers, such as phi_dot**2*sin(phi); a sum in"
            " brackets to a power stands for one, as (abs(x + y) - abs(x))**1 does",
        )
    term = combination.parts[0][1]
    if term.text != text:
        # What a model file will hold must read back: powers add up and chains grow on the way to canonical order.
        _Walk(term.text, Scope(scope.names, {}, scope.constants), {}).whole()
    scope.read[text] = term
    return term


def parse_combination(text: str, scope: Scope) -> Combination:
    """Return the linear combination of products that `text` spells, such as `1 + tan(z)**2`.

    Raises:
        InputError: the text is too long or too deep, is no such combination, or names something unknown.
    """
    return _Walk(text, scope, {}).whole()


def _refused(text: str, why: str) -> InputError:
    shown = text if len(text) <= 60 else text[:57] + "..."
    return InputError(f"cannot read the term {shown!r}: {why}")


class _Walk:
    """One walk over one text; `values` are the arguments that stand for names in the body of a definition."""

    def __init__(self, text: str, scope: Scope, values: Mapping[str, Combination]) -> None:
        self.text, self.scope, self.values = text, scope, values

    def fail(self, why: str) -> InputError:
        return _refused(self.text, why)

    def whole(self) -> Combination:
        if len(self.text) > MAXIMUM_LENGTH:
            raise self.fail(f"it has {len(self.text)} characters, more than the {MAXIMUM_LENGTH} allowed")
        if not self.text.isascii():
            # Python reads other letters as their plain look-alikes, so that two texts would name one thing.
            raise self.fail("it has a character that is not ASCII")
        try:
            tree = ast.parse(self.text.strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise self.fail("it is not an expression in Python syntax, or nested too deep") from error
        return self.node(tree.body, 0)

    def node(self, node: ast.AST, depth: int) -> Combination:
        if depth > MAXIMUM_DEPTH:
            raise self.fail(f"it is nested deeper than {MAXIMUM_DEPTH}")
        combination = self.combination(node, depth)
        # A product with a sum and a definition repeat what they are given: nested, they would grow without bound.
        if len(combination.text) > MAXIMUM_LENGTH:
            raise self.fail(f"written out, it has more than the {MAXIMUM_LENGTH} characters allowed")
        return combination

    def combination(self, node: ast.AST, depth: int) -> Combination:
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return Combination.of([(self.number(value), Term())])
            case ast.Name(id=name):
                if name not in self.scope.names:
                    known = f"no state or input is called {name!r}; {nearest(name, sorted(self.scope.names))}"
                    said = self.declaring(name)
                    raise self.fail(f"{known}{'.' if said and not known.endswith('?') else ''}{said}")
                return self.values.get(name, _lone(Name(name)))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return Combination.of([(-c, t) for c, t in self.node(operand, depth + 1).parts])
            case ast.BinOp(op=ast.Add() | ast.Sub() as op, left=left, right=right):
                sign = 1.0 if isinstance(op, ast.Add) else -1.0
                first, second = self.node(left, depth + 1), self.node(right, depth + 1)
                return Combination.of([*first.parts, *((sign * c, t) for c, t in second.parts)])
            case ast.BinOp(op=ast.Mult(), left=left, right=right):
                return self.product(self.node(left, depth + 1), self.node(right, depth + 1))
            case ast.BinOp(op=ast.Div(), left=left, right=right):
                return self.product(self.node(left, depth + 1), self.below(right, depth + 1))
            case ast.BinOp(op=ast.Pow(), left=left, right=right):
                return self.raised(self.node(left, depth + 1), right)
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
                return self.call(name, [self.node(a, depth + 1) for a in args])
            case ast.BinOp(op=ast.BitXor()):
                raise self.fail("a power is written with two stars: x**3, not x^3")
        raise self.fail("only names, numbers, + - * / ** and known functions may appear")

    def below(self, node: ast.AST, depth: int) -> Combination:
        """Return the reciprocal of a denominator, factor by factor: sums stay apart, as in 1/((a + x)*(b + y))."""
        match node:
            case ast.BinOp(op=ast.Mult(), left=left, right=right):
                return self.product(self.below(left, depth + 1), self.below(right, depth + 1))
            case _:
                return self.power(self.node(node, depth), -1)

    def declaring(self, name: str) -> str:
        """Return how to declare a name as an input or as a constant, where there can be some."""
        if self.scope.constants is None:
            return ""
        return (
            f" If {name} was recorded, name it as an input, --input {name} or [inputs.{name}] in a study; if it is a"
            " constant that is looked for, say in what range:\n\n    [library.parameters]\n"
            f'    {name} = [0.1, 10.0]    # or {name} = "scale", for a range from the data'
        )

    def number(self, value: float) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number) or abs(number) > 1e100:
            raise self.fail("a number in it is too large")
        return number

    def product(self, first: Combination, second: Combination) -> Combination:
        for one, other in ((first, second), (second, first)):
            if len(one.parts) == 1:
                ((c, t),) = one.parts
                return Combination.of([(self.number(c * k), t * u) for k, u in other.parts])
        if not first.parts or not second.parts:
            raise self.fail("it has a factor that is zero")
        raise self.fail("a product of sums is no product of known functions; write its terms one by one")

    def raised(self, base: Combination, exponent: ast.AST) -> Combination:
        sign = 1.0
        if isinstance(exponent, ast.UnaryOp) and isinstance(exponent.op, ast.USub):
            exponent, sign = exponent.operand, -1.0
        if isinstance(exponent, ast.Name) and exponent.id in (self.scope.constants or ()):
            return self.raised_to(base, exponent.id, sign)
        value = exponent.value if isinstance(exponent, ast.Constant) else None
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self.fail("an exponent must be a plain number")
        power = sign * self.number(value)
        if abs(power) > MAXIMUM_POWER or power == 0:
            raise self.fail(f"the exponent {power:g} is outside 1 to {MAXIMUM_POWER} in size")
        return self.power(base, int(power) if power.is_integer() else power)

    def raised_to(self, base: Combination, constant: str, sign: float) -> Combination:
        """Return a positive base to the power of a constant: x**n as exp(n*log(x))."""
        if not base.names:
            raise self.fail("a number to the power of a constant is another constant")
        ((c, t),) = _lone(Call("log", base)).parts
        return _lone(Call("exp", Combination(((sign * c, Term.of([(Name(constant), 1), *t.factors])),))))

    def power(self, base: Combination, power: Power) -> Combination:
        if not base.parts:
            raise self.fail("it has a power of zero")
        if len(base.parts) > 1:
            return _lone(Call("", base), power)
        ((c, t),) = base.parts
        if abs(power * math.log(abs(c))) > 200 or (c < 0 and not isinstance(power, int)):
            raise self.fail("a number in it is raised too high, or is negative under a fractional power")
        whole = [p for _, p in t.factors if isinstance(p, int)]
        if not isinstance(power, int) and (any(p % 2 == 0 for p in whole) or len(whole) > 1):
            raise self.fail("a fractional power of a product loses signs, as (x**2)**0.5 is abs(x); write abs or sqrt")
        factors = [(atom, p * power) for atom, p in t.factors]
        if any(abs(p) > MAXIMUM_POWER for _, p in factors):
            raise self.fail(f"an exponent in it exceeds {MAXIMUM_POWER}")
        return Combination(((c**power, Term.of(factors)),))

    def call(self, name: str, arguments: list[Combination]) -> Combination:
        definition = self.scope.definitions.get(name)
        if definition is not None:
            return self.expand(definition, arguments)
        if name in EXTREMES:
            return self.extreme(name, arguments)
        if name not in FUNCTIONS and name != "identity":
            known = [*FUNCTIONS, *EXTREMES, "identity", *self.scope.definitions]
            raise self.fail(f"there is no function {name!r}; {nearest(name, known)}")
        if len(arguments) != 1:
            raise self.fail(f"{name} takes one argument, {len(arguments)} came")
        (argument,) = arguments
        if not argument.names:
            raise self.fail(f"the argument of {name} is a constant")
        if name == "identity":
            return argument if len(argument.parts) == 1 else _lone(Call("", argument))
        return _lone(Call(name, argument))

    def extreme(self, name: str, arguments: list[Combination]) -> Combination:
        if len(arguments) != 2:
            raise self.fail(f"{name} takes two arguments, {len(arguments)} came")
        extreme = Extreme.of(name, *arguments)
        if not extreme.difference.names:
            raise self.fail(f"the arguments of {name} differ by no variable")
        return _lone(Call("", extreme.total))

    def expand(self, definition: Definition, arguments: list[Combination]) -> Combination:
        if len(arguments) != len(definition.parameters):
            raise self.fail(f"{definition.name} takes {len(definition.parameters)} arguments, {len(arguments)} came")
        if not all(a.parts for a in arguments):
            raise self.fail(f"an argument of {definition.name} is zero")
        atoms = [a if len(a.parts) == 1 else _lone(Call("", a)) for a in arguments]
        values = dict(zip(definition.parameters, atoms, strict=True))
        full = _Walk(definition.body, Scope(frozenset(definition.parameters), {}), values).whole()
        return full if len(full.parts) == 1 else _lone(Call("", full))


def _lone(atom: Atom, power: Power = 1) -> Combination:
    return Combination(((1.0, Term(((atom, power),))),))
