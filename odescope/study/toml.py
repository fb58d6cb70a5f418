"""A study as a TOML file: reading it, writing it, and its files as seen from another folder."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import msgspec
import tomli_w

from odescope.errors import InputError, as_path
from odescope.recordings.readers import matches
from odescope.study.messages import explained
from odescope.study.options import Study
from odescope.study.pieces import own_pieces, put_in, tables


def read_study(path: Path | str) -> Study:
    """Return the study of a TOML file; files that lie where it says, relative to itself, are there with whole paths.

    Others stay as they are written: they may be put in another folder, or left out where data are in memory.

    Raises:
        InputError: the file is missing or no TOML, a key is unknown (the nearest is named), or a value does not fit.
    """
    path = as_path(path, "a study file")
    try:
        text = path.read_text(encoding="utf-8-sig")  # some editors save a byte order mark, which is no TOML
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the study {path}: {getattr(error, 'strerror', None) or error}") from error
    try:
        study = parse_study(text)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    beside = with_whole_paths(study, path.parent).data.files
    files = tuple(
        whole if matches(as_path(whole, "a data file")) else file
        for file, whole in zip(study.data.files, beside, strict=True)
    )
    return msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, files=files))


def with_whole_paths(study: Study, folder: Path) -> Study:
    """Return a study with the files that it names relative to a folder."""
    files = tuple(str(folder.absolute() / file) for file in study.data.files)
    return msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, files=files))


def parse_study(text: str) -> Study:
    """Return the study that a TOML text spells; errors as `read_study`."""
    try:
        raw = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"it is not TOML: {error}") from error
    plain, own = own_pieces(raw)
    try:
        study = put_in(msgspec.convert(plain, Study), own)
    except (msgspec.ValidationError, RecursionError) as error:
        raise InputError(explained(error, plain)) from error
    study.measured()
    study.driven()
    return study


def study_toml(study: Study) -> str:
    """Return the study as TOML with every default spelled out.

    What a file cannot name stands as a comment: read back, the default takes its place.
    """
    said, unsaid = tables(study)
    return "".join(f"# {u.comment}\n" for u in unsaid) + tomli_w.dumps(said)


def moved(study: Study, old: Path, new: Path) -> Study:
    """Return the study with its file paths made relative to another folder.

    Args:
        study: its paths are relative to `old`.
        old: folder.
        new: folder that they are to be relative to.
    """
    files = []
    for file in study.data.files:
        target = (old / file).resolve()
        try:
            files.append(Path(os.path.relpath(target, new.resolve())).as_posix())
        except ValueError:  # another drive, on Windows
            files.append(target.as_posix())
    return msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, files=tuple(files)))
