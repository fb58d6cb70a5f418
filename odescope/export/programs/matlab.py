"""A model as a function file for MATLAB and Octave."""

from __future__ import annotations

from collections.abc import Mapping

from odescope.export.about import about
from odescope.export.program_files import NAME, ProgramFiles, check_program
from odescope.export.smooth import smooth_relations
from odescope.export.spelling import Names, renamed
from odescope.library.expression import Power, signed_sum
from odescope.library.printer import Language, print_combination
from odescope.model.model import Model
from odescope.recordings.coordinate import state_chain

_RESERVED = """
break case catch classdef continue else elseif end for function global if otherwise parfor persistent return
spmd switch try while do until endif endwhile endfor endfunction end_try_catch unwind_protect enumeration
events methods properties arguments endswitch end_unwind_protect unwind_protect_cleanup endparfor
sin cos tan exp abs sign tanh sinh cosh reallog realsqrt realpow isa nargin zeros numel ode_t ode_x ode_u ode_a ode_b
ode_dx ode_delay ode_at ode_k
"""
_NAMES = Names(frozenset(_RESERVED.split()), longest=63)
_FUNCTIONS = {"log": "reallog", "sqrt": "realsqrt"}

_TEMPLATE = """function ode_dx = {name}(ode_t, ode_x, ode_u)
{header}
%
% dx = {name}(t, x, u) is the derivative of the states x under inputs u: their values as they act at time t, or a
% function of time that returns them as they were recorded, each of which is then taken as late as it acts. So
%   [t, x] = ode45(@(t, x) {name}(t, x, u), [0 10], x0)
% Between samples inputs are to do what is said above; stop and restart at the jumps of those that are held.
{note}{unpack}ode_a = [{matrix}];
ode_b = [{right}];
ode_b = ode_a \\ ode_b;
ode_dx = [{following}];
end
"""

_INPUTS = """if isa(ode_u, 'function_handle')
    ode_delay = [{delays}];
    ode_at = ode_u;
    ode_u = zeros({count}, 1);
    for ode_k = 1:{count}
        ode_dx = ode_at(ode_t - ode_delay(ode_k));
        ode_u(ode_k) = ode_dx(ode_k);
    end
end
"""


def to_matlab(model: Model, name: str = NAME) -> ProgramFiles:
    """Return a function file for MATLAB and Octave that ode45 takes.

    Raises:
        InputError: no function can be called so.
    """
    check_program(model, name, _NAMES, "MATLAB")
    spelling, relations = _NAMES.spelled(model.variables), smooth_relations(model)
    language, notes = matlab_language(spelling), renamed(spelling)
    unpack = [f"{spelling[s]} = ode_x({k});" for k, s in enumerate(model.states, 1)]
    unpack += [f"{spelling[i.name]} = ode_u({k});" for k, i in enumerate(model.inputs, 1)]
    taken = ""
    if model.inputs:
        delays = " ".join(repr(float(i.delay)) for i in model.inputs)
        taken = _INPUTS.format(delays=delays, count=len(model.inputs))
    place = {s: spelling[s] for s in model.states} | {t: f"ode_b({k})" for k, t in enumerate(model.targets, 1)}
    text = _TEMPLATE.format(
        name=name,
        header="\n".join(f"% {line}".rstrip() for line in about(model, notes)),
        note="".join(f"% {line}\n" for line in relations.notes),
        unpack=taken + "".join(f"{line}\n" for line in unpack),
        matrix="; ".join(", ".join(print_combination(language, c) for c in row) for row in relations.matrix),
        right="; ".join(print_combination(language, c) for c in relations.right),
        following="; ".join(place[d] for d in state_chain(model.coordinates).values()),
    )
    return ProgramFiles({f"{name}.m": text}, (*notes, *relations.notes))


write = to_matlab


def matlab_language(names: Mapping[str, str]) -> Language[str]:
    """Return how terms are written for MATLAB; `names` says how states and inputs are."""
    return Language(
        name=lambda name, power: _raised(names[name], power),
        call=lambda function, argument, power: _raised(f"{_FUNCTIONS.get(function, function)}({argument})", power),
        group=lambda inside, power: _raised(f"({inside})", power),
        product=lambda factors: "*".join(factors) or "1",
        sum=lambda parts: f"({signed_sum(parts)})",  # in a matrix, blanks before a sign would begin a new entry
    )


def _raised(body: str, power: Power) -> str:
    if power == 1:
        return body
    # A power that is no whole number of a negative number is an error and not complex, as are its logarithm and root.
    return f"{body}^({power})" if isinstance(power, int) else f"realpow({body}, {power!r})"
