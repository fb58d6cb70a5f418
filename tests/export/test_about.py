"""What stands at the head of programs: units come from files that anyone may have written."""

from dataclasses import replace

import msgspec
import pytest
from exported_models import driven_cart, reactor
from hand_models import MODELS

from odescope.export import programs
from odescope.export.about import about
from odescope.export.languages.python import to_python

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


def test_degrees_and_micro_are_spelled_out():
    (first, *rest), inputs = reactor().coordinates, reactor().inputs
    coordinates = (
        msgspec.structs.replace(first, unit="°C"),
        *(msgspec.structs.replace(c, unit="µmol/L") for c in rest),
    )
    lines = about(replace(reactor(), coordinates=coordinates, inputs=inputs))
    assert f"{first.name} [degC]" in lines[2]
    assert f"{rest[0].name} [umol/L]" in lines[2]


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


@pytest.mark.parametrize("language", TEXTS)
def test_every_program_says_in_which_unit_time_is_and_was_recorded(language):
    model = replace(reactor() if language == "antimony" else driven_cart(), provenance={"time_unit": "min"})
    texts = [*programs.program_writer(language)(model, "plant").files.values(), to_python(model)]
    told = (
        "Time: seconds (time was recorded in min: in files and notes it is in seconds"
        " (a coefficient times 60 for each 1/s in its unit is one per min))"
    )
    assert any(told in text for text in texts[:-1])
    assert told in texts[-1]


@pytest.mark.parametrize("unit", [None, "s", "fortnights", "*/", 60])
def test_seconds_and_what_is_no_unit_of_time_are_told_as_seconds(unit):
    assert "Time: seconds" in about(replace(driven_cart(), provenance={"time_unit": unit}))
