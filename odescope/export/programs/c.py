"""A model in C99; its templates are in export/c_code."""

from __future__ import annotations

from odescope.export.c_code.equations import C_NAMES
from odescope.export.c_code.fields import c_fields, filled
from odescope.export.program_files import NAME, ProgramFiles, check_program
from odescope.export.spelling import renamed
from odescope.model.model import Model

_FILES = {
    "{}.h": "model.h.jinja",
    "{}.c": "model.c.jinja",
    "{}_inputs.c": "inputs.c.jinja",
    "{}_kalman.c": "kalman.c.jinja",
}


def to_c(model: Model, name: str = NAME) -> ProgramFiles:
    """Return a model in C99: header, equations and steps, inputs, and Kalman filter, a file each.

    Their functions begin with `name`: the right-hand side, its Jacobian, a Runge-Kutta step with standstill under dry
    friction as in `simulate`, a run along a record, and the predict and update of an extended Kalman filter.

    Raises:
        InputError: the name is no plain identifier.
    """
    check_program(model, name, C_NAMES, "C")
    fields = c_fields(model, name)
    files = {file.format(name): filled(template, fields) for file, template in _FILES.items()}
    return ProgramFiles(files, renamed(C_NAMES.spelled(model.variables)))


write = to_c
