"""What fills the templates of the C code."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from odescope.arrays import FloatArray
from odescope.export.about import about
from odescope.export.band_limited import BEFORE, band_limited_weights
from odescope.export.c_code.equations import C_NAMES, c_statements
from odescope.export.spelling import renamed
from odescope.model.model import Model
from odescope.model.switches import without_signs
from odescope.recordings.coordinate import following_states

if TYPE_CHECKING:
    from jinja2 import Environment

_DRY = "Dry friction, sign(v), holds at v = 0 while less than all of it is needed, as in odescope's simulation."


def c_fields(model: Model, name: str) -> dict[str, object]:
    """Return the fields of the templates, for functions whose names begin with `name`."""
    apart = without_signs(model.relations, model.targets, model.states)
    spelling = C_NAMES.spelled(model.variables)
    statements = c_statements(model, apart, spelling)
    return {
        "name": name,
        "P": name.upper(),
        "header": [*about(model, renamed(spelling)), *(["", _DRY] if apart.signs else [])],
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
        "angles": [int(c.angle) for c in model.coordinates],
        "edges": _table(apart.edges),
        **_band_limited(),
    }


def filled(template: str, fields: Mapping[str, object]) -> str:
    """Return a template of this folder with its fields filled in."""
    return _environment().get_template(template).render(fields)


def _band_limited() -> dict[str, object]:
    weights = band_limited_weights()
    return {"finer": len(weights), "before": BEFORE, "taps": weights.shape[1], "weights": _table(weights)}


def _table(rows: FloatArray) -> str:
    """Return rows of numbers as C initialises a matrix with them."""
    return ",\n".join("    { " + ", ".join(repr(v) for v in row) + " }" for row in rows.tolist())


@cache
def _environment() -> Environment:
    # Imported here: text exports need not wait for it.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("odescope.export", "c_code"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    made.filters["quoted"] = quoteattr
    return made
