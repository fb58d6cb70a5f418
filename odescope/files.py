"""Files: written so that a stop in the middle leaves no half one, and named so that they are told apart."""

from __future__ import annotations

import os
import secrets
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from odescope.errors import InputError

MODEL = "model.json"  # what the model is called in a folder of results


def write_files(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write files to a folder, or to folders in it: all are complete beside it before the first takes its place.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        there = folder.exists()
        if not there:
            folder.parent.mkdir(parents=True, exist_ok=True)
        # Within a folder that is there already, which may be all of its disk that we may write to.
        partial = (folder if there else folder.parent) / f".odescope-{secrets.token_hex(8)}"
        partial.mkdir()
        try:
            for name, content in files.items():
                (partial / name).parent.mkdir(exist_ok=True)
                if isinstance(content, bytes):
                    (partial / name).write_bytes(content)
                else:
                    (partial / name).write_text(content, encoding="utf-8", newline="\n")
            if there:
                for name in files:
                    (folder / name).parent.mkdir(exist_ok=True)
                    os.replace(partial / name, folder / name)
            else:
                os.replace(partial, folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}") from error


def check_file(path: Path) -> None:
    """Refuse early, before anything is computed, a file that cannot be written; errors as `write_file`."""
    try:
        if path.is_dir():
            raise InputError(f"cannot write {path}: it is a folder; name a file")
        existing = path.parent
        while not existing.exists() and existing != existing.parent:
            existing = existing.parent
        if not existing.is_dir():
            raise InputError(f"cannot write {path}: {existing} is not a folder")
        if not path.exists() or path.is_file():
            with tempfile.TemporaryFile(dir=existing):
                pass
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def write_file(path: Path, text: str) -> None:
    """Write one file, complete beside its place before it takes it; a device or a pipe is written as it is.

    Raises:
        InputError: it cannot be written.
    """
    check_file(path)
    try:
        if path.exists() and not path.is_file():
            path.write_text(text, encoding="utf-8", newline="\n")
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.parent / f".odescope-{secrets.token_hex(8)}"
        try:
            partial.write_text(text, encoding="utf-8", newline="\n")
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def model_in(path: Path) -> Path:
    """Return the model of a folder of results; any other path as it is."""
    return path / MODEL if path.is_dir() else path


def shortest_ends(paths: Sequence[Path]) -> tuple[str, ...]:
    """Return the shortest ends of paths that tell them apart, their names if these do; a path given twice is not."""
    whole = [path.absolute().parts for path in paths]
    depth, names = 1, tuple(path.name for path in paths)
    while len(set(names)) < len(set(whole)):
        depth += 1
        names = tuple("/".join(parts[-depth:]) for parts in whole)
    return names
