"""The export command: programs to files and folders, whole or not at all."""

import os
import sys
from pathlib import Path

import pytest

from odescope.commands.cli import EXPORTS, main
from odescope.commands.demo import cart_pendulum
from odescope.errors import InputError
from odescope.export import programs
from odescope.export.model_file import to_json

C_FILES = ["plant.c", "plant.h", "plant_inputs.c", "plant_kalman.c"]


@pytest.fixture
def export(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.json").write_text(to_json(cart_pendulum()))
    (tmp_path / "reserved.json").write_text(to_json(cart_pendulum()).replace("phi", "double"))

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["odescope", "export", *arguments])
        try:
            main()
        except SystemExit as end:
            return end.code or 0, *capsys.readouterr()
        return 0, *capsys.readouterr()

    return call


def test_c_takes_a_folder(export):
    written = "wrote deep/plant/: plant.h, plant.c, plant_inputs.c, plant_kalman.c\n"
    assert export("model.json", "--to", "c", "--out", "deep/plant") == (0, "", written)
    assert sorted(os.listdir("deep/plant")) == C_FILES
    assert os.listdir("deep") == ["plant"]
    code, out, err = export("model.json", "--to", "c")
    assert (code, out) == (2, "")
    assert "--out" in err


def test_a_folder_of_results_stands_for_its_model(export):
    assert export(".") == export("model.json")
    code, _, err = export(os.pardir)
    assert (code, err.count("cannot read the model ../model.json")) == (2, 1)


def test_a_folder_with_files_is_left_alone_unless_forced(export):
    Path("plant").mkdir()
    Path("plant/mine.c").write_text("mine")
    code, _, err = export("model.json", "--to", "c", "--out", "plant")
    assert code == 2
    assert "--force" in err
    assert os.listdir("plant") == ["mine.c"]
    assert export("model.json", "--to", "c", "--out", "plant", "--force")[0] == 0
    assert sorted(os.listdir("plant")) == ["mine.c", *C_FILES]
    assert export("model.json", "--to", "c", "--out", "model.json")[0] == 2


@pytest.mark.parametrize("to", ["python", "matlab", "fmu"])
def test_a_file_that_is_there_is_replaced_unless_it_is_the_model(to, export):
    Path("mine.x").write_text("mine")
    assert export("model.json", "--to", to, "--out", "mine.x") == (0, "", "wrote mine.x\n")
    assert Path("mine.x").read_bytes() != b"mine"
    assert "would overwrite" in export("model.json", "--to", to, "--out", "model.json", "--force")[2]
    assert export("model.json", "--to", "python", "--out", os.devnull)[0] == 0


def test_a_program_is_called_as_it_is_told(export):
    assert export("model.json", "--to", "c", "--out", "plant", "--name", "cart")[0] == 0
    assert "int cart_rhs(" in Path("plant/cart.h").read_text()
    code, _, err = export("model.json", "--to", "c", "--out", "other", "--name", "while")
    assert code == 2
    assert "'while'" in err
    assert not Path("other").exists()
    assert "--name is for programs" in export("model.json", "--to", "latex", "--name", "cart")[2]


def test_names_that_the_language_reserves_are_said(export):
    code, _, err = export("reserved.json", "--to", "c", "--out", "plant")
    assert code == 0
    assert "note: double is written double_\n" in err
    assert "double is written double_" in Path("plant/plant.h").read_text()


def test_an_unknown_language_is_named_with_the_nearest(export):
    code, _, err = export("model.json", "--to", "pythn")
    assert code == 2
    assert "'python'" in err
    assert all(language in err for language in EXPORTS)


def test_a_file_is_all_that_a_program_takes(tmp_path, monkeypatch):
    (tmp_path / "shouted.py").write_text("def write(model, name):\n    return name.upper()\n")
    monkeypatch.setattr(programs, "__path__", [*programs.__path__, str(tmp_path)])
    assert "shouted" in programs.names()
    assert programs.program_writer("shouted")(cart_pendulum(), "plant") == "PLANT"
    del sys.modules["odescope.export.programs.shouted"]
    with pytest.raises(InputError, match=r"cannot export a program to 'matlb'"):
        programs.program_writer("matlb")


@pytest.mark.parametrize("language", [p for p in programs.names() if p not in ("antimony", "c", "fmu")])
def test_a_program_of_one_file_is_printed_or_written_and_called_as_its_file(language, export):
    code, printed, err = export("model.json", "--to", language)
    assert (code, err) == (0, "")
    assert export("model.json", "--to", language, "--out", "deep/plant.x") == (0, "", "wrote deep/plant.x\n")
    assert Path("deep/plant.x").read_text() == printed
    assert os.listdir("deep") == ["plant.x"]
    assert export("model.json", "--to", language, "--out", "deep/cart.x") == (0, "", "wrote deep/cart.x\n")
    named = language != "casadi"  # a Python module has the name of its file, and none inside
    assert (printed.replace("plant", "cart") == Path("deep/cart.x").read_text()) or not named
    assert export("model.json", "--to", language, "--out", "model.json")[0] == 2


def test_a_unit_is_a_file_and_not_for_the_screen(export):
    assert export("model.json", "--to", "fmu", "--out", "deep/cart.fmu") == (0, "", "wrote deep/cart.fmu\n")
    assert os.listdir("deep") == ["cart.fmu"]
    assert Path("deep/cart.fmu").read_bytes().startswith(b"PK")
    code, out, err = export("model.json", "--to", "fmu")
    assert (code, out) == (2, "")
    assert "--out" in err
    assert "would overwrite" in export("model.json", "--to", "fmu", "--out", "model.json")[2]


def test_what_a_language_cannot_express_is_named(export):
    code, out, err = export("model.json", "--to", "antimony", "--out", "cart.ant")
    assert (code, out) == (2, "")
    assert "x_ddot" in err
    assert not Path("cart.ant").exists()


@pytest.mark.parametrize("to", ["fmu", "modelica"])
def test_an_input_that_acts_early_ends_with_its_name_and_no_file(to, export):
    early = to_json(cart_pendulum()).replace('"hold": "linear"', '"hold": "linear", "delay": -0.25')
    Path("early.json").write_text(early)
    code, out, err = export("early.json", "--to", to, "--out", "written")
    assert (code, out) == (2, "")
    assert "the input 'u' acts 0.25 s before it was recorded: shift its column" in err
    assert not Path("written").exists()
