"""A model in Antimony, the text that is turned into SBML; for equations of order 1."""

from __future__ import annotations

from odescope.errors import InputError
from odescope.export.about import about
from odescope.export.acausal import caret_language
from odescope.export.program_files import NAME, ProgramFiles, check_program
from odescope.export.spelling import Names, renamed
from odescope.library.printer import print_combination
from odescope.model.model import Model

_RESERVED = """
model module end function species compartment reaction in is at after const var ext gene operator import has unit DNA
since formula event delete constraint substanceOnly maximize minimize priority persistent fromTrigger t0 identity
description creator created modified maintains time pi exponentiale avogadro true false infinity inf nan notanumber
sin cos tan sec csc cot sinh cosh tanh sech csch coth arcsin arccos arctan asin acos atan asinh acosh atanh arcsinh
arccosh arctanh acot acsc asec exp ln log log10 log2 sqrt sqr root abs ceil ceiling floor factorial pow power piecewise
and or not xor eq neq lt leq gt geq delay rateOf max min quotient rem implies plus minus times divide uniform normal
poisson binomial exponential gamma bernoulli cauchy chisquare laplace lognormal rayleigh truncated
"""
_NAMES = Names(frozenset(_RESERVED.split()))
_FUNCTIONS = {"log": "ln({})", "sign": "piecewise(1, {0} > 0, -1, {0} < 0, 0)"}


def to_antimony(model: Model, name: str = NAME) -> ProgramFiles:
    """Return a model in Antimony: a rate rule a state, inputs as parameters to be set as they act.

    Raises:
        InputError: no model can be called so, a coordinate is not of order 1, or more than five rates are coupled.
    """
    check_program(model, name, _NAMES, "Antimony")
    moving = next((c for c in model.coordinates if c.order > 1), None)
    if moving is not None:
        raise InputError(
            f"Antimony is for rates of change, equations of order 1; {moving.target} of the coordinate {moving.name!r}"
            f" is of order {moving.order}"
        )
    spelling = _NAMES.spelled(model.variables)
    notes, language = renamed(spelling), caret_language(spelling, _FUNCTIONS)
    lines = [f"// {line}".rstrip() for line in about(model, notes)]
    lines.append(
        f"// Every state starts at 0.0: set {', '.join(spelling[s] for s in model.states)} to where a run begins."
    )
    if model.inputs:
        late = ", as late as is said above" if any(i.delay for i in model.inputs) else ""
        lines.append(f"// Inputs are parameters: set each to its value as it acts{late}.")
    lines += [f"model {name}", *(f"  {spelling[v]} = 0.0;" for v in model.variables)]
    lines += [f"  var {spelling[i.name]};" for i in model.inputs]
    for c, quotient in zip(model.coordinates, model.quotients, strict=True):
        rate = print_combination(language, quotient.numerator)
        if not quotient.plain:
            rate = f"({rate})/({print_combination(language, quotient.denominator)})"
        lines.append(f"  {spelling[c.name]}' = {rate};")
    return ProgramFiles({f"{name}.ant": "\n".join([*lines, "end"]) + "\n"}, notes)


write = to_antimony
