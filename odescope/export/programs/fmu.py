"""A model as a functional mock-up unit of FMI 3.0: sources for Model Exchange and Co-Simulation."""

from __future__ import annotations

import hashlib
import io
import zipfile

from odescope.export.c_code.equations import C_NAMES
from odescope.export.c_code.fields import c_fields, filled
from odescope.export.program_files import NAME, ProgramFiles, check_no_early_input, check_program
from odescope.export.spelling import Names, renamed
from odescope.model.model import Model
from odescope.model.state_sizes import small_sizes

_VARIABLES = Names(frozenset({"time"}), underscore=True)  # the independent variable has that name
ATOL = 1e-11  # of a state of size 1, in a step of Co-Simulation
_DAY = (1980, 1, 1, 0, 0, 0)  # the first that an archive can say: the same model makes the same file

_TAKEN = "In Co-Simulation inputs are set as recorded, and the unit delays them; in Model Exchange, as they act."

_BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{name}">
    <SourceFileSet language="C99">
      <SourceFile name="{name}.c"/>
      <SourceFile name="fmi3.c"/>
    </SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


def to_fmu(model: Model, name: str = NAME) -> ProgramFiles:
    """Return a unit with its sources, which importers compile.

    Raises:
        InputError: no model can be called so, or an input acts before it was recorded.
    """
    check_program(model, name, C_NAMES, "an FMU")
    check_no_early_input(model, "an FMU")
    fields = c_fields(model, name)
    sources = {f"{name}.h": filled("model.h.jinja", fields), f"{name}.c": filled("model.c.jinja", fields)}
    token = "".join(sources.values()).encode()
    fields |= _variables(model) | {
        "token": hashlib.sha256(token).hexdigest(),
        "description": "Equations of motion, written by odescope. " + _TAKEN,
        "late": any(i.delay for i in model.inputs),
        "latest": repr(max((float(i.delay) for i in model.inputs), default=0.0)),
        "tolerances": ", ".join(map(repr, (ATOL * small_sizes(model)).tolist())),
        "held": [int(i.hold == "zero") for i in model.inputs],
    }
    sources["fmi3.c"] = filled("fmi3.c.jinja", fields)
    sources["buildDescription.xml"] = _BUILD.format(name=name)
    files = {"modelDescription.xml": filled("modelDescription.xml.jinja", fields)}
    files |= {f"sources/{file}": text for file, text in sources.items()}
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, text in files.items():
            entry = zipfile.ZipInfo(file, _DAY)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, text)
    return ProgramFiles({f"{name}.fmu": packed.getvalue()}, renamed(_spelling(model)))


write = to_fmu


def _spelling(model: Model) -> dict[str, str]:
    indicators = [f"indicator{k}" for k in range(len(model.switched.edges))]
    return Names(_VARIABLES.reserved.union(indicators), underscore=True).spelled(model.variables)


def _variables(model: Model) -> dict[str, object]:
    """Return states, inputs and event indicators as the description of a unit lists them."""
    spelling = _spelling(model)
    offsets = {c.name: c.offset for c in model.coordinates}
    states = [
        {
            "name": spelling[s],
            "reference": k,
            "causality": "output" if s in offsets else "local",
            "description": f"a sensor reads {float(offsets[s])!r} more" if offsets.get(s) else "",
        }
        for k, s in enumerate(model.states, 1)
    ]
    inputs = [
        {
            "name": spelling[i.name],
            "reference": 2 * len(model.states) + k,
            "description": f"acts {float(i.delay)!r} s after it was recorded; {i.hold} between samples",
        }
        for k, i in enumerate(model.inputs, 1)
    ]
    first = 1 + 2 * len(model.states) + len(model.inputs)
    indicators = [{"name": f"indicator{k}", "reference": first + k} for k in range(len(model.switched.edges))]
    return {"states": states, "inputs": inputs, "indicators": indicators}
