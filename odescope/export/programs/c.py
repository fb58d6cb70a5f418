"""A model in C99; its templates are in export/c_code."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from odescope.export.about import about
from odescope.export.c_code.equations import C_NAMES, c_statements
from odescope.export.program_files import NAME, ProgramFiles, check_program_name
from odescope.export.spelling import renamed
from odescope.model.model import Model
from odescope.model.switches import without_signs
from odescope.recordings.between_samples import FINER, REACH, laid_out
from odescope.recordings.coordinate import following_states

if TYPE_CHECKING:
    from jinja2 import Environment

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
    check_program_name(name, C_NAMES, "C")
    apart = without_signs(model.relations, model.targets, model.states)
    spelling = C_NAMES.spelled(model.variables)
    notes = renamed(spelling)
    statements = c_statements(model, apart, spelling)
    dry = "Dry friction, sign(v), holds at v = 0 while less than all of it is needed, as in odescope's simulation."
    fields = {
        "name": name,
        "P": name.upper(),
        "header": [*about(model, notes), *(["", dry] if apart.signs else [])],
        "n": len(model.states),
        "m": len(model.inputs),
        "targets": len(model.targets),
        "signs": len(apart.signs),
        "state_names": ", ".join(f'"{s}"' for s in model.states),
        "input_names": ", ".join(f'"{i.name}"' for i in model.inputs),
        "offsets": ", ".join(repr(float(c.offset)) for c in model.coordinates),
        "delays": ", ".join(repr(float(i.delay)) for i in model.inputs),
        "holds": ", ".join(f'"{i.hold}"' for i in model.inputs),
        "each_hold": [i.hold for i in model.inputs],
        "kinds": {i.hold for i in model.inputs},
        "relations": statements.relations,
        "slopes": statements.slopes,
        "whole": statements.relations + statements.slopes + ("sign_of(" if apart.signs else ""),
        "following": ", ".join(map(str, following_states(model.coordinates).tolist())),
        "measured": ", ".join(str(model.states.index(c.name)) for c in model.coordinates),
        "edges": _table(apart.edges),
        **_band_limited(),
    }
    environment = _environment()
    files = {file.format(name): environment.get_template(t).render(fields) for file, t in _FILES.items()}
    return ProgramFiles(files, notes)


write = to_c


def _band_limited() -> dict[str, object]:
    """Return what a polygon that stands for a band-limited input weighs samples with, read off that of an impulse."""
    length = 2 * REACH + 4
    impulse = np.zeros(2 * length + 1)
    impulse[length] = 1.0
    answers = laid_out(impulse).reshape(-1, FINER)[length - REACH - 1 : length + REACH + 2]
    # What comes so many samples after the impulse weighs the sample as many before.
    return {"finer": FINER, "before": REACH + 1, "taps": len(answers), "weights": _table(answers[::-1].T)}


def _table(rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """Return rows of numbers as C initialises a matrix with them."""
    return ",\n".join("    { " + ", ".join(repr(v) for v in row) + " }" for row in rows.tolist())


@cache
def _environment() -> Environment:
    # Imported here: text exports need not wait for it.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("odescope.export", "c_code"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
