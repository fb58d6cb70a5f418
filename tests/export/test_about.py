"""What stands at the head of programs: units come from files that anyone may have written."""

from dataclasses import replace

import msgspec
import pytest
from exported_models import driven_cart, reactor
from hand_models import MODELS

from odescope.export import programs
from odescope.export.about import about

NASTY = 'm/s */ =# #= %} %{ /* """ \\ \n\r */*/ =#=# é {{ x }} {% if %} {0}'
TEXTS = [language for language in programs.names() if language != "fmu"]


def nasty(model):
    coordinates = tuple(msgspec.structs.replace(c, unit=NASTY) for c in model.coordinates)
    return replace(
        model, coordinates=coordinates, inputs=tuple(msgspec.structs.replace(i, unit=NASTY) for i in model.inputs)
    )


def test_lines_are_plain():
    for line in about(nasty(driven_cart())):
        assert line.isascii()
        assert "\n" not in line
        assert not any(mark in line for mark in ("*/", "/*", "=#", "#=", "%}", "%{", '"', "\\"))


@pytest.mark.parametrize("language", TEXTS)
def test_a_unit_cannot_end_the_comment_that_holds_it(language):
    model = reactor() if language == "antimony" else driven_cart()
    write = programs.program_writer(language)
    for file, text in write(nasty(model), "plant").files.items():
        plain = write(model, "plant").files[file]
        told = [line for line in text.splitlines() if "States:" in line or "Inputs:" in line]
        kept = [line for line in plain.splitlines() if "States:" in line or "Inputs:" in line]
        assert len(told) == len(kept)
        assert [line for line in text.splitlines() if line not in told] == [
            line for line in plain.splitlines() if line not in kept
        ]


def test_where_the_model_holds_is_said():
    lines = "\n".join(about(MODELS["rational"], ("x is written x_",)))
    for part in ("u [N]: linear", "x: -0.3333333333333333 to 1e+22", "x is written x_", "x [m]"):
        assert part.replace("u [N]: linear", "u: linear") in lines
