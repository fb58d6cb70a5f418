"""A study written from a look at a data file: the init command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from odescope.commands.arguments import source_stem
from odescope.errors import InputError
from odescope.files import check_file, write_file
from odescope.recordings.readers import find_files
from odescope.study.draft import Drafted, draft


def init_study(sources: Sequence[Path], out: Path | None, force: bool) -> tuple[Path, Drafted]:
    """Write a study of data files, from a look at them.

    Args:
        sources: data files, folders, patterns.
        out: file to write; by default beside the first source, called like it.
        force: whether it may take the place of another.

    Raises:
        InputError: a file cannot be read, there is nothing to identify in it, or the study exists or is called like no
            study.
    """
    target = sources[0].parent / f"{source_stem(sources)}.toml" if out is None else out
    if target.suffix.lower() != ".toml":
        raise InputError(f"a study is a file that ends in .toml, which {target} does not: name one with --out")
    if target.exists() and not force:
        raise InputError(f"{target} exists: name another with --out, or let it be replaced with --force")
    check_file(target)
    study = draft(find_files(sources), sources, target.parent)
    write_file(target, study.text)
    return target, study
