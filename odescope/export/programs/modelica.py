"""A model in Modelica."""

from __future__ import annotations

from odescope.export.about import about
from odescope.export.acausal import caret_language, equations
from odescope.export.program_files import NAME, ProgramFiles, check_no_early_input, check_program
from odescope.export.smooth import smooth_relations
from odescope.export.spelling import Names, renamed
from odescope.model.model import Model
from odescope.recordings.coordinate import state_chain

_RESERVED = """
algorithm and annotation block break class connect connector constant constrainedby der discrete each else elseif
elsewhen encapsulated end enumeration equation expandable extends external false final flow for function if import
impure in initial inner input loop model not operator or outer output package parameter partial protected public pure
record redeclare replaceable return stream then true type when while within sin cos tan exp log sqrt abs sign tanh sinh
cosh time delay Real Integer Boolean String Modelica StateSelect noEvent smooth pre edge change reinit sample terminal
terminate assert
"""
_NAMES = Names(frozenset(_RESERVED.split()), underscore=True)
_FUNCTIONS = {"abs": "noEvent(abs({}))"}


def to_modelica(model: Model, name: str = NAME) -> ProgramFiles:
    """Return a class in Modelica: states with start values that may be changed, inputs as they were recorded.

    Raises:
        InputError: no class can be called so, or an input acts before it was recorded, which Modelica cannot say.
    """
    check_program(model, name, _NAMES, "Modelica")
    check_no_early_input(model, "Modelica")
    late = {i.name: f"ode_late_{i.name}" for i in model.inputs if i.delay}
    spelling = _NAMES.spelled([*model.variables, *model.targets, *late.values()])
    relations, notes = smooth_relations(model), renamed(spelling)
    acting = spelling | {recorded: spelling[own] for recorded, own in late.items()}
    lines = [f'model {name} "Equations of motion, written by odescope"', "  /*"]
    lines += [f"   {line}".rstrip() for line in (*about(model, notes), *relations.notes)] + ["  */"]
    lines += [f"  Real {spelling[s]}(start = 0.0, fixed = true);" for s in model.states]
    lines += [f"  Real {spelling[t]};" for t in model.targets]
    lines += [f"  input Real {spelling[i.name]};" for i in model.inputs]
    lines += [f"  Real {spelling[own]};" for own in late.values()] + ["equation"]
    for i in model.inputs:
        if i.delay:
            lines.append(f"  {spelling[late[i.name]]} = delay({spelling[i.name]}, {float(i.delay)!r});")
    lines += [f"  der({spelling[s]}) = {spelling[d]};" for s, d in state_chain(model.coordinates).items()]
    lines += [f"  {a} = {b};" for a, b in equations(model, relations, caret_language(acting, _FUNCTIONS))]
    return ProgramFiles({f"{name}.mo": "\n".join([*lines, f"end {name};"]) + "\n"}, (*notes, *relations.notes))


write = to_modelica
