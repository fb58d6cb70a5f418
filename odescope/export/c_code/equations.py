"""The relations of a model and their derivatives as C statements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from odescope.export.spelling import Names
from odescope.library.derivative import slope
from odescope.library.expression import Combination, Power, signed_sum
from odescope.library.printer import Language, print_combination
from odescope.model.model import Model
from odescope.model.switches import WithoutSigns

_KEYWORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while asm fortran typeof
alignas alignof bool constexpr false nullptr static_assert thread_local true typeof_unqual and and_eq bitand bitor compl
not not_eq or or_eq xor xor_eq catch class const_cast decltype delete dynamic_cast explicit export friend mutable
namespace new noexcept operator private protected public reinterpret_cast static_cast template this throw try typeid
typename using virtual wchar_t linux unix i386 far near interrupt
"""
_MATHEMATICS = """
acos asin atan atan2 cos sin tan cosh sinh tanh acosh asinh atanh exp frexp ldexp log log10 modf exp2 expm1 ilogb log1p
log2 logb scalbn scalbln cbrt fabs hypot pow sqrt erf erfc lgamma tgamma ceil floor nearbyint rint lrint llrint lround
llround round trunc fmod remainder remquo copysign nan nextafter nexttoward fdim fmax fmin fma isfinite isinf isnan
isnormal signbit fpclassify isgreater isgreaterequal isless islessequal islessgreater isunordered signgam gamma j0 j1 jn
y0 y1 yn drem significand NAN INFINITY HUGE_VAL HUGE_VALF HUGE_VALL FP_INFINITE FP_NAN FP_NORMAL FP_SUBNORMAL FP_ZERO
MATH_ERRNO MATH_ERREXCEPT math_errhandling M_E M_PI M_PI_2 M_PI_4 M_LN2 M_LN10 NULL DOMAIN OVERFLOW UNDERFLOW SING PLOSS
TLOSS
"""
_OWN = """
N M T K ode_x ode_u ode_s ode_a ode_b ode_y ode_d sign_of whole_power relations slopes solve all_finite following
derivative jacobian edges along nearness driven lasts settle runge_kutta slope_of_step between advance contacts stages
SWEEPS CUTS NOTICED BALANCED SLACK NEAR NOTHING LOCATED
"""
C_NAMES = Names(frozenset((_KEYWORDS + _MATHEMATICS + _OWN).split()))
_FUNCTIONS = {"abs": "fabs", "sign": "sign_of"}


def c_language(names: Mapping[str, str]) -> Language[str]:
    """Return how terms are written in C; `names` says how states, inputs and signs are."""
    return Language(
        name=lambda name, power: _raised(names[name], power),
        call=lambda function, argument, power: _raised(f"{_FUNCTIONS.get(function, function)}({argument})", power),
        group=lambda inside, power: f"({inside})" if power == 1 else _raised(inside, power),
        product=lambda factors: "*".join(factors) or "1",
        sum=signed_sum,
    )


def _raised(body: str, power: Power) -> str:
    if power == 1:
        return body
    return f"whole_power({body}, {power})" if isinstance(power, int) else f"pow({body}, {power!r})"


@dataclass(frozen=True)
class Statements:
    """The bodies of two functions.

    `relations` sets the matrix ode_a and the right-hand side ode_b from states, inputs and signs; `slopes` the
    derivatives ode_d of ode_b - ode_a ode_y by states and inputs, ode_y staying as they are.
    """

    relations: str
    slopes: str


def c_statements(model: Model, apart: WithoutSigns, spelling: Mapping[str, str]) -> Statements:
    """Return the statements of a model.

    Args:
        model: to write.
        apart: its right-hand sides, signs apart.
        spelling: how its states and inputs are written.
    """
    language = c_language({**spelling, **{sign: f"ode_s[{k}]" for k, sign in enumerate(apart.signs)}})
    matrix = [[r.part(target) for target in model.targets] for r in model.relations]
    values = [(f"ode_a[{i * len(row) + j}]", entry) for i, row in enumerate(matrix) for j, entry in enumerate(row)]
    values += [(f"ode_b[{i}]", entry) for i, entry in enumerate(apart.right)]
    lines = [f"    {place} = {print_combination(language, entry)};" for place, entry in values]
    relations = [*_taken(model, spelling, [entry for _, entry in values], bool(apart.signs)), *lines]

    lines, used = list[str](), list[Combination]()
    for i, (row, right) in enumerate(zip(matrix, apart.right, strict=True)):
        for j, variable in enumerate(model.variables):
            direct = slope(right, variable)
            through = [(k, found) for k, entry in enumerate(row) if (found := slope(entry, variable)).parts]
            used += [direct, *(found for _, found in through)]
            text = print_combination(language, direct)
            text += "".join(f" - ode_y[{k}]*({print_combination(language, found)})" for k, found in through)
            lines.append(f"    ode_d[{i * len(model.variables) + j}] = {text};")
    slopes = [*_taken(model, spelling, used, bool(apart.signs)), "    (void)ode_y;", *lines]
    return Statements("\n".join(relations), "\n".join(slopes))


def _taken(model: Model, spelling: Mapping[str, str], used: Sequence[Combination], signs: bool) -> list[str]:
    """Return the statements that give states and inputs their names, those that are used."""
    names = frozenset[str]().union(*(c.names for c in used))
    places = [(s, f"ode_x[{k}]") for k, s in enumerate(model.states)]
    places += [(i.name, f"ode_u[{k}]") for k, i in enumerate(model.inputs)]
    taken = [f"    const double {spelling[name]} = {place};" for name, place in places if name in names]
    unused = [place.split("[")[0] for place in ("ode_x[", "ode_u[") if not any(place in line for line in taken)]
    unused += [] if signs and any(n.startswith("sign(") for n in names) else ["ode_s"]
    return [*taken, *(f"    (void){name};" for name in unused)]
