"""A model file as text or as a program: the export command."""

from __future__ import annotations

import sys
from pathlib import Path

from odescope.commands.files import check_writable, refuse_overwriting
from odescope.commands.terminal import say
from odescope.errors import InputError
from odescope.export import languages
from odescope.export.exported import exported
from odescope.export.model_file import read_model
from odescope.export.program_files import NAME
from odescope.files import check_file, write_file, write_files


def export_model(model_path: Path, to: str, out: Path | None, name: str | None, force: bool) -> None:
    """Write a model in a language, and say on standard error where, and what is not written as the model has it.

    Args:
        model_path: a model file.
        to: the language.
        out: file to write, or folder for programs of several files; None for standard output.
        name: what a program is called; None for that of its file.
        force: whether files may go to a folder that holds some.

    Raises:
        InputError: there is no such language, it cannot express the model, or the files cannot be written.
    """
    if name is not None and to in languages.names():
        raise InputError(f"--name is for programs: {to} has none")
    if name is None:
        stem = out.stem if out is not None and out.suffix else NAME
        name = stem if stem.isidentifier() else NAME
    program = exported(read_model(model_path), to, name)
    (first, content), *more = program.files.items()
    if not more and isinstance(content, str):
        _deliver(content, model_path, out)
    elif out is None:
        raise InputError(f"{to} takes {'a file' if not more else 'several files'}: say where with --out")
    elif not more and not out.is_dir():
        check_file(out)
        refuse_overwriting([out], [model_path])
        write_files(out.parent, {out.name: content})
        _say_written(str(out))
    else:
        _refuse_filled(out, force)
        check_writable(out)
        refuse_overwriting([out / file for file in (first, *(other for other, _ in more))], [model_path])
        write_files(out, program.files)
        _say_written(f"{out}/: {', '.join(program.files)}")
    for note in program.notes:
        print(f"note: {note}", file=sys.stderr)


def _deliver(text: str, model_path: Path, out: Path | None) -> None:
    if out is None:
        say(text)
    else:
        refuse_overwriting([out], [model_path])
        write_file(out, text)
        _say_written(str(out))


def _say_written(what: str) -> None:
    print(f"wrote {what}", file=sys.stderr)


def _refuse_filled(folder: Path, force: bool) -> None:
    """Refuse a folder that holds files, unless it was said that they may be written over."""
    try:
        filled = not force and folder.is_dir() and any(folder.iterdir())
    except OSError as error:
        raise InputError(f"cannot look into {folder}: {error.strerror or error}") from error
    if filled:
        raise InputError(f"{folder} holds files already; name another folder with --out, or say --force to write there")
