"""A model in Julia, for ModelingToolkit."""

from __future__ import annotations

from odescope.export.about import about
from odescope.export.acausal import caret_language, equations
from odescope.export.program_files import NAME, ProgramFiles, check_program
from odescope.export.smooth import smooth_relations
from odescope.export.spelling import Names, renamed
from odescope.model.model import Model
from odescope.recordings.coordinate import state_chain

_RESERVED = """
baremodule begin break catch const continue do else elseif end export false finally for function global if import let
local macro module public quote return struct true try using while where in isa outer abstract mutable primitive type
acting sin cos tan exp log sqrt abs sign tanh sinh cosh t D im pi missing nothing system equations DELAYS HOLDS OFFSETS
ModelingToolkit System Base Core Main eval include input t_nounits D_nounits
"""
_NAMES = Names(frozenset(_RESERVED.split()), underscore=True)

_TEMPLATE = """#=
{header}
Inputs of the system are as they act, so many seconds after they were recorded as DELAYS says; between samples they do
what HOLDS says. Of a record with `times` and `inputs`, a column each, acting(times, inputs, k, s) is input k as it acts
at time s: register it as symbolic, and equate the input with it. Sensors read OFFSETS more than the coordinates.
{note}=#
module {name}

using ModelingToolkit
using ModelingToolkit: t_nounits as t, D_nounits as D

const DELAYS = [{delays}]
const HOLDS = [{holds}]
const OFFSETS = [{offsets}]

{acting}@variables {variables}
{inputs}
equations = [
{equations}
]

@named system = System(equations, t)

end
"""


_ACTING = """function acting(times, inputs, k, s)
    late = s - DELAYS[k]
    late <= times[1] && return inputs[1, k]
    late >= times[end] && return inputs[end, k]
    j = searchsortedlast(times, late)
    HOLDS[k] == "zero" && return inputs[j, k]
    return inputs[j, k] + (inputs[j + 1, k] - inputs[j, k]) * (late - times[j]) / (times[j + 1] - times[j])
end

"""


def to_julia(model: Model, name: str = NAME) -> ProgramFiles:
    """Return a module in Julia that holds the equations as a system of ModelingToolkit.

    Raises:
        InputError: no module can be called so.
    """
    check_program(model, name, _NAMES, "Julia")
    spelling, relations = _NAMES.spelled([*model.variables, *model.targets]), smooth_relations(model)
    notes, language = (*renamed(spelling), *_band_limited(model)), caret_language(spelling, {})
    lines = [f"D({spelling[s]}) ~ {spelling[d]}" for s, d in state_chain(model.coordinates).items()]
    lines += [f"{a} ~ {b}" for a, b in equations(model, relations, language)]
    text = _TEMPLATE.format(
        name=name,
        header="\n".join(about(model, notes)),
        note="".join(f"{line}\n" for line in relations.notes),
        delays=", ".join(repr(float(i.delay)) for i in model.inputs),
        holds=", ".join(f'"{i.hold}"' for i in model.inputs),
        offsets=", ".join(repr(float(c.offset)) for c in model.coordinates),
        variables=" ".join(f"{spelling[v]}(t)" for v in (*model.states, *model.targets)),
        inputs="".join(f"@variables {spelling[i.name]}(t) [input = true]\n" for i in model.inputs),
        acting=_ACTING if model.inputs else "",
        equations=",\n".join(f"    {line}" for line in lines),
    )
    return ProgramFiles({f"{name}.jl": text}, (*notes, *relations.notes))


write = to_julia


def _band_limited(model: Model) -> tuple[str, ...]:
    held = [i.name for i in model.inputs if i.hold == "band-limited"]
    return tuple(f"{name} is band-limited, and linear in what acting() returns" for name in held)
